"""What a study would do: its jobs, what is left of each, and about how long it takes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

from embodichain.cli.jobs.work.evaluate_job import EVAL_FILE
from embodichain.cli.studies.measuring import measure_evaluation, measure_training
from embodichain.cli.studies.stages import read_stage
from embodichain.cli.studies.study_job import (
    TRAINING,
    StudyFolder,
    evaluation_stage,
    training_stage,
)
from embodichain.config.run_folder import SUMMARY
from embodichain.config.study import Study, StudyJob

__all__ = ["job_table"]

SEARCH = "search"
EVALUATION = "evaluation"


def job_table(
    study: Study, place: StudyFolder, say: Callable[[str], None]
) -> tuple[str, list[dict[str, Any]]]:
    """Return a title and a row for each job.

    Time is estimated from stages of the same arm and task that are done; before the first it is
    measured for a moment.

    Args:
        study: The study.
        place: Its folder, which need not exist.
        say: Called with a line before a measurement, which takes seconds.
    """
    estimates = _Estimates(study, place, say)
    rows: list[dict[str, Any]] = []
    total = 0.0
    is_known = True
    for job in study.jobs():
        left = dict(_stages_left(place, job))
        seconds: float | None = 0.0
        for name in left:
            estimate = estimates.seconds_of(job, name)
            seconds = None if estimate is None or seconds is None else seconds + estimate
        if seconds is None:
            is_known = False
        else:
            total += seconds
        rows.append(
            {
                "job": job.name,
                "left": ", ".join(left) if left else "nothing",
                "why": next(iter(left.values()), ""),
                "about": "unknown" if seconds is None else f"{seconds:.0f} s",
            }
        )
    about = f"about {total:.0f} s" if is_known else f"more than {total:.0f} s"
    return f"{study.name}: {len(rows)} jobs, {about}, one after the other", rows


def _stages_left(place: StudyFolder, job: StudyJob) -> Iterator[tuple[str, str]]:
    """Yield the name of each stage that has to run, and why."""
    trains_again = False
    if place.waits_for_search(job):
        yield SEARCH, "not done yet"
        yield TRAINING, "after the search"
        trains_again = True
    elif job.trains:
        reason = training_stage(place, job).why_it_runs()
        if reason is not None:
            trains_again = True
            yield TRAINING, reason
    for variation in job.study.variations:
        name = place.evaluation(job, variation).name
        if trains_again:
            yield name, "after the training"
            continue
        reason = evaluation_stage(place, job, variation).why_it_runs()
        if reason is not None:
            yield name, reason


class _Estimates:
    """Seconds that stages take, each kind of them measured once.

    Args:
        study: The study.
        place: Its folder.
        say: Called with a line before a measurement.
    """

    def __init__(self, study: Study, place: StudyFolder, say: Callable[[str], None]) -> None:
        self._study = study
        self._place = place
        self._say = say
        self._measured: dict[tuple[str, str, str], float | None] = {}

    def seconds_of(self, job: StudyJob, stage: str) -> float | None:
        """Return the seconds of a stage; None where they cannot be measured."""
        if stage == SEARCH:
            search = job.arm_cfg.optimize
            if search is None or job.seed != self._study.cfg.seeds[0]:
                return 0.0  # the search of the first seed is that of all
            of_a_trial = self.seconds_of(job, TRAINING)
            return None if of_a_trial is None else search.trials * of_a_trial
        done = _seconds_of_others(self._study, self._place, job, stage)
        if done is not None:
            return done
        kind = TRAINING if stage == TRAINING else EVALUATION
        key = (job.arm, job.task, kind)
        if key not in self._measured:
            self._say(f"measuring: {job.arm}, {job.task}: {kind}")
            self._measured[key] = self._measure(job, kind)
        return self._measured[key]

    def _measure(self, job: StudyJob, kind: str) -> float | None:
        """Measure a training or an evaluation of a job, without what a search will choose."""
        if kind == TRAINING:
            return measure_training(job.training())
        return measure_evaluation(job.evaluation(self._study.variations[0]))


def _seconds_of_others(study: Study, place: StudyFolder, job: StudyJob, stage: str) -> float | None:
    """Mean duration of a stage in jobs of the same arm and task; None before the first."""
    durations: list[float] = []
    for other in study.jobs():
        if (other.arm, other.task) != (job.arm, job.task):
            continue
        if not read_stage(place.job(other) / stage).get("done"):
            continue
        if stage == TRAINING:
            name, key = SUMMARY, "train_seconds"
        else:
            name, key = EVAL_FILE, "seconds"
        content = json.loads((place.job(other) / stage / name).read_text(encoding="utf-8"))
        durations.append(float(content.get(key) or 0.0))
    if not durations:
        return None
    return sum(durations) / len(durations)

"""A job of a study: the training of one arm on one task with one seed, then its evaluations."""

from __future__ import annotations

import json
import sys
import traceback
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from embodichain.cli.jobs.job import Job, Work
from embodichain.cli.jobs.work.evaluate_job import (
    EVAL_FILE,
    EvaluationPlan,
    evaluate_job,
    evaluation_config,
    objective_of,
    with_suitable_arrays,
    write_evaluation_receipt,
)
from embodichain.cli.jobs.work.train_job import train_job
from embodichain.cli.studies.stages import Stage, mark_undone, read_stage
from embodichain.cli.sweeps.sweep_jobs import JobStoppedError, exclusive, read_summary
from embodichain.cli.sweeps.sweep_progress import JobRow, read_numbers
from embodichain.config.run_folder import CHECKPOINT, STUDY, SUMMARY
from embodichain.config.study import Study, StudyJob, read_study
from embodichain.utils.errors import ConfigError
from embodichain.utils.system.atomic import write_text

__all__ = [
    "TRAINING",
    "StudyFolder",
    "evaluation_stage",
    "run_study_job",
    "training_stage",
]

TRAINING = "train"
"""Name of the folder of a job's training; those of evaluations have the variations' names."""
_CHOSEN = "chosen.yaml"
_TAIL = 12
"""Lines of a log that are shown of a job that failed."""


@dataclass(frozen=True)
class StudyFolder:
    """The folder of a study, and what is where in it.

    Attributes:
        path: The folder.
    """

    path: Path

    def read(self) -> Study:
        """Read the study's record.

        Raises:
            ConfigError: There is none, or it is damaged.
        """
        try:
            return read_study((self.path / STUDY).read_text(encoding="utf-8"))
        except OSError as error:
            raise ConfigError(f"{self.path} is not the folder of a study: {error}") from error

    def write(self, study: Study) -> None:
        """Write the study's record."""
        self.path.mkdir(parents=True, exist_ok=True)
        write_text(self.path / STUDY, study.dump())

    @property
    def jobs(self) -> Path:
        """The folder with those of the jobs."""
        return self.path / "jobs"

    def job(self, job: StudyJob) -> Path:
        """The folder of a job."""
        return self.jobs / job.name

    def training(self, job: StudyJob) -> Path:
        """The folder of a job's training."""
        return self.job(job) / TRAINING

    def evaluation(self, job: StudyJob, variation: str) -> Path:
        """The folder of a job's evaluation."""
        return self.job(job) / f"eval-{variation}"

    def search(self, job: StudyJob) -> Path:
        """The folder of the search for an arm's values on a task."""
        return self.path / "search" / job.name.removesuffix(f"-{job.seed}")

    def chosen(self, job: StudyJob) -> list[str]:
        """The overrides that the search of a job's arm has chosen; empty without a search.

        Raises:
            ConfigError: The search has not ended.
        """
        if job.arm_cfg.optimize is None:
            return []
        if self.waits_for_search(job):
            raise ConfigError(f"the search of arm {job.arm} on {job.task} has not ended")
        lines = yaml.safe_load((self.search(job) / _CHOSEN).read_text(encoding="utf-8"))
        return [str(line) for line in lines]

    def waits_for_search(self, job: StudyJob) -> bool:
        """Whether a job's arm has a search that has not ended."""
        return job.arm_cfg.optimize is not None and not (self.search(job) / _CHOSEN).is_file()

    def write_chosen(self, job: StudyJob, lines: list[str]) -> None:
        """Write the overrides that a search has chosen."""
        write_text(self.search(job) / _CHOSEN, yaml.safe_dump(lines))

    def failure(self, job: StudyJob) -> dict[str, Any] | None:
        """What ended a job; None if nothing did."""
        summary = read_summary(self.job(job))
        return summary if summary.get("status") == "failed" else None

    def log(self, job: StudyJob) -> Path:
        """The newest `run.log` of a job's stages, which need not exist."""
        logs = sorted(self.job(job).glob("*/run.log"), key=lambda path: path.stat().st_mtime_ns)
        return logs[-1] if logs else self.training(job) / "run.log"

    def exclusive(self) -> AbstractContextManager[None]:
        """Let no other process run the study while the context lasts.

        Raises:
            JobRunsError: Another process runs it.
            ConfigError: The folder above cannot be made.
        """
        return exclusive(self.path, "study")

    def mark_undone(self, job: StudyJob, stage: str) -> None:
        """Let an evaluation of a job run again, so that no table has it; all after a training.

        Args:
            job: The job.
            stage: The name of a stage's folder: `TRAINING`, or an evaluation's.
        """
        names = [self.evaluation(job, variation).name for variation in job.study.variations]
        if stage in names:
            names = [stage]
        for name in names:
            mark_undone(self.job(job) / name)

    def forget_outcome(self, job: StudyJob) -> None:
        """Remove what an earlier start has said about the end of a job."""
        (self.job(job) / SUMMARY).unlink(missing_ok=True)

    def results(self, job: StudyJob, variation: str) -> dict[str, Any] | None:
        """The content of `eval.json` of an evaluation that is done, else None."""
        folder = self.evaluation(job, variation)
        if not read_stage(folder).get("done"):
            return None
        path = folder / EVAL_FILE
        try:
            content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ConfigError(f"cannot read {path}: {error}") from error
        return content

    def tables(self) -> list[Path]:
        """The files of results that exist."""
        names = ("episodes.csv", "episodes.parquet", "summary.csv", "results.md", "results.json")
        return [self.path / name for name in names if (self.path / name).is_file()]

    def has_results(self, study: Study) -> bool:
        """Whether any evaluation of a study is done."""
        return any(
            read_stage(self.evaluation(job, variation)).get("done")
            for job in study.jobs()
            for variation in study.variations
        )

    def is_finished(self, job: StudyJob) -> bool:
        """Whether every evaluation of a job is done."""
        stages = [self.evaluation(job, variation) for variation in job.study.variations]
        return all(read_stage(folder).get("done") for folder in stages)

    def row(self, job: StudyJob) -> JobRow:
        """The state of a job, for the table of progress."""
        stages = [self.evaluation(job, name) for name in job.study.variations]
        if job.trains:
            stages.insert(0, self.training(job))
        done = sum(bool(read_stage(folder).get("done")) for folder in stages)
        if self.failure(job) is not None:
            state = "failed"
        elif done == len(stages):
            state = "finished"
        else:
            state = "running"
        numbers = read_numbers(self.training(job) / "progress.csv") if job.trains else {}
        return JobRow(f"{job.name}  {done} of {len(stages)} stages", state, numbers)


def run_study_job(folder: Path, name: str, *, num_threads: int | None, command: list[str]) -> None:
    """Run what is left of a job of a study.

    An error does not leave this function, so that other jobs go on: it is written into the job's
    folder.

    Args:
        folder: The study's folder.
        name: The job's name.
        num_threads: Physics threads; None is what the config says.
        command: The command line, for the records of the runs.

    Raises:
        Interrupted: A signal came.
        JobStoppedError: Likewise, in a worker.
    """
    place = StudyFolder(folder)
    study = place.read()
    job = study.job(name)
    runner = _Runner(place, job, num_threads, command)
    place.forget_outcome(job)
    try:
        runner.run()
    except JobStoppedError:
        raise
    except Exception as error:  # noqa: BLE001  (the other jobs go on; it is said and written)
        _write_failure(place, job, runner.stage, error)
    else:
        _write_outcome(place, job, {"status": "finished"})


def _write_failure(place: StudyFolder, job: StudyJob, stage: str, error: Exception) -> None:
    """Write what ended a job into its folder, and say it."""
    text = str(error) or type(error).__name__
    if stage:  # it may have failed before it began
        _trying_to_write(lambda: place.mark_undone(job, stage), job)
    log = place.job(job) / stage / "run.log"
    tail: list[str] = []
    if log.is_file():
        tail = log.read_text(encoding="utf-8", errors="replace").splitlines()[-_TAIL:]
    facts = {
        "status": "failed",
        "stage": stage,
        "error": text,
        "is_config_error": isinstance(error, ConfigError),
        "log": str(log) if tail else None,
        "last_lines": tail,
        "traceback": traceback.format_exc(),
    }
    _write_outcome(place, job, facts)
    sys.stderr.write(f"{job.name}: {stage} failed: {text}\n")


def _write_outcome(place: StudyFolder, job: StudyJob, facts: Mapping[str, Any]) -> None:
    """Write how a job has ended into its folder, for launchers and for the end of the study."""
    text = json.dumps(facts, indent=2) + "\n"
    _trying_to_write(lambda: write_text(place.job(job) / SUMMARY, text), job)


def _trying_to_write(write: Callable[[], None], job: StudyJob) -> None:
    """Write something; if the disk is full, say it, and let the other jobs go on."""
    try:
        write()
    except OSError as error:
        sys.stderr.write(f"{job.name}: {error}\n")


class _Runner:
    """Runs the stages of one job.

    Args:
        place: The study's folder.
        job: The job.
        num_threads: Physics threads; None is what the config says.
        command: The command line.

    Attributes:
        stage: The name of the stage that runs.
    """

    def __init__(
        self, place: StudyFolder, job: StudyJob, num_threads: int | None, command: list[str]
    ) -> None:
        self._place = place
        self._job = job
        self._num_threads = num_threads
        self._command = command
        self.stage = ""

    def run(self) -> None:
        """Train if the arm does, then evaluate under every variation."""
        if self._job.trains:
            self.stage = TRAINING
            self._run(training_stage(self._place, self._job), train_job)
        plan = evaluation_plan(self._job)
        for variation in self._job.study.variations:
            self.stage = self._place.evaluation(self._job, variation).name
            stage = evaluation_stage(self._place, self._job, variation)
            self._run(stage, partial(_play, plan=plan))

    def _run(self, stage: Stage, work: Work) -> None:
        if self._num_threads is not None:
            sim = {**stage.resolved.tree["sim"], "num_threads": self._num_threads}
            stage = replace(stage, resolved=stage.resolved.changed(sim=sim))
        stage.run(work, self._command, self._begin)

    def _begin(self, line: str) -> None:
        """Say that a stage begins; what was made of an earlier run of it counts no longer."""
        self._place.mark_undone(self._job, self.stage)
        sys.stderr.write(f"{self._job.name}: {self.stage}: {line}\n")
        sys.stderr.flush()


def training_stage(place: StudyFolder, job: StudyJob) -> Stage:
    """Return the stage of a job's training."""
    folder = place.training(job)
    return Stage(folder, job.training(place.chosen(job)), verb="train", inputs={})


def evaluation_plan(job: StudyJob) -> EvaluationPlan:
    """Return the options of a job's evaluations, whose seed is the job's."""
    return EvaluationPlan(job.study.cfg.evaluate.episodes, job.seed)


def evaluation_stage(place: StudyFolder, job: StudyJob, variation: str) -> Stage:
    """Return the stage of a job's evaluation.

    Raises:
        ConfigError: The policy's file does not exist.
    """
    from embodichain.learning.checkpoints.checkpoint import find_checkpoint

    resolved = job.evaluation(variation, place.chosen(job))
    inputs: dict[str, Path] = {}
    policy = place.training(job) / CHECKPOINT if job.trains else Path(str(job.arm_cfg.policy))
    if job.trains or policy.exists():  # else it is the name of one
        file = find_checkpoint(policy).resolve()
        inputs = {"policy": file}
        resolved = resolved.changed(policy=str(file))
    config = with_suitable_arrays(evaluation_config(resolved, evaluation_plan(job)))
    return Stage(place.evaluation(job, variation), config, verb="run", inputs=inputs)


def _play(job: Job, plan: EvaluationPlan) -> float | None:
    """The work of an evaluation."""
    result = evaluate_job(job, plan)
    if result["complete"]:
        write_evaluation_receipt(job, plan, result)
    return objective_of(result)

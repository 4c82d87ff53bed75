"""Runs a study: its searches, then its jobs as one flat sweep on any launcher, then its results."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from embodichain.cli.jobs.job import start
from embodichain.cli.jobs.work.train_job import train_job
from embodichain.cli.studies.study_job import StudyFolder, run_study_job
from embodichain.cli.sweeps.sweep_plan import Plan, plan_sweep
from embodichain.cli.sweeps.sweep_progress import JobRow
from embodichain.cli.sweeps.sweeping import launch_jobs
from embodichain.cli.verb import JobOptions, command_line
from embodichain.config.study import Study, StudyJob, search_lines
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from omegaconf import DictConfig

__all__ = ["StudyStates", "folder_of", "run_jobs", "run_searches"]

JOB_CONFIG = "study_job"
"""The root config of the jobs, for Hydra's launchers."""
_SEARCH_RESULTS = "optimization_results.yaml"


def folder_of(study: Study) -> StudyFolder:
    """Return the folder of a study: the same each time, so that it goes on where it stopped."""
    return StudyFolder(Path(study.cfg.output_dir).resolve() / "studies" / study.name)


@dataclass(frozen=True)
class StudyStates:
    """What the folder of a study says about its jobs; see `JobStates`.

    Attributes:
        place: The study's folder.
        study: The study.
    """

    place: StudyFolder
    study: Study

    @property
    def how_to_continue(self) -> str:
        """See `JobStates`."""
        return "the same command does the rest"

    def begun(self) -> list[str]:
        """See `JobStates`."""
        return [job.name for job in self._begun()]

    def is_finished(self, name: str) -> bool:
        """See `JobStates`."""
        return self.place.is_finished(self.study.job(name))

    def rows(self) -> list[JobRow]:
        """See `JobStates`."""
        return [self.place.row(job) for job in self._begun()]

    def log(self, name: str) -> Path:
        """See `JobStates`."""
        return self.place.log(self.study.job(name))

    def _begun(self) -> list[StudyJob]:
        return [job for job in self.study.jobs() if self.place.job(job).is_dir()]


def run_searches(study: Study, place: StudyFolder, hydra_lines: Sequence[str]) -> None:
    """Search for the values of arms with `optimize`, with a seed that no result uses.

    A search that has chosen is not repeated.

    Args:
        study: The study.
        place: Its folder.
        hydra_lines: Overrides of Hydra's own keys, such as the launcher.
    """
    seed = max(study.cfg.seeds) + 1
    for job in study.jobs():
        search = job.arm_cfg.optimize
        if search is None or job.seed != study.cfg.seeds[0]:
            continue
        folder = place.search(job)
        words = [
            *(f"task={job.task}", *study.cfg.train, *job.arm_cfg.train, f"seed={seed}"),
            *search_lines(search),
            *("hydra/sweeper=optuna", f"hydra.sweeper.n_trials={search.trials}"),
            *("hydra.sweeper.sampler.seed=1", f"hydra.sweep.dir='{folder}'"),
            *hydra_lines,
        ]
        asked = {"words": words}
        if _has_chosen(folder, asked):
            continue
        sys.stderr.write(f"{job.arm}, {job.task}: search with seed {seed}: {folder}\n")
        start("train", train_job, JobOptions(words=tuple(words), multirun=True, quiet=True))
        results = yaml.safe_load((folder / _SEARCH_RESULTS).read_text(encoding="utf-8"))
        best = results["best_params"]
        lines = [f"{str(key).lstrip('+')}={value}" for key, value in best.items()]
        place.write_chosen(job, lines)
        (folder / "search.yaml").write_text(yaml.safe_dump(asked), encoding="utf-8")


def _has_chosen(folder: Path, asked: dict[str, Any]) -> bool:
    """Whether a search has ended that was asked for with the same words."""
    path = folder / "search.yaml"
    if not path.is_file():
        return False
    if yaml.safe_load(path.read_text(encoding="utf-8")) == asked:
        return True
    message = f"{folder} has another search; move it away"
    raise ConfigError([Problem("arms", message)])


def run_jobs(study: Study, place: StudyFolder, hydra_lines: Sequence[str], *, quiet: bool) -> None:
    """Run what is left of the jobs of a study.

    Args:
        study: The study.
        place: Its folder, with its record.
        hydra_lines: Overrides of Hydra's own keys, such as the launcher.
        quiet: Whether to show no progress.

    Raises:
        SweepError: Processes of jobs were killed, after the others have ended.
        Interrupted: A signal came.
    """
    plan = plan_jobs(study, place, hydra_lines)
    for job in study.jobs():
        place.forget_outcome(job)
    folder = place.path
    command = command_line()

    def run_job(config: DictConfig) -> None:
        sim = config.get("sim") or {}
        run_study_job(folder, str(config.job), num_threads=sim.get("num_threads"), command=command)

    launch_jobs(JOB_CONFIG, run_job, plan, StudyStates(place, study), quiet=quiet)


def plan_jobs(study: Study, place: StudyFolder, hydra_lines: Sequence[str]) -> Plan:
    """Decide how the jobs are run: launcher, cores of each."""
    jobs = study.jobs()
    first = jobs[0].evaluation(study.variations[0])
    names = ",".join(job.name for job in jobs)
    quoted = str(place.path).replace("\\", "\\\\").replace("'", "\\'")
    lines = [f"folder='{quoted}'", f"job={names}", *hydra_lines]
    return plan_sweep(JOB_CONFIG, lines, first)

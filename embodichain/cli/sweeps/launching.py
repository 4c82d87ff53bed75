"""`ClusterLauncher`, the base of launchers of sweeps on a cluster; `cluster` registers one.

A package outside names its module with an entry point of the group ``embodichain.launchers``,
called as the launcher, which is then an option of the group `hydra/launcher` too.

The machines share the sweep's folder. Whether a job is finished, and its objective, is read from
its folder, not from what the cluster returns: jobs may outlive the process that started them.
"""

from __future__ import annotations

import os
import sys
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from hydra.core.hydra_config import HydraConfig
from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn, JobStatus, run_job, setup_globals
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf, open_dict

from embodichain.cli.sweeps.sweep_jobs import has_ended, objective_in
from embodichain.config.keys.launchers import LAUNCHERS
from embodichain.utils.errors import EmbodichainError

__all__ = ["Cluster", "ClusterJob", "ClusterLauncher", "JobError", "cluster"]

Launching = TypeVar("Launching", bound="type[ClusterLauncher]")


class JobError(EmbodichainError):
    """A job of a sweep did not finish."""


@dataclass(frozen=True)
class ClusterJob:
    """A job of a sweep, which another process can call.

    Attributes:
        number: Its number in the sweep.
        overrides: Its overrides.
        folder: Its folder, absolute.
        config: The sweep's config.
        context: Hydra's loader and callbacks.
        task: Runs the composed job.
        state: Hydra's singletons.
        directory: The working directory.
        paths: `sys.path`.
    """

    number: int
    overrides: tuple[str, ...]
    folder: Path
    config: DictConfig
    context: HydraContext
    task: TaskFunction
    state: dict[Any, Any]
    directory: str
    paths: tuple[str, ...]

    def __call__(self, identity: str = "") -> JobReturn:
        """Run the job in this process.

        Args:
            identity: The cluster's name of the job.

        Raises:
            Exception: Any exception of the job.
        """
        os.chdir(self.directory)
        sys.path += [path for path in self.paths if path not in sys.path]
        setup_globals()
        Singleton.set_state(self.state)
        result = self.run(identity)
        _ = result.return_value  # raises the job's exception
        return result

    def run(self, identity: str = "") -> JobReturn:
        """Run the job in a process that has Hydra's state; its exception is in the result."""
        config = _compose(
            self.context,
            self.config,
            self.overrides,
            number=self.number,
            identity=identity or str(self.number),
        )
        HydraConfig.instance().set_config(config)
        return run_job(
            hydra_context=self.context,
            task_function=self.task,
            config=config,
            job_dir_key="hydra.sweep.dir",
            job_subdir_key="hydra.sweep.subdir",
        )


class ClusterLauncher(Launcher):
    """Starts the jobs that are not finished on a cluster, and waits for them.

    The arguments of a subclass are the keys of ``hydra.launcher``; `cpus`, if it is one, is the
    number of cores of each job, and of its physics threads.
    """

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Called by Hydra before `launch`."""
        self.context = hydra_context
        self.task = task_function
        self.config = config

    @property
    def verb(self) -> str:
        """The verb of the jobs, which is the name of their root config; or ``study_job``."""
        return str(self.config.hydra.job.config_name)

    @abstractmethod
    def run_jobs(self, jobs: Sequence[ClusterJob], sweep: Path) -> Mapping[int, str]:
        """Run jobs to their end.

        Args:
            jobs: At least one.
            sweep: The sweep's folder, absolute. `process_log` is where a job's output is.

        Returns:
            Number of each job that did not finish -> what the cluster says about it.
        """

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Called by Hydra's sweepers.

        Args:
            job_overrides: The overrides of each job.
            initial_job_idx: Number of the first.
        """
        setup_globals()
        sweep = Path(str(self.config.hydra.sweep.dir)).resolve()
        sweep.mkdir(parents=True, exist_ok=True)
        state = Singleton.get_state()
        jobs = [
            self._make_job(number, overrides, sweep, state)
            for number, overrides in enumerate(job_overrides, initial_job_idx)
        ]
        # A finished job returns at once, with the result that its folder has.
        ended = [job for job in jobs if has_ended(job.folder, self.verb)]
        results = {job.number: job.run() for job in ended}
        unfinished_jobs = [job for job in jobs if job.number not in results]
        reasons = self.run_jobs(unfinished_jobs, sweep) if unfinished_jobs else {}
        for job in unfinished_jobs:
            reason = reasons.get(job.number, "")
            results[job.number] = _read_result(job, self.verb, reason)
        return [results[job.number] for job in jobs]

    def _make_job(
        self, number: int, overrides: Sequence[str], sweep: Path, state: dict[Any, Any]
    ) -> ClusterJob:
        """Compose a job to learn its folder, and put together what another process needs."""
        config = _compose(self.context, self.config, overrides, number=number, identity=str(number))
        return ClusterJob(
            number=number,
            overrides=tuple(overrides),
            folder=sweep / str(config.hydra.sweep.subdir),
            config=self.config,
            context=self.context,
            task=self.task,
            state=state,
            directory=os.getcwd(),
            paths=tuple(sys.path),
        )


@dataclass(frozen=True)
class Cluster:
    """A launcher as a sweep names it.

    Attributes:
        launcher: Its class.
        package: A module that must be installed; empty is none.
        requires: What pip installs then.
    """

    launcher: type[ClusterLauncher]
    package: str = ""
    requires: str = ""


def cluster(
    name: str, *, package: str = "", requires: str = ""
) -> Callable[[Launching], Launching]:
    """Register a `ClusterLauncher`; arguments as of `Cluster`.

    Its module imports `package` only where jobs are run.

    Args:
        name: What `hydra/launcher` takes; also the name of its module and its entry point.
        package: A module that must be installed; empty is none.
        requires: What pip installs then.

    Returns:
        A decorator that returns its argument.

    Raises:
        ValueError: If another class has the name.
    """

    def decorate(launcher: Launching) -> Launching:
        entry = Cluster(launcher, package=package, requires=requires)
        LAUNCHERS.add(name, describes=launcher)(entry)
        return launcher

    return decorate


def _compose(
    context: HydraContext,
    config: DictConfig,
    overrides: Sequence[str],
    *,
    number: int,
    identity: str,
) -> DictConfig:
    """Compose the config of a job.

    Args:
        context: Hydra's loader and callbacks.
        config: The sweep's config.
        overrides: The job's overrides.
        number: Its number in the sweep.
        identity: The cluster's name of the job.
    """
    composed = context.config_loader.load_sweep_config(config, list(overrides))
    with open_dict(composed):
        composed.hydra.job.id = identity
        composed.hydra.job.num = number
    return composed


def _read_result(job: ClusterJob, verb: str, reason: str) -> JobReturn:
    """Return the result of a job that has ended, which its folder has, for Hydra's sweepers."""
    result = JobReturn(list(job.overrides), OmegaConf.create())
    if has_ended(job.folder, verb):
        result.status = JobStatus.COMPLETED
        result.return_value = objective_in(job.folder)
        return result
    message = f"job {job.number} did not finish"
    if reason:
        message += f": {reason}"
    result.status = JobStatus.FAILED
    result.return_value = JobError(f"{message}; {job.folder}")
    return result

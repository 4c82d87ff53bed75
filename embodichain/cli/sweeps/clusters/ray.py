"""`hydra/launcher=ray`: the jobs of a sweep as tasks of a Ray cluster.

A task whose node or process died is started again on another node, where it resumes from its
folder. hydra-ray-launcher does neither, needs an older cloudpickle, boto3, and a memory size that
Ray refuses for a running cluster.
"""

from __future__ import annotations

import os
import pickle
import sys
import time
import traceback
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from embodichain.cli.sweeps.launching import ClusterJob, ClusterLauncher, cluster
from embodichain.cli.sweeps.sweep_jobs import process_log
from embodichain.cli.terminal.process import Interrupted, signals_raise
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["RayLauncher"]

_CANCEL_TIMEOUT_S = 120.0
"""Time for jobs to save after an interrupt."""


@cluster("ray", package="ray", requires="embodichain[ray]")
class RayLauncher(ClusterLauncher):
    """Runs jobs on Ray; the arguments are the keys of `conf/hydra/launcher/ray.yaml`."""

    def __init__(
        self,
        address: str = "auto",
        cpus: int = 1,
        gpus: int = 0,
        resources: Mapping[str, float] | None = None,
        retries: int = 5,
        init: Mapping[str, Any] | None = None,
    ) -> None:
        plain_init: Any = OmegaConf.to_container(OmegaConf.create(dict(init or {})))
        self.init = {
            "address": address,
            "log_to_driver": False,
            "logging_level": "WARNING",
            **plain_init,
        }
        self.options: dict[str, Any] = {
            "num_cpus": cpus,
            "num_gpus": gpus,
            "max_retries": retries,
            "resources": dict(resources or {}),
        }

    def run_jobs(self, jobs: Sequence[ClusterJob], sweep: Path) -> Mapping[int, str]:
        """Start a task for each job, and wait for them."""
        import cloudpickle  # type: ignore[import-untyped]
        import ray

        is_own_connection = not ray.is_initialized()
        if is_own_connection:
            try:
                ray.init(**self.init)
            except (ConnectionError, OSError, ValueError, RuntimeError) as error:
                message = f"no Ray cluster: {' '.join(str(error).split())}"
                raise ConfigError([Problem("hydra.launcher.address", message)]) from error
        run = ray.remote(**self.options)(_run)
        tasks = {}
        try:
            for job in jobs:
                log = process_log(sweep, job.folder.name)
                log.parent.mkdir(exist_ok=True)
                named_run = run.options(name=f"embodichain {job.number}")
                task = named_run.remote(cloudpickle.dumps(job), str(log))
                tasks[task] = job.number
            reasons = {tasks[task]: _failure_of(task) for task in _wait_for_each(list(tasks))}
        except KeyboardInterrupt:
            sys.stderr.write("cancelling the jobs, which save\n")
            for task in tasks:
                ray.cancel(task)
            ray.wait(list(tasks), num_returns=len(tasks), timeout=_CANCEL_TIMEOUT_S)
            raise
        finally:
            if is_own_connection:
                ray.shutdown()
        return {number: reason for number, reason in reasons.items() if reason}


def _wait_for_each(tasks: list[Any]) -> Any:
    """Yield tasks as they end; returns to Python often, so that a signal is handled."""
    import ray

    while tasks:
        ended, tasks = ray.wait(tasks, num_returns=1, timeout=1.0)
        yield from ended


def _failure_of(task: Any) -> str:
    """An empty string, or why a task did not end well."""
    import ray

    try:
        return ray.get(task)
    except ray.exceptions.RayError as error:
        return " ".join(str(error).split())


def _run(pickled: bytes, log: str) -> str:
    """Run a job in a worker of Ray, with its output in a file; returns its exception's text."""
    with (
        open(log, "a", encoding="utf-8", buffering=1) as stream,
        redirect_stdout(stream),
        redirect_stderr(stream),
    ):
        try:
            with signals_raise():
                job: ClusterJob = pickle.loads(pickled)  # noqa: S301  (of the launcher)
                job(f"ray-{os.getpid()}-{time.time():.0f}")
        except Interrupted as error:
            stream.write(f"{error}\n")
            return str(error)
        except Exception as error:  # noqa: BLE001  (the launcher reports it)
            traceback.print_exc(file=stream)
            return f"{type(error).__name__}: {error}"
    return ""

"""`hydra/launcher=slurm`: the jobs of a sweep as a job array of Slurm, submitted with submitit.

A job that Slurm signals, before its time ends or for another job, saves and is queued again; its
next start resumes from its folder. Where Slurm ends or queues a job by itself (`scancel`,
`scontrol requeue`), the job only saves.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from embodichain.cli.sweeps.launching import ClusterJob, ClusterLauncher, cluster
from embodichain.cli.sweeps.sweep_jobs import is_finished, process_log
from embodichain.cli.terminal.process import INTERRUPTED, Interrupted, signals_raise
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["SlurmLauncher"]

_FILES = ".slurm"
_OVER = (
    *("COMPLETED", "CANCELLED", "FAILED", "TIMEOUT", "OUT_OF_MEMORY", "NODE_FAIL", "BOOT_FAIL"),
    *("DEADLINE", "PREEMPTED", "GONE"),
)
"""Final states of a job (squeue(1)); GONE is one that Slurm does not know any more."""
_UNKNOWN = "Invalid job id"
_CANCELLING = 120.0
"""Seconds for jobs to save after `scancel`."""
_SETTLED = 5.0
"""Seconds after which a job in a final state is not queued again."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _SlurmJob:
    """What a process of Slurm calls."""

    job: ClusterJob
    requeues: int

    def __call__(self) -> None:
        try:
            with signals_raise():
                self.job(_own_identity())
        except Interrupted as error:
            sys.stderr.write(f"{error}\n")
            self._queue_again()
            sys.exit(INTERRUPTED)

    def _queue_again(self) -> None:
        """Queue the job again unless Slurm has ended or queued it already."""
        identity, count = _own_identity(), int(os.environ.get("SLURM_RESTART_COUNT", 0))
        if _states([identity]).get(identity) != "RUNNING":
            return
        if count >= self.requeues:
            sys.stderr.write(f"not queued again: it was {count} times (hydra.launcher.requeues)\n")
            return
        sys.stderr.write(f"queued again: {count + 1} of {self.requeues} times\n")
        sys.stderr.flush()
        subprocess.run(["scontrol", "requeue", identity], check=True)


@cluster("slurm", package="submitit", requires="embodichain[slurm]")
class SlurmLauncher(ClusterLauncher):
    """Runs jobs on Slurm; the arguments are the keys of `conf/hydra/launcher/slurm.yaml`."""

    def __init__(
        self,
        partition: str | None = None,
        time: int = 60,
        cpus: int = 1,
        gpus: int = 0,
        memory_gb: float | None = None,
        array: int = 256,
        signal_s: int = 120,
        requeues: int = 20,
        setup: Sequence[str] = (),
        flags: Mapping[str, Any] | None = None,
        poll_s: float = 5.0,
    ) -> None:
        self.requeues, self.poll_s = requeues, poll_s
        optional = {"partition": partition, "gpus_per_node": gpus or None, "mem_gb": memory_gb}
        plain: Any = OmegaConf.to_container(OmegaConf.create(dict(flags or {})))
        self.parameters = {
            "timeout_min": time,
            "cpus_per_task": cpus,
            "slurm_array_parallelism": array,
            "slurm_signal_delay_s": signal_s,
            "slurm_setup": [f"export OMP_NUM_THREADS={cpus}", *setup],
            "slurm_additional_parameters": {"requeue": True, **plain},
            "stderr_to_stdout": True,
            **{
                f"slurm_{name}" if name == "partition" else name: value
                for name, value in optional.items()
                if value is not None
            },
        }

    def run_jobs(self, jobs: Sequence[ClusterJob], sweep: Path) -> Mapping[int, str]:
        """Submit an array, and wait until its jobs have ended."""
        submitted = self._submit(jobs, sweep)
        identities = {job.number: one.job_id for job, one in zip(jobs, submitted, strict=True)}
        for job, one in zip(jobs, submitted, strict=True):
            log = process_log(sweep, job.folder.name)
            log.parent.mkdir(exist_ok=True)
            log.unlink(missing_ok=True)  # a link of an earlier start
            log.symlink_to(one.paths.stdout)
        named = ", ".join(f"{number}: {name}" for number, name in identities.items())
        sys.stderr.write(f"submitted to Slurm ({named})\n")
        try:
            states = self._ended(jobs, identities)
        except KeyboardInterrupt:
            sys.stderr.write("cancelling the jobs, which save\n")
            _command("scancel", *identities.values())
            self._ended(jobs, identities, time.monotonic() + _CANCELLING)
            raise
        return {number: f"Slurm's state is {state}" for number, state in states.items()}

    def _submit(self, jobs: Sequence[ClusterJob], sweep: Path) -> list[Any]:
        import submitit

        try:
            executor = submitit.AutoExecutor(sweep / _FILES / "%j", cluster="slurm")
            executor.update_parameters(**self.parameters, slurm_job_name=sweep.name)
            with executor.batch():
                return [executor.submit(_SlurmJob(job, self.requeues)) for job in jobs]
        except (RuntimeError, OSError, submitit.core.utils.FailedJobError) as error:
            message = f"cannot submit the jobs: {' '.join(str(error).split())}"
            raise ConfigError([Problem("hydra/launcher", message)]) from error

    def _ended(
        self,
        jobs: Sequence[ClusterJob],
        identities: Mapping[int, str],
        deadline: float = float("inf"),
    ) -> dict[int, str]:
        """Wait until each job is finished or has left the queue for good; returns their states."""
        since: dict[int, float] = {}
        while True:
            states = _states(list(identities.values()))
            found = {number: states[name] for number, name in identities.items()}
            now, left = time.monotonic(), 0
            for job in jobs:
                if found[job.number] not in _OVER:
                    since.pop(job.number, None)  # it was queued again
                settled = now - since.setdefault(job.number, now) >= _SETTLED
                over = settled and found[job.number] in _OVER
                left += not (over or is_finished(job.folder, self.verb))
            if not left or now > deadline:
                return found
            time.sleep(self.poll_s)


def _own_identity() -> str:
    """The name of the job that this process belongs to: ``12``, of an array ``12_3``."""
    array = os.environ.get("SLURM_ARRAY_JOB_ID")
    return f"{array}_{os.environ['SLURM_ARRAY_TASK_ID']}" if array else os.environ["SLURM_JOB_ID"]


def _states(identities: Sequence[str]) -> dict[str, str]:
    """The state of each job; those that Slurm does not know are GONE.

    If Slurm's controller does not answer, every job is UNKNOWN.
    """
    jobs = ",".join(dict.fromkeys(name.partition("_")[0] for name in identities))
    asked = ["squeue", "--noheader", "--array", "--states=all", f"--jobs={jobs}"]
    done = _command(*asked, "--format=%i %T")
    if done.returncode and _UNKNOWN not in done.stderr:
        _log.warning("%s", done.stderr.strip() or f"squeue ended with {done.returncode}")
        return dict.fromkeys(identities, "UNKNOWN")
    found = dict(line.split() for line in done.stdout.splitlines() if line.count(" ") == 1)
    return {name: found.get(name, "GONE") for name in identities}


def _command(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(words, capture_output=True, text=True, check=False)

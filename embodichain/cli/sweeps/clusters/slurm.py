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
from embodichain.cli.sweeps.sweep_jobs import has_ended, process_log
from embodichain.cli.terminal.process import INTERRUPTED, Interrupted, signals_raise
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["SlurmLauncher"]

_FILES = ".slurm"
_FINAL_STATES = (
    "COMPLETED",
    "CANCELLED",
    "FAILED",
    "TIMEOUT",
    "OUT_OF_MEMORY",
    "NODE_FAIL",
    "BOOT_FAIL",
    "DEADLINE",
    "PREEMPTED",
    "GONE",
)
"""Final states of a job (squeue(1)); GONE is one that Slurm does not know any more."""
_UNKNOWN_JOB = "Invalid job id"
"""Part of squeue's message about a job that Slurm does not know any more."""
_CANCEL_TIMEOUT_S = 120.0
"""Time for jobs to save after `scancel`."""
_SETTLING_TIME_S = 5.0
"""Time after which a job in a final state is not queued again."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _SlurmJob:
    """The function that a process of Slurm calls."""

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
        identity = _own_identity()
        if _read_states([identity]).get(identity) != "RUNNING":
            return
        count = int(os.environ.get("SLURM_RESTART_COUNT", 0))
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
        self.requeues = requeues
        self.poll_s = poll_s
        plain_flags: Any = OmegaConf.to_container(OmegaConf.create(dict(flags or {})))
        self.parameters: dict[str, Any] = {
            "timeout_min": time,
            "cpus_per_task": cpus,
            "slurm_array_parallelism": array,
            "slurm_signal_delay_s": signal_s,
            "slurm_setup": [f"export OMP_NUM_THREADS={cpus}", *setup],
            "slurm_additional_parameters": {"requeue": True, **plain_flags},
            "stderr_to_stdout": True,
        }
        if partition is not None:
            self.parameters["slurm_partition"] = partition
        if gpus:
            self.parameters["gpus_per_node"] = gpus
        if memory_gb is not None:
            self.parameters["mem_gb"] = memory_gb

    def run_jobs(self, jobs: Sequence[ClusterJob], sweep: Path) -> Mapping[int, str]:
        """Submit an array, and wait until its jobs have ended."""
        identities: dict[int, str] = {}
        for job, submitted in zip(jobs, self._submit(jobs, sweep), strict=True):
            identities[job.number] = submitted.job_id
            log = process_log(sweep, job.folder.name)
            log.parent.mkdir(exist_ok=True)
            log.unlink(missing_ok=True)  # a link of an earlier start
            log.symlink_to(submitted.paths.stdout)
        names = ", ".join(f"{number}: {identity}" for number, identity in identities.items())
        sys.stderr.write(f"submitted to Slurm ({names})\n")
        try:
            states = self._wait(jobs, identities)
        except KeyboardInterrupt:
            sys.stderr.write("cancelling the jobs, which save\n")
            _command("scancel", *identities.values())
            self._wait(jobs, identities, deadline=time.monotonic() + _CANCEL_TIMEOUT_S)
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

    def _wait(
        self,
        jobs: Sequence[ClusterJob],
        identities: Mapping[int, str],
        deadline: float = float("inf"),
    ) -> dict[int, str]:
        """Wait until each job is finished or has left the queue for good; returns their states.

        Args:
            jobs: The jobs.
            identities: Number of each job -> its name in Slurm.
            deadline: Time after which no job is waited for, of `time.monotonic`.
        """
        last_active: dict[int, float] = {}  # number of a job -> when it was last in the queue
        while True:
            states = _read_states(list(identities.values()))
            now = time.monotonic()
            all_ended = True
            for job in jobs:
                is_final = states[identities[job.number]] in _FINAL_STATES
                if not is_final:
                    last_active[job.number] = now
                # A job that is queued again is in a final state for a moment.
                final_time = now - last_active.setdefault(job.number, now)
                has_left = is_final and final_time >= _SETTLING_TIME_S
                if not has_left and not has_ended(job.folder, self.verb):
                    all_ended = False
            if all_ended or now > deadline:
                return {number: states[identity] for number, identity in identities.items()}
            time.sleep(self.poll_s)


def _own_identity() -> str:
    """The name of the job that this process belongs to: ``12``, of an array ``12_3``."""
    array = os.environ.get("SLURM_ARRAY_JOB_ID")
    if array:
        return f"{array}_{os.environ['SLURM_ARRAY_TASK_ID']}"
    return os.environ["SLURM_JOB_ID"]


def _read_states(identities: Sequence[str]) -> dict[str, str]:
    """The state of each job; those that Slurm does not know are GONE.

    If Slurm's controller does not answer, every job is UNKNOWN.
    """
    arrays = dict.fromkeys(identity.partition("_")[0] for identity in identities)
    result = _command(
        "squeue",
        "--noheader",
        "--array",
        "--states=all",
        f"--jobs={','.join(arrays)}",
        "--format=%i %T",
    )
    if result.returncode and _UNKNOWN_JOB not in result.stderr:
        _log.warning("%s", result.stderr.strip() or f"squeue ended with {result.returncode}")
        return dict.fromkeys(identities, "UNKNOWN")
    states = dict(line.split() for line in result.stdout.splitlines() if line.count(" ") == 1)
    return {identity: states.get(identity, "GONE") for identity in identities}


def _command(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(words, capture_output=True, text=True, check=False)

"""Sweeps on a real Slurm, which is started for these tests on this machine.

An array; a preemption, a requeue and a kill in one sweep; the same sweep started again.
"""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from embodichain.cli import main
from tests.helpers.commands import Command, Commands
from tests.helpers.inside import places_of
from tests.helpers.slurm_cluster import Slurm, slurm, why_not
from tests.helpers.sweeps import TINY, check_study, learned, results, summary, write_study

GUARD = 240.0
"""Seconds after which something hangs."""
LONG = (*TINY, "seed=0,1", "total_timesteps=1600", "checkpoint.every_steps=32")
ON_SLURM = ("hydra/launcher=slurm", "hydra.launcher.poll_s=0.3")

pytestmark = [
    pytest.mark.unmeasured,
    pytest.mark.cluster,
    pytest.mark.skipif(why_not() is not None, reason=str(why_not())),
]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Slurm]:
    with slurm(tmp_path_factory.mktemp("slurm")) as found:
        yield found


@pytest.fixture
def sweep(commands: Commands, cluster: Slurm, tmp_path: Path) -> Callable[..., Command]:
    """Starts a sweep on the cluster."""

    def start(*more: str) -> Command:
        where = [f"output_dir={tmp_path}", f"hydra.sweep.dir={tmp_path}/s"]
        return commands.start("train", "-m", *ON_SLURM, *where, *more, env=cluster.env)

    return start


def until(done: Callable[[], object], what: str, process: Command) -> None:
    end = time.monotonic() + GUARD
    while not done():
        if time.monotonic() > end or process.poll() is not None:
            process.kill()
            raise AssertionError(f"{what} did not come: {process.communicate()}")
        time.sleep(0.1)


def ended(process: Command) -> tuple[int, str]:
    try:
        _, err = process.communicate(timeout=GUARD)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    return process.returncode, err


@pytest.fixture(scope="module")
def reference(cluster: Slurm, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep that nothing interrupted, on this machine."""
    folder = tmp_path_factory.mktemp("reference")
    where = [f"output_dir={folder}", f"hydra.sweep.dir={folder}/s", "hydra/launcher=basic"]
    assert main(["train", "-m", "--quiet", *where, *LONG]) == 0
    return folder / "s"


def state(cluster: Slurm, identity: str) -> str:
    asked = ("squeue", "--noheader", "--array", "--states=all", f"--jobs={identity}")
    return cluster.call(*asked, "--format=%T").strip()


def process_of(identity: str) -> int:
    """The process of a job in which the training runs."""
    wanted = f"SLURM_JOB_ID={identity}".encode()
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if b"submitit.core._submit" in (path / "cmdline").read_bytes():
                words = (path / "cmdline").read_bytes().split(b"\0")
                inside = wanted in (path / "environ").read_bytes().split(b"\0")
                if inside and b"python" in words[0]:
                    return int(path.name)
    raise AssertionError(f"no process of job {identity}")


def is_queued(cluster: Slurm, identity: str) -> bool:
    """Whether a job waits, and nothing of its last start runs: Slurm still kills that otherwise."""
    if state(cluster, identity) != "PENDING":
        return False
    wanted = f"SLURM_JOB_ID={identity}".encode()
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if wanted in (path / "environ").read_bytes().split(b"\0"):
                return False
    return True


def saved(job: Path) -> int:
    """The steps of the newest checkpoint; 0 before the first. Only the last few are kept."""
    names = [path.stem for path in (job / "checkpoints").glob("step_*.zip")]
    return max((int(name.removeprefix("step_")) for name in names), default=0)


@pytest.mark.timeout(900)
def test_jobs_are_queued_again_killed_and_go_on_to_the_bit(
    cluster: Slurm, sweep: Callable[..., Command], reference: Path, tmp_path: Path
) -> None:
    process = sweep(*LONG)
    jobs = [tmp_path / "s/0", tmp_path / "s/1"]
    until(lambda: all(map(saved, jobs)), "checkpoints", process)
    lines = cluster.call("squeue", "--noheader", "--array", "--format=%F_%K %A").splitlines()
    names = dict(line.split() for line in lines)  # an array: its elements have one number
    assert {name.partition("_")[2] for name in names} == {"0", "1"}
    assert len({name.partition("_")[0] for name in names}) == 1
    first, second = (next(n for n in names if n.endswith(end)) for end in ("_0", "_1"))

    os.kill(process_of(names[second]), signal.SIGKILL)
    cluster.call("scancel", "--signal=USR2", first)  # as Slurm does before a job's time ends
    until(lambda: is_queued(cluster, first), "requeue", process)
    count = saved(jobs[0])
    cluster.call("scontrol", "update", f"JobId={first}", "StartTime=now")  # not in two minutes
    until(lambda: saved(jobs[0]) > count, "checkpoint of the second start", process)
    cluster.call("scontrol", "requeue", first)  # as an administrator does
    until(lambda: is_queued(cluster, first), "requeue", process)
    cluster.call("scontrol", "update", f"JobId={first}", "StartTime=now")

    code, said = ended(process)
    assert code == 1, said
    log = (tmp_path / "s/.logs/0.log").read_text()
    assert "queued again: 1 of 20 times" in log and "interrupted (SIGTERM)" in log
    assert summary(jobs[0])["resumed_from"] is not None
    assert np.array_equal(learned(jobs[0]), learned(reference / "0"))
    assert results(jobs[0]) == results(reference / "0")
    assert "job 1 did not finish: Slurm's state is FAILED" in said
    assert f"job 1 failed, the end of {tmp_path}/s/.logs/1.log:" in said and "Killed" in said
    assert "1 of 2 jobs are done: 0; not done: 1; the same command with" in said

    code, said = ended(sweep(*LONG))
    assert code == 0, said
    assert f"finished already: {jobs[0]}" in said
    assert "submitted to Slurm (1: " in said and "(0: " not in said
    assert np.array_equal(learned(jobs[1]), learned(reference / "1"))
    assert results(jobs[1]) == results(reference / "1")
    assert f"{tmp_path}/s/report.html" in said


def test_what_slurm_refuses_is_said(sweep: Callable[..., Command]) -> None:
    code, said = ended(sweep(*TINY, "seed=0", "hydra.launcher.partition=nowhere"))
    assert code == 2, said
    assert "invalid partition specified: nowhere" in said


def test_a_study_runs_its_jobs_on_slurm(commands: Commands, cluster: Slurm, tmp_path: Path) -> None:
    write_study(tmp_path)
    study = ("study", "tiny", "--quiet", *ON_SLURM)
    code, said = ended(commands.start(*study, cwd=tmp_path, env=cluster.env))
    check_study(tmp_path, code, said)
    log = (tmp_path / "outputs/studies/tiny/jobs/.logs/zero-cart_pole-0.log").read_text()
    assert "zero-cart_pole-0: eval-clean: begins" in log


def test_nothing_of_a_cluster_survives(tmp_path: Path) -> None:
    with slurm(tmp_path / "short") as found:
        found.call("sbatch", "--output=/dev/null", "--wrap=sleep 600")
        time.sleep(1.0)
    marker = str(tmp_path / "short").encode()
    left = []
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if marker in (path / "environ").read_bytes() + (path / "cmdline").read_bytes():
                left.append(path.name)
    assert left == []


def test_a_secret_is_in_no_record_of_a_job(
    cluster: Slurm, sweep: Callable[..., Command], tmp_path: Path
) -> None:
    """Nor in the scripts and logs of Slurm's jobs, which get the variable from where they came."""
    keys = ("task.description=for ${oc.env:MY_SECRET}", "seed=0", "total_timesteps=32")
    cluster.env["MY_SECRET"] = "hunter2-PLANTED"
    try:
        code, said = ended(sweep(*TINY, *keys))
    finally:
        del cluster.env["MY_SECRET"]
    assert code == 0, said
    assert "PLANTED" not in said
    text = (tmp_path / "s/0/config.yaml").read_text()
    assert "description: for ${oc.env:MY_SECRET}" in text
    assert places_of("PLANTED", tmp_path) == []

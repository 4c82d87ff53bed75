"""Verbs that are killed (SIGKILL) and gone on with (docs/reliability.md)."""

from __future__ import annotations

import dataclasses
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from tests.helpers.faults import (
    CASES,
    RUN,
    SMALL,
    Case,
    folders,
    prepared,
    ran,
    resume_training,
    trained,
)
from tests.helpers.forks import Ended, Forks
from tests.helpers.half_written import CUT, TEMPORARY, half_written
from tests.helpers.ray_cluster import ray_cluster

__all__ = ["KILLS", "Killed", "contended", "killed", "shard_killed"]


@dataclass(frozen=True)
class Killed:
    """What came of a kill.

    Attributes:
        ended: Whether it had ended before.
        left: Number of temporary files that it left.
        wrong: What is not as promised.
    """

    ended: bool
    left: int
    wrong: list[str]


def killed(case: Case, forks: Forks, place: Path, draw: random.Random, times: int) -> list[Killed]:
    """Kill a case (SIGKILL) and go on with it; return what came.

    Args:
        case: The verb.
        forks: Runs it.
        place: A folder for it.
        draw: Draws the moments, evenly from the time that the case takes.
        times: Number of kills.
    """
    with prepared(case, forks, place) as start:
        undisturbed = _undisturbed(case, forks, place, start)
        found = []
        for _ in range(times):
            folder = place / f"{case.name}-killed"
            shutil.copytree(start, folder, symlinks=True)
            after = undisturbed.seconds * draw.uniform(_FIRST, 1.0)
            ended = forks.run(case.arguments, folder, kill_after=after)
            found.append(_after_kill(case, forks, folder, undisturbed, ended))
            shutil.rmtree(folder, ignore_errors=True)
        shutil.rmtree(undisturbed.folder, ignore_errors=True)
        return found


def contended(
    case: Case, forks: Forks, place: Path, draw: random.Random, times: int
) -> list[Killed]:
    """Let a second process go on with a case while the first runs, and kill both; return what came.

    The second is refused while the first lives. Arguments as of `killed`.
    """
    with prepared(case, forks, place) as start:
        undisturbed = _undisturbed(case, forks, place, start)
        found = []
        for _ in range(times):
            folder = place / f"{case.name}-killed"
            shutil.copytree(start, folder, symlinks=True)
            moments = [undisturbed.seconds * draw.uniform(0.0, 1.0) for _ in range(2)]
            first = forks.start(case.arguments, folder)
            end = time.monotonic() + undisturbed.seconds
            while (again := case.again(folder)) is None and time.monotonic() < end:
                time.sleep(0.01)
            second = None if again is None else forks.start(again, folder)
            ended = forks.wait(first, moments[0])
            wrong = []
            if second is not None:
                other = forks.wait(second, moments[1])
                refused = other.code == 2 and "another process is collecting" in other.err
                if other.code not in (0, -signal.SIGKILL) and not refused:
                    wrong.append(f"the second: exit code {other.code}: {other.err.strip()}")
            result = _after_kill(case, forks, folder, undisturbed, ended)
            found.append(dataclasses.replace(result, wrong=[*wrong, *result.wrong]))
            shutil.rmtree(folder, ignore_errors=True)
        shutil.rmtree(undisturbed.folder, ignore_errors=True)
        return found


def shard_killed(
    case: Case, forks: Forks, place: Path, draw: random.Random, times: int
) -> list[Killed]:
    """Kill a worker of Ray, while a case runs in two shards; return what came.

    The case goes on to its end by itself. Arguments as of `killed`.
    """
    with prepared(case, forks, place) as start, ray_cluster(1, cpus=4) as (cluster, nodes):
        undisturbed = _undisturbed(case, forks, place, start)
        raylet = nodes[0].all_processes["raylet"][0].process.pid
        words = [*case.arguments, *_SHARDS, f"sim.ray.address={cluster.address}"]
        found = []
        for _ in range(times):
            folder = place / f"{case.name}-killed"
            folder.mkdir()
            command = [sys.executable, "-m", "embodichain", *words]
            with subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, text=True) as run:
                workers = _workers(raylet, run)
                time.sleep(draw.uniform(0.0, 1.0) * undisturbed.seconds)
                alive = run.poll() is None
                if alive and workers:
                    os.kill(draw.choice(workers), signal.SIGKILL)
                err = run.communicate()[1]
            wrong = [] if run.returncode == 0 else [f"exit code {run.returncode}: {err.strip()}"]
            if not wrong and case.result(folder) != undisturbed.result:
                wrong.append("another result")
            wrong += half_written(folder)
            found.append(Killed(not alive, 0, wrong))
            shutil.rmtree(folder, ignore_errors=True)
        shutil.rmtree(undisturbed.folder, ignore_errors=True)
        return found


def _workers(raylet: int, run: subprocess.Popen[str]) -> list[int]:
    """Wait for two shards, and return the process ids of a node's workers that have one."""
    while run.poll() is None:
        found = []
        for task in Path(f"/proc/{raylet}/task").iterdir():
            for child in (task / "children").read_text().split():
                with suppress(OSError):
                    if b"RemoteShard" in Path(f"/proc/{child}/cmdline").read_bytes():
                        found.append(int(child))
        if len(found) == _SHARD_COUNT:
            return found
        time.sleep(0.05)
    return []


@dataclass(frozen=True)
class _Undisturbed:
    """A case that ran to its end.

    Attributes:
        folder: Where.
        seconds: How long it took.
        result: Of the case.
    """

    folder: Path
    seconds: float
    result: object


def _undisturbed(case: Case, forks: Forks, place: Path, start: Path) -> _Undisturbed:
    folder = place / f"{case.name}-whole"
    for _ in range(2):  # the first imports what later ones do not import again
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(start, folder, symlinks=True)
        begun = time.monotonic()
        ended = forks.run(case.arguments, folder)
        seconds = time.monotonic() - begun
    if ended.code or half_written(folder):
        raise RuntimeError(f"{case.name}: {ended.err} {half_written(folder)}")
    return _Undisturbed(folder, seconds, case.result(folder))


def _after_kill(
    case: Case,
    forks: Forks,
    folder: Path,
    undisturbed: _Undisturbed,
    ended: Ended,
) -> Killed:
    damage = half_written(folder)
    left = [what for what in damage if what.endswith(TEMPORARY)]
    wrong = [what for what in damage if what not in left and not what.endswith(CUT)]
    wrong += [] if ended.code in (0, -signal.SIGKILL) else [f"exit code {ended.code}"]
    if ended.code:
        again = forks.run(case.again(folder) or case.arguments, folder)
        if again.code:
            wrong.append(f"again: exit code {again.code}: {again.err.strip()}")
        elif case.result(folder) != undisturbed.result:
            wrong.append("again: another result")
    if case.part is not None:
        wrong += case.part(folder, undisturbed.folder)
    for log in folders(folder, "**/rollout*.mcap") if left else ():
        forks.run(("replay", str(log)), folder)  # any command that reads there
    for checkpoints in folders(folder, "**/checkpoints") if left else ():
        forks.run(("report", "--no-film", str(checkpoints.parent)), folder)
    wrong += [f"again: {w}" for w in half_written(folder) if not w.endswith(CUT)]
    return Killed(ended.code == 0, len(left), wrong)


def _logs_agree(folder: Path, whole: Path) -> list[str]:
    """Compare the logs of a folder with the whole one, as far as they go."""
    from embodichain import recording
    from embodichain.recording.format.log_error import LogError

    wrong = []
    with recording.open(folders(whole, "outputs/2*/*/rollout.mcap")[-1]) as log:
        wanted = log.read()
    for path in folders(folder, "outputs/2*/*/rollout.mcap"):
        try:
            with recording.open(path) as log:
                found = log.read()
        except LogError:
            continue  # no step is in it
        count = len(found)
        for name in found if count else ():
            if not np.array_equal(found[name], wanted[name][:count], equal_nan=True):
                wrong.append(f"{path}: {name} differs in {count} steps")
    return wrong


_LONG = (*RUN[:2], *SMALL[:3], "max_steps=1500", "policy=zero", "quiet=true", "episodes=100")
_SHARD_COUNT = 2
_SHARDS = ("sim.backend=ray", f"sim.shards={_SHARD_COUNT}", "sim.ray.save_every=200")
_FIRST = 0.2
"""Of the time of a command, what passes before its config is composed."""


def _recorded(name: str, *more: str) -> Case:
    return Case(name, (*_LONG, *more), ran, part=_logs_agree)


def _learning(name: str, *more: str) -> Case:
    words = ("train", "task=cart_pole", "num_envs=2", "seed=1", "sim.num_threads=1", "quiet=true")
    often = ("checkpoint.every_steps=64", "checkpoint.keep=2", "eval.episodes=0")
    return Case(name, (*words, *often, *more), trained, again=resume_training)


def _sharded(place: Path) -> object:
    from embodichain import recording

    (job,) = (path.parent for path in folders(place, "outputs/2*/*/summary.json"))
    with recording.open(job) as log:
        data = log.read()
        return [(name, data[name].tobytes()) for name in data]


_CASES = (
    _recorded("run"),
    _recorded("run-keyframes", "record.state=keyframes"),
    _recorded("run-every", "record.every=2"),
    _recorded("run-max_mb", "record.max_mb=0.5"),
    _learning("train-ppo", "total_timesteps=384", "algo.n_steps=16", "algo.batch_size=16"),
    _learning(
        *("train-sac", "algo=sac", "total_timesteps=384", "algo.learning_starts=50"),
        "checkpoint.replay_buffer=true",
    ),
    _learning("train-rsl_rl", "algo=rsl_rl_ppo", "total_timesteps=384"),
    _learning("train-skrl", "algo=skrl_ppo", "total_timesteps=384"),
    CASES["collect"],
)
KILLS: dict[str, Callable[[Forks, Path, random.Random, int], list[Killed]]] = {
    **{case.name: partial(killed, case) for case in _CASES},
    "collect-two": partial(contended, CASES["collect"]),
    "run-ray": partial(shard_killed, Case("run-ray", _LONG, _sharded)),
}
"""Commands to kill, with all options of recording and learners of each kind."""

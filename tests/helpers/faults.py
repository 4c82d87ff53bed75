"""Commands of which the n-th call on a file fails: `nth_call.c`, and a process that forks them.

The process has imported everything, so that a try costs no imports. It runs with the library
preloaded; each command is a fork of it, in which the n-th call on files below a folder fails.
"""

from __future__ import annotations

import ctypes
import errno
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
import yaml

__all__ = [
    "CASES",
    "KILLS",
    "Case",
    "Forks",
    "Killed",
    "Tried",
    "build",
    "half_written",
    "killed",
    "sampled",
    "tried",
]

ERRORS = (errno.EIO, errno.ENOSPC)
SOURCE = Path(__file__).with_name("nth_call.c")
_WARM = (
    *("mujoco", "numpy", "torch", "stable_baselines3", "mcap", "h5py", "pandas", "pyarrow.parquet"),
    *(
        "embodichain.cli.verbs.run",
        "embodichain.cli.verbs.train",
        "embodichain.cli.verbs.collect",
        "matplotlib",
    ),
    *(
        "embodichain.cli.verbs.export",
        "embodichain.cli.verbs.report",
        "embodichain.cli.verbs.recover",
    ),
    *("embodichain.recording.export.tables", "embodichain.recording.export.formats.hdf5"),
    *(
        "embodichain.recording.export.episode_formats.robomimic",
        "embodichain.recording.export.formats.lerobot",
        "embodichain.learning.training.train",
        "hydra",
        "PIL.Image",
    ),
    *(
        "embodichain.config.environments.factory",
        "embodichain.cli.sweeps.sweeping",
        "rosbags.typesys",
    ),
    *(
        "embodichain.cli.results.report_page",
        "embodichain.recording.export.formats.ros2",
        "embodichain.tasks",
    ),
)
_TEMPORARY = " is temporary"
_CUT = "EndOfFile"
_ALONE = ("OpenGL", "mujoco.", "__", "IPython")
"""Modules that start something where they are imported, which a fork would share."""


def build(folder: Path) -> Path | None:
    """Build the library; None where there is no gcc."""
    gcc = shutil.which("gcc")
    if gcc is None:
        return None
    path = folder / "nth_call.so"
    command = [gcc, "-O1", "-shared", "-fPIC", "-o", str(path), str(SOURCE), "-ldl"]
    subprocess.run(command, check=True)
    return path


@dataclass(frozen=True)
class Ended:
    """A command that has ended.

    Attributes:
        code: Its exit code; negative for a signal.
        err: What it wrote to stderr.
        count: Number of calls that were counted.
        failed: The call that failed, and its file; empty if none did.
    """

    code: int
    err: str
    count: int
    failed: str


class Forks:
    """Runs commands, each in a fork of a process that has imported everything.

    Args:
        library: Of `build`.
    """

    def __init__(self, library: Path) -> None:
        environment = {**os.environ, "LD_PRELOAD": str(library), "PYTHONFAULTHANDLER": "1"}
        environment |= {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            text=True,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        stdin = self._process.stdin
        if stdin is not None:
            stdin.close()
        self._process.wait()

    def run(
        self,
        arguments: Sequence[str],
        below: Path,
        n: int = 0,
        number: int = errno.EIO,
        *,
        stays: bool = False,
        kill_after: float | None = None,
    ) -> Ended:
        """Run a command.

        Args:
            arguments: After ``embodichain``.
            below: The folder whose files are counted; also the working directory.
            n: The call that fails, from 1; 0 is none.
            number: The error's number.
            stays: Whether all later calls that write fail too, as on a full disk.
            kill_after: Seconds after which it is killed (SIGKILL), unless it has ended.
        """
        process = self._process
        if process.stdin is None or process.stdout is None:
            raise RuntimeError("no pipes")
        asked = {"arguments": [*arguments], "below": str(below), "n": n, "number": number}
        process.stdin.write(json.dumps({**asked, "stays": stays, "kill": kill_after}) + "\n")
        process.stdin.flush()
        answer = process.stdout.readline()
        if not answer:
            raise RuntimeError(f"the process that forks has ended: {process.wait()}")
        return Ended(**json.loads(answer))


def _serve() -> None:
    """Answer requests until there are no more."""
    import importlib
    from contextlib import suppress

    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for name in _WARM:
        with suppress(ImportError):
            importlib.import_module(name)
    for line in sys.stdin:
        asked = json.loads(line)
        answer = _forked(asked)
        for name in answer.pop("imported"):  # by the first of a kind, and by no other again
            with suppress(Exception):
                importlib.import_module(name)
        out.write(json.dumps(answer) + "\n")
        out.flush()


def _forked(asked: dict[str, Any]) -> dict[str, Any]:
    import tempfile

    with tempfile.TemporaryFile() as err, tempfile.TemporaryFile() as told:
        pid = os.fork()
        if not pid:
            _child(asked, err.fileno(), told.fileno())
        status = _waited(pid, asked["kill"])
        err.seek(0)
        told.seek(0)
        nothing = b'{"count": -1, "failed": "", "imported": []}'
        counted = json.loads(told.read() or nothing)
        code = os.waitstatus_to_exitcode(status)
        return {"code": code, "err": err.read().decode(errors="replace"), **counted}


def _waited(pid: int, kill_after: float | None) -> int:
    """Wait for a fork, and kill it if it takes longer; returns how it ended."""
    if kill_after is not None:
        end = time.monotonic() + kill_after
        while time.monotonic() < end:
            if os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT | os.WNOHANG) is not None:
                break
            time.sleep(0.005)
        else:
            os.kill(pid, signal.SIGKILL)
    return os.waitpid(pid, 0)[1]


def _child(asked: dict[str, Any], err: int, told: int) -> None:
    """Run a command in a fork, and end it."""
    from embodichain.cli.app import main

    code, before = 99, set(sys.modules)
    try:
        os.dup2(err, 1)
        os.dup2(err, 2)
        sys.stdout = io.TextIOWrapper(io.FileIO(1, "w"), line_buffering=True)
        sys.stderr = io.TextIOWrapper(io.FileIO(2, "w"), line_buffering=True)
        os.chdir(asked["below"])
        library: Any = ctypes.CDLL(None)
        library.nth_failed.restype = ctypes.c_char_p
        library.nth_arm(asked["below"].encode(), asked["n"], asked["number"], int(asked["stays"]))
        code = main(asked["arguments"])
        sys.stdout.flush()
        sys.stderr.flush()
        counted = {"count": library.nth_count(), "failed": library.nth_failed().decode()}
        counted["imported"] = [
            name for name in sys.modules if name not in before and not name.startswith(_ALONE)
        ]
        os.write(told, json.dumps(counted).encode())
    finally:
        os._exit(code)


# -- what is asked after a fault -------------------------------------------------------------------


def half_written(folder: Path) -> list[str]:
    """What below a folder is a temporary file, or not whole under its final name.

    A log may be cut, since it says so and is read up to there; so may the last line of a list.
    """
    found = []
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if ".part" in path.name and path.name.startswith("."):
            found.append(f"{name}{_TEMPORARY}")
        elif path.is_file() and (why := _damage(path)):
            found.append(f"{name}: {why}")
        elif path.is_symlink() and not path.exists():
            found.append(f"{name} links to nothing")
    return found


def _damage(path: Path) -> str:
    check = _CHECKS.get(path.suffix)
    if check is None:
        return ""
    try:
        check(path)
    except Exception as error:  # noqa: BLE001  (any reader's, which is the answer)
        return f"{type(error).__name__}: {error}"[:200]
    return ""


def _zip(path: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        if archive.testzip() is not None:
            raise ValueError("damaged")


def _page(path: Path) -> None:
    if not path.read_text().rstrip().endswith("</html>"):
        raise ValueError("cut")


def _picture(path: Path) -> None:
    from PIL import Image

    with Image.open(path) as image:
        image.load()


def _log(path: Path) -> None:
    from embodichain.recording.format.log_error import LogError
    from embodichain.recording.read.chunks import LogReader

    if not path.stat().st_size:
        return
    try:
        with LogReader(path) as reader:
            for _ in reader.messages():
                pass
    except LogError:
        if path.name.startswith("recovered"):
            raise


def _config(path: Path) -> None:
    text = path.read_text()
    if text and yaml.safe_load(text) is None:
        raise ValueError("empty")


def _table(path: Path) -> None:
    import pyarrow.parquet as pq

    pq.read_table(path)


def _hdf5(path: Path) -> None:
    import h5py

    with h5py.File(path) as file:
        file.visititems(lambda _, item: item[()] if isinstance(item, h5py.Dataset) else None)


_CHECKS: dict[str, Callable[[Path], object]] = {
    **dict.fromkeys((".zip", ".npz"), _zip),
    **{".json": lambda path: json.loads(path.read_text()), ".yaml": _config, ".html": _page},
    **{".png": _picture, ".mcap": _log, ".parquet": _table, ".hdf5": _hdf5},
}


@dataclass(frozen=True)
class Case:
    """A verb whose calls fail.

    Attributes:
        name: Of the case.
        arguments: The command; ``{}`` is its folder.
        result: Of the folder after a command that ended well: what must be the same.
        prepare: Commands before it, in which nothing fails.
        again: The command after a fault; None is the same.
        output: The final name that must not exist after a failure, relative; empty is any.
        part: Of a folder in which it was killed, and of a whole one: what differs in what is there.
    """

    name: str
    arguments: tuple[str, ...]
    result: Callable[[Path], object]
    prepare: tuple[tuple[str, ...], ...] = ()
    again: Callable[[Path], tuple[str, ...] | None] = field(default=lambda folder: None)
    output: str = ""
    part: Callable[[Path, Path], list[str]] | None = None


@dataclass(frozen=True)
class Tried:
    """What came of one fault.

    Attributes:
        n: The call that failed.
        number: The error's number.
        ended: How the command ended.
        wrong: What is not as promised; empty if all is.
    """

    n: int
    number: int
    ended: Ended
    wrong: list[str]


def sampled(count: int, most: int) -> list[int]:
    """At most so many of the numbers from 1 to `count`, evenly, with the first and the last."""
    if count <= most:
        return list(range(1, count + 1))
    return sorted({1 + round(i * (count - 1) / (most - 1)) for i in range(most)})


@contextmanager
def _prepared(case: Case, forks: Forks, place: Path) -> Iterator[Path]:
    """A folder in which the commands before a case were run, kept as a copy for each try."""
    start = place / f"{case.name}-start"
    start.mkdir()
    for arguments in case.prepare:
        ended = forks.run(arguments, start)
        if ended.code:
            raise RuntimeError(f"{case.name}: {' '.join(arguments)}: {ended.err}")
    try:
        yield start
    finally:
        shutil.rmtree(start, ignore_errors=True)


def tried(
    case: Case,
    forks: Forks,
    place: Path,
    most: int,
    errors: Sequence[int] = ERRORS,
    *,
    stays: bool = False,
    report: Callable[[Tried], None] = lambda found: None,
) -> tuple[int, list[Tried]]:
    """Let calls of a case fail one after another; return how many there are, and what came.

    Args:
        case: The verb.
        forks: Runs it.
        place: A folder for it.
        most: Number of calls that fail, evenly over all.
        errors: The errors, in turn; with a negative `most`, all calls fail with each.
        stays: Whether all later writes fail too.
        report: Called with each result.
    """
    with _prepared(case, forks, place) as start:
        whole = place / f"{case.name}-whole"
        shutil.copytree(start, whole, symlinks=True)
        ended = forks.run(case.arguments, whole)
        if ended.code or half_written(whole):
            raise RuntimeError(f"{case.name}: {ended.err} {half_written(whole)}")
        wanted = case.result(whole)
        found = []
        if most < 0:
            chosen = [(n, e) for n in range(1, ended.count + 1) for e in errors]
        else:
            numbers = sampled(ended.count, most)
            chosen = [(n, errors[i % len(errors)]) for i, n in enumerate(numbers)]
        for n, number in chosen:
            folder = place / f"{case.name}-{n}"
            shutil.copytree(start, folder, symlinks=True)
            result = _try(case, forks, folder, n, number, wanted, stays=stays)
            shutil.rmtree(folder, ignore_errors=True)
            found.append(result)
            report(result)
        shutil.rmtree(whole, ignore_errors=True)
        return ended.count, found


def _try(
    case: Case, forks: Forks, folder: Path, n: int, number: int, wanted: object, *, stays: bool
) -> Tried:
    ended = forks.run(case.arguments, folder, n, number, stays=stays)
    wrong = _said_wrong(ended)
    wrong += half_written(folder)
    if case.output and ended.code and (folder / case.output).exists():
        wrong.append(f"{case.output} is there")
    if not ended.code:
        wrong += [] if case.result(folder) == wanted else ["exit code 0, and another result"]
        return Tried(n, number, ended, wrong)
    again = forks.run(case.again(folder) or case.arguments, folder)
    if again.code:
        wrong.append(f"again: exit code {again.code}: {again.err.strip()}")
    elif case.result(folder) != wanted:
        wrong.append("again: another result")
    wrong += [f"again: {what}" for what in half_written(folder)]
    return Tried(n, number, ended, wrong)


def _said_wrong(ended: Ended) -> list[str]:
    """What is wrong with exit code and stderr of a command in which a call failed."""
    wrong = []
    if not ended.failed:  # it made fewer calls this time: a log is flushed every second
        return [f"exit code {ended.code}: {ended.err[-300:]}"] if ended.code else []
    if ended.code not in (0, 1):
        wrong.append(f"exit code {ended.code}")
    for word in ("Traceback", "Exception ignored", "Error executing", "Fatal"):
        if word in ended.err:
            wrong.append(f"stderr has {word!r}")
    errors = re.findall(r"^error: .*", ended.err, re.M)
    if ended.code == 1 and len(errors) != 1:
        wrong.append(f"{len(errors)} lines of errors")
    reason = os.strerror(errno.EIO), os.strerror(errno.ENOSPC)
    if not any(text in ended.err for text in reason):
        wrong.append("the reason is not said")
    return wrong


@dataclass(frozen=True)
class Killed:
    """What came of a kill.

    Attributes:
        after: Seconds after which the command was killed.
        ended: Whether it had ended before.
        left: Number of temporary files that it left.
        wrong: What is not as promised.
    """

    after: float
    ended: bool
    left: int
    wrong: list[str]


def killed(
    case: Case,
    forks: Forks,
    place: Path,
    moments: Sequence[float],
    report: Callable[[Killed], None] = lambda found: None,
) -> list[Killed]:
    """Kill a case (SIGKILL) and go on with it; return what came.

    Args:
        case: The verb.
        forks: Runs it.
        place: A folder for it.
        moments: Shares of the time that it takes.
        report: Called with each result.
    """
    with _prepared(case, forks, place) as start:
        whole = place / f"{case.name}-whole"
        shutil.copytree(start, whole, symlinks=True)
        forks.run(case.arguments, whole)  # imports what the next does not import again
        shutil.rmtree(whole)
        shutil.copytree(start, whole, symlinks=True)
        begun = time.monotonic()
        ended = forks.run(case.arguments, whole)
        seconds = time.monotonic() - begun
        if ended.code or half_written(whole):
            raise RuntimeError(f"{case.name}: {ended.err} {half_written(whole)}")
        wanted = case.result(whole)
        found = []
        for moment in moments:
            folder = place / f"{case.name}-killed"
            shutil.copytree(start, folder, symlinks=True)
            after = moment * seconds
            ended = forks.run(case.arguments, folder, kill_after=after)
            result = _after_kill(case, forks, folder, whole, ended, after, wanted)
            shutil.rmtree(folder, ignore_errors=True)
            found.append(result)
            report(result)
        shutil.rmtree(whole, ignore_errors=True)
        return found


def _after_kill(
    case: Case,
    forks: Forks,
    folder: Path,
    whole: Path,
    ended: Ended,
    after: float,
    wanted: object,
) -> Killed:
    damage = half_written(folder)
    left = [what for what in damage if what.endswith(_TEMPORARY)]
    wrong = [what for what in damage if what not in left and not what.endswith(_CUT)]
    wrong += [] if ended.code in (0, -signal.SIGKILL) else [f"exit code {ended.code}"]
    if ended.code:
        again = forks.run(case.again(folder) or case.arguments, folder)
        if again.code:
            wrong.append(f"again: exit code {again.code}: {again.err.strip()}")
        elif case.result(folder) != wanted:
            wrong.append("again: another result")
    if case.part is not None:
        wrong += case.part(folder, whole)
    for log in _folders(folder, "**/rollout*.mcap"):
        forks.run(("replay", str(log)), folder)  # any command that reads there
    wrong += [f"again: {w}" for w in half_written(folder) if not w.endswith(_CUT)]
    return Killed(after, ended.code == 0, len(left), wrong)


# -- the cases -------------------------------------------------------------------------------------

_SMALL = ("num_envs=2", "seed=1", "sim.num_threads=1", "record.compression=none")
_TRAIN = (
    *("train", "task=cart_pole", "num_envs=2", "seed=1", "sim.num_threads=1"),
    *("total_timesteps=96", "algo.n_steps=16", "algo.batch_size=16", "algo.n_epochs=1"),
    *("checkpoint.every_steps=32", "checkpoint.keep=2", "eval.episodes=0", "quiet=true"),
)
_RUN = ("run", "task=cart_pole", *_SMALL, "max_steps=60", "policy=zero", "quiet=true")
_COLLECT = ("collect", "task=reach", *_SMALL, "policy=random", "quiet=true")


def _folders(place: Path, pattern: str) -> list[Path]:
    return sorted(place.glob(pattern), key=lambda path: path.stat().st_mtime_ns)


def _steps_of(log: Path) -> object:
    from embodichain import recording

    with recording.open(log) as opened:
        data = opened.read()
        return [(name, data[name].tobytes()) for name in data]


def _ran(place: Path) -> object:
    newest = _folders(place, "outputs/2*/*/rollout.mcap")[-1]
    summary = json.loads((newest.parent / "summary.json").read_text())
    return summary["status"], summary["control_steps"], _steps_of(newest)


def _trained(place: Path) -> object:
    import torch

    (*_, job) = (path.parent for path in _folders(place, "outputs/2*/*/summary.json"))
    summary = json.loads((job / "summary.json").read_text())
    with zipfile.ZipFile(job / "checkpoints/final.zip") as archive:
        if "policy.pt" in archive.namelist():  # of rsl_rl or skrl
            state = torch.jit.load(io.BytesIO(archive.read("policy.pt"))).state_dict()  # type: ignore[no-untyped-call]
        else:
            state = torch.load(io.BytesIO(archive.read("policy.pth")), weights_only=True)
    values = [summary[key] for key in ("status", "env_steps", "mean_return", "objective")]
    return values, {key: value.numpy().tobytes() for key, value in state.items()}


def _resume_training(place: Path) -> tuple[str, ...] | None:
    from embodichain.learning.training.keeper import find_resumable
    from embodichain.utils.errors import EmbodichainError

    for folder in (path.parent for path in _folders(place, "outputs/2*/*/checkpoints")[::-1]):
        try:
            find_resumable(folder)
        except EmbodichainError:
            continue
        return ("train", f"resume={folder}", "quiet=true")
    return None


def _collected(place: Path) -> object:
    from embodichain.recording.demos.collection import read_collection

    folder = _folders(place, "outputs/2*/*/successes.jsonl")[-1].parent
    found = [(e.attempt, e.steps, e.total_reward) for e in read_collection(folder)]
    return found, json.loads((folder / "summary.json").read_text())["status"]


def _resume_collection(place: Path) -> tuple[str, ...] | None:
    folders = [path.parent for path in _folders(place, "outputs/2*/*/successes.jsonl")]
    ready = [path for path in folders if (path / "config.yaml").stat().st_size]
    return ("collect", f"resume={ready[-1]}", "quiet=true") if ready else None


def _bytes_of(name: str) -> Callable[[Path], object]:
    def read(place: Path) -> object:
        path = place / name
        files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
        return [(str(file.relative_to(place)), file.read_bytes()) for file in files]

    return read


def _is_there(name: str) -> Callable[[Path], object]:
    """For a format with numbers of its own in each file."""
    return lambda place: (place / name).stat().st_size > 1000


def _page_of(place: Path) -> object:
    return (place / "r/report.html").read_text().count("<svg")


def _exported(form: str, output: str, *more: str) -> Case:
    made = (*_RUN[:-1], "episodes=1", "hydra.run.dir=r", "quiet=true")
    export = ("export", "r/rollout.mcap", "--format", form, "-o", output, *more)
    name = f"export-{form}"
    result = _is_there(output) if form == "rrd" else _bytes_of(output)
    return Case(name, export, result, (made,), output=output)


CASES: dict[str, Case] = {
    case.name: case
    for case in (
        Case("run", _RUN, _ran),
        Case("train", _TRAIN, _trained, again=_resume_training),
        Case(
            "collect",
            (*_COLLECT, "episodes=3", "collect.success_steps=1"),
            _collected,
            again=_resume_collection,
        ),
        *(
            _exported(form, f"x.{form}")
            for form in ("csv", "npz", "parquet", "hdf5", "ros2", "rrd")
        ),
        _exported("lerobot", "x_lerobot"),
        Case("report", ("report", "r"), _page_of, ((*_RUN[:-1], "hydra.run.dir=r", "quiet=true"),)),
        Case(
            "recover",
            ("recover", "r/rollout.mcap", "recovered.mcap"),
            _bytes_of("recovered.mcap"),
            ((*_RUN[:-1], "hydra.run.dir=r", "quiet=true"),),
            output="recovered.mcap",
        ),
    )
}


def _logs_agree(folder: Path, whole: Path) -> list[str]:
    """Compare the logs of a folder with the whole one, as far as they go."""
    from embodichain import recording
    from embodichain.recording.format.log_error import LogError

    wrong = []
    with recording.open(_folders(whole, "outputs/2*/*/rollout.mcap")[-1]) as log:
        wanted = log.read()
    for path in _folders(folder, "outputs/2*/*/rollout.mcap"):
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


_LONG = (*_RUN[:2], *_SMALL[:3], "max_steps=1500", "policy=zero", "quiet=true", "episodes=100")


def _recorded(name: str, *more: str) -> Case:
    return Case(name, (*_LONG, *more), _ran, part=_logs_agree)


def _learning(name: str, *more: str) -> Case:
    words = ("train", "task=cart_pole", "num_envs=2", "seed=1", "sim.num_threads=1", "quiet=true")
    often = ("checkpoint.every_steps=64", "checkpoint.keep=2", "eval.episodes=0")
    return Case(name, (*words, *often, *more), _trained, again=_resume_training)


KILLS: dict[str, Case] = {
    case.name: case
    for case in (
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
}
"""Commands to kill, with all options of recording and learners of each kind."""

if __name__ == "__main__":
    _serve()

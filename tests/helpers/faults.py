"""Verbs of which one call on a file fails, and what is promised then (docs/reliability.md)."""

from __future__ import annotations

import errno
import io
import json
import os
import re
import shutil
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tests.helpers.forks import Ended, Forks
from tests.helpers.half_written import half_written

__all__ = [
    "CASES",
    "COLLECT",
    "RUN",
    "SMALL",
    "Case",
    "Tried",
    "collected",
    "folders",
    "kinds",
    "prepared",
    "ran",
    "resume_collection",
    "resume_training",
    "sampled",
    "trained",
    "tried",
]

ERRORS = (errno.EIO, errno.ENOSPC)
_NUMBERS = r"\b[0-9a-f]{8}-[0-9]+-[0-9]+-[0-9]+\b|[0-9]+"
"""Processes in names of temporary files, and other numbers."""
_VERBS_OF_TASKS = ("run", "train", "collect")
"""Verbs whose arguments `validate` takes; it starts no thread."""


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


def kinds(calls: Sequence[str]) -> list[int]:
    """The first number of each kind of call: what is called, on which file but for numbers."""
    first: dict[str, int] = {}
    for n, call in enumerate(calls, start=1):
        first.setdefault(re.sub(_NUMBERS, "#", call), n)
    return [*first.values()]


@contextmanager
def prepared(case: Case, forks: Forks, place: Path) -> Iterator[Path]:
    """A folder in which the commands before a case were run, kept as a copy for each try."""
    start = place / f"{case.name}-start"
    start.mkdir()
    if case.arguments[0] in _VERBS_OF_TASKS:
        forks.warm(("validate", *case.arguments[1:]))
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
    chosen: Callable[[list[str]], Sequence[int]] | None = None,
    errors: Sequence[int] = ERRORS,
    *,
    stays: bool = False,
    again_every: int = 1,
    report: Callable[[Tried], None] = lambda found: None,
) -> tuple[list[str], list[Tried]]:
    """Let calls of a case fail one after another; return all its calls, and what came.

    Args:
        case: The verb.
        forks: Runs it.
        place: A folder for it.
        chosen: Of its calls, the numbers of those that fail, each with one error; None: all, each
            with all errors.
        errors: The errors, in turn.
        stays: Whether all later writes fail too.
        again_every: Of so many tries one is followed by the command again.
        report: Called with each result.
    """
    with prepared(case, forks, place) as start:
        whole = place / f"{case.name}-whole"
        shutil.copytree(start, whole, symlinks=True)
        ended = forks.run(case.arguments, whole)
        if ended.code or half_written(whole):
            raise RuntimeError(f"{case.name}: {ended.err} {half_written(whole)}")
        wanted = case.result(whole)
        faults: list[tuple[int, int]]
        if chosen is None:
            faults = [(n, error) for n in range(1, len(ended.calls) + 1) for error in errors]
        else:
            numbers = chosen(ended.calls)
            faults = [(n, errors[i % len(errors)]) for i, n in enumerate(numbers)]
        found = []
        for i, (n, number) in enumerate(faults):
            folder = place / f"{case.name}-{n}"
            shutil.copytree(start, folder, symlinks=True)
            again = i % again_every == 0
            result = _try(case, forks, folder, n, number, wanted, stays=stays, again=again)
            shutil.rmtree(folder, ignore_errors=True)
            found.append(result)
            report(result)
        shutil.rmtree(whole, ignore_errors=True)
        return ended.calls, found


def _try(
    case: Case,
    forks: Forks,
    folder: Path,
    n: int,
    number: int,
    wanted: object,
    *,
    stays: bool,
    again: bool,
) -> Tried:
    ended = forks.run(case.arguments, folder, n, number, stays=stays)
    wrong = _said_wrong(ended)
    wrong += half_written(folder)
    if case.output and ended.code and (folder / case.output).exists():
        wrong.append(f"{case.output} is there")
    if not ended.code:
        wrong += [] if case.result(folder) == wanted else ["exit code 0, and another result"]
        return Tried(n, number, ended, wrong)
    if not again:
        return Tried(n, number, ended, wrong)
    second = forks.run(case.again(folder) or case.arguments, folder)
    if second.code:
        wrong.append(f"again: exit code {second.code}: {second.err.strip()}")
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


SMALL = ("num_envs=2", "seed=1", "sim.num_threads=1", "record.compression=none")
_TRAIN = (
    *("train", "task=cart_pole", "num_envs=2", "seed=1", "sim.num_threads=1"),
    *("total_timesteps=96", "algo.n_steps=16", "algo.batch_size=16", "algo.n_epochs=1"),
    *("checkpoint.every_steps=32", "checkpoint.keep=2", "eval.episodes=0", "quiet=true"),
)
RUN = (
    *("run", "task=cart_pole", *SMALL, "max_steps=60", "policy=zero", "scene_png=false"),
    "quiet=true",
)
COLLECT = ("collect", "task=reach", *SMALL, "policy=random", "quiet=true")


def folders(place: Path, pattern: str) -> list[Path]:
    return sorted(place.glob(pattern), key=lambda path: path.stat().st_mtime_ns)


def _steps_of(log: Path) -> object:
    from embodichain import recording

    with recording.open(log) as opened:
        data = opened.read()
        return [(name, data[name].tobytes()) for name in data]


def ran(place: Path) -> object:
    newest = folders(place, "outputs/2*/*/rollout.mcap")[-1]
    summary = json.loads((newest.parent / "summary.json").read_text())
    return summary["status"], summary["control_steps"], _steps_of(newest)


def trained(place: Path) -> object:
    import torch

    (*_, job) = (path.parent for path in folders(place, "outputs/2*/*/summary.json"))
    summary = json.loads((job / "summary.json").read_text())
    with zipfile.ZipFile(job / "checkpoints/final.zip") as archive:
        if "policy.pt" in archive.namelist():  # of rsl_rl or skrl
            state = torch.jit.load(io.BytesIO(archive.read("policy.pt"))).state_dict()  # type: ignore[no-untyped-call]
        else:
            state = torch.load(io.BytesIO(archive.read("policy.pth")), weights_only=True)
    values = [summary[key] for key in ("status", "env_steps", "mean_return", "objective")]
    return values, {key: value.numpy().tobytes() for key, value in state.items()}


def resume_training(place: Path) -> tuple[str, ...] | None:
    from embodichain.learning.training.keeper import find_resumable
    from embodichain.utils.errors import EmbodichainError

    for folder in (path.parent for path in folders(place, "outputs/2*/*/checkpoints")[::-1]):
        try:
            find_resumable(folder)
        except EmbodichainError:
            continue
        if _is_finished(folder):
            return None  # nothing is left to do there
        return ("train", f"resume={folder}", "quiet=true")
    return None


def _is_finished(folder: Path) -> bool:
    summary = folder / "summary.json"
    return summary.is_file() and json.loads(summary.read_text())["status"] == "finished"


def collected(place: Path) -> object:
    from embodichain.recording.demos.collection import read_collection

    folder = folders(place, "outputs/2*/*/successes.jsonl")[-1].parent
    found = [(e.attempt, e.steps, e.total_reward) for e in read_collection(folder)]
    return found, json.loads((folder / "summary.json").read_text())["status"]


def resume_collection(place: Path) -> tuple[str, ...] | None:
    found = [path.parent for path in folders(place, "outputs/2*/*/successes.jsonl")]
    ready = [path for path in found if (path / "config.yaml").stat().st_size]
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
    made = (*RUN[:-1], "episodes=1", "hydra.run.dir=r", "quiet=true")
    export = ("export", "r/rollout.mcap", "--format", form, "-o", output, *more)
    name = f"export-{form}"
    result = _is_there(output) if form == "rrd" else _bytes_of(output)
    return Case(name, export, result, (made,), output=output)


CASES: dict[str, Case] = {
    case.name: case
    for case in (
        Case("run", RUN, ran),
        Case("run-picture", (*RUN, "max_steps=2", "scene_png=true"), ran),
        Case("train", _TRAIN, trained, again=resume_training),
        Case(
            "collect",
            (*COLLECT, "episodes=3", "collect.success_steps=1"),
            collected,
            again=resume_collection,
        ),
        *(
            _exported(form, f"x.{form}")
            for form in ("csv", "npz", "parquet", "hdf5", "ros2", "rrd")
        ),
        _exported("lerobot", "x_lerobot"),
        Case("report", ("report", "r"), _page_of, ((*RUN[:-1], "hydra.run.dir=r", "quiet=true"),)),
        Case(
            "recover",
            ("recover", "r/rollout.mcap", "recovered.mcap"),
            _bytes_of("recovered.mcap"),
            ((*RUN[:-1], "hydra.run.dir=r", "quiet=true"),),
            output="recovered.mcap",
        ),
    )
}

"""`diff`: the first place where two logs part, in the order in which things happened.

Control steps are compared bit for bit, call by call: draws of events, writes, what physics
returned, actions, rewards and flags. How many steps lie in a message, wall clock, compression,
channels for viewers and threads take no part.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.api import Log
from embodichain.recording.block import DRAWN, Call, CallKind, Run
from embodichain.recording.hashing import row_hashes
from embodichain.recording.log_error import LogError
from embodichain.recording.model_columns import state_columns
from embodichain.recording.trajectory import columns_of, runs

__all__ = ["DiffReport", "LogDifference", "diff"]

_OUTCOMES = {
    "action": "action",
    "reward": "reward",
    "terminated": "terminated",
    "truncated": "truncated",
    "episode_ids": "episode",
}
_HEADER = ("task", "num_envs", "control_dt", "physics_dt", "substeps", "layout")
"""What must agree for rows to be compared."""


@dataclass(frozen=True, slots=True)
class LogDifference:
    """Where two logs part.

    Attributes:
        step: Control step; None for what holds for the whole log.
        env: Environment; None where it is not one's.
        field: What differs: ``qpos``, ``reward``, ``event move_cube``, ``write body_mass``, ...
        column: Its column: a joint, a body's coordinate, an index; empty where there is none.
        a: Value in the first log.
        b: Value in the second log.
    """

    step: int | None
    env: int | None
    field: str
    column: str
    a: Any
    b: Any

    def __str__(self) -> str:
        """One line."""
        where = "" if self.step is None else f"step {self.step}, "
        where += "" if self.env is None else f"environment {self.env}, "
        name = f"{self.field}[{self.column}]" if self.column else self.field
        return f"{where}{name}: {self.a!r} and {self.b!r}"


@dataclass(frozen=True, slots=True)
class DiffReport:
    """What comparing two logs gave.

    Attributes:
        a: The first log.
        b: The second log.
        steps: Control steps that are the same in both, from the first on.
        difference: The first difference; None if there is none.
        notes: What else is not the same: seeds, versions, a log that was cut.
    """

    a: Path
    b: Path
    steps: int
    difference: LogDifference | None
    notes: list[str] = field(default_factory=list)

    @property
    def same(self) -> bool:
        """Whether nothing differs."""
        return self.difference is None


def diff(a: str | Path, b: str | Path) -> DiffReport:
    """Compare two logs.

    Args:
        a: A log, or the folder of a run.
        b: Another one.

    Raises:
        ConfigError: If a file is missing, empty or not MCAP.
        LogError: If one is not a log of embodichain's, or has no states.
    """
    with Log(a) as first, Log(b) as second:
        for log in (first, second):
            log.header.require_states(log.path)
        steps, difference = 0, _of_headers(first, second)
        if difference is None:
            steps, difference = _of_steps(first, second)
        if difference is None and first.header.model != second.header.model:
            difference = LogDifference(
                None, None, "model", "", first.header.model, second.header.model
            )
        return DiffReport(first.path, second.path, steps, difference, _notes(first, second))


def _of_headers(a: Log, b: Log) -> LogDifference | None:
    for name in _HEADER:
        left, right = getattr(a.header, name), getattr(b.header, name)
        if left != right:
            return LogDifference(None, None, name, "", left, right)
    return None


def _notes(a: Log, b: Log) -> list[str]:
    notes = [f"{log.path}: {warning}" for log in (a, b) for warning in log.warnings]
    for name in ("seed", "mujoco_version", "model"):
        left, right = getattr(a.header, name), getattr(b.header, name)
        if left != right:
            notes.append(f"{name}: {left} and {right}")
    return notes


class _Cursor:
    """Goes through the control steps of a log."""

    def __init__(self, log: Log) -> None:
        self._runs = runs(log.reader)
        self.start: Run | None = None  # the first
        self.run: Run | None = None
        self.at = 0
        self.move(0)

    @property
    def step(self) -> int:
        """The control step that comes next."""
        return 0 if self.run is None else self.run.first + self.at

    @property
    def left(self) -> int:
        """Steps of the run that are left."""
        return 0 if self.run is None else self.run.count - self.at

    def move(self, steps: int) -> None:
        """Go on by so many steps, at most those that are left."""
        self.at += steps
        while self.run is None or self.at >= self.run.count:
            run = next(self._runs, None)
            if run is None:
                self.run = None
                return
            if run.of_kind("start"):
                self.start = self.start or run
            else:
                self.run, self.at = run, 0


def _of_steps(a: Log, b: Log) -> tuple[int, LogDifference | None]:
    """Steps that are the same, and the first difference."""
    steps, left, right = 0, _Cursor(a), _Cursor(b)
    if left.start is not None and right.start is not None:
        found = _starts(a, left.start, right.start)
        if found is not None:
            return 0, found
    while left.run is not None and right.run is not None:
        count = min(left.left, right.left)
        if left.step != right.step or not _same(left.run, left.at, right.run, right.at, count):
            for t in range(count):
                found = _one_step(a, left, right, t)
                if found is not None:
                    return steps, found
                steps += left.run.steps > 0
        else:
            steps += count if left.run.steps else 0
        left.move(count)
        right.move(count)
    if left.run is None and right.run is None:
        return steps, None
    ended = f"the log ends after {steps} steps"
    says = [ended if c.run is None else _named(c.run.calls[0]) for c in (left, right)]
    return steps, LogDifference(steps, None, "end", "", *says)


def _same(a: Run, at: int, b: Run, bt: int, count: int) -> bool:
    """Whether so many steps have the same bytes."""
    if [call.kind for call in a.calls] != [call.kind for call in b.calls]:
        return False
    return all(
        mine.arrays[name][at : at + count].tobytes()
        == other.arrays[name][bt : bt + count].tobytes()
        for mine, other in zip(a.calls, b.calls, strict=True)
        for name in mine.arrays
    )


def _named(call: Call) -> str:
    kind = call.kind
    if kind.kind == "event":
        return f"event {kind.name}"
    if kind.kind == "write":
        return f"write {kind.name or kind.mode}"
    return kind.kind


def _starts(log: Log, a: Run, b: Run) -> LogDifference | None:
    """What differs in that with which two logs begin."""
    if a.first != b.first:
        return LogDifference(min(a.first, b.first), None, "first step", "", a.first, b.first)
    left, right = ({n: v[0] for n, v in run.calls[0].arrays.items()} for run in (a, b))
    if list(left) != list(right):
        return LogDifference(a.first, None, "model fields", "", sorted(left), sorted(right))
    found = _rows(log, a.first, None, left.pop("row"), right.pop("row"))
    if found is not None:
        return found
    for name, values in left.items():
        found = _values(a.first, name, None, values, right[name])
        if found is not None:
            return found
    return None


def _one_step(log: Log, left: _Cursor, right: _Cursor, t: int) -> LogDifference | None:
    """What differs in the t-th of the next steps."""
    a, b = left.run, right.run
    if a is None or b is None:
        return None
    step = min(left.step, right.step) + t
    if left.step != right.step:
        says = (f"step {cursor.step + t}" for cursor in (left, right))
        return LogDifference(step, None, "what happened", "", *says)
    for mine, other in zip(a.calls, b.calls, strict=False):
        names = _named(mine), _named(other)
        if names[0] != names[1]:
            return LogDifference(step, None, "what happened", "", *names)
        arrays = _at(mine, left.at + t), _at(other, right.at + t)
        found = _calls(log, step, mine.kind, other.kind, *arrays)
        if found is not None:
            return found
    if len(a.calls) != len(b.calls):
        at = min(len(a.calls), len(b.calls))
        says = (_named(run.calls[at]) if at < len(run.calls) else "nothing" for run in (a, b))
        return LogDifference(step, None, "what happened", "", *says)
    return None


def _at(call: Call, t: int) -> dict[str, NDArray[Any]]:
    return {name: values[t] for name, values in call.arrays.items()}


def _calls(
    log: Log,
    step: int,
    kind: CallKind,
    other: CallKind,
    a: dict[str, NDArray[Any]],
    b: dict[str, NDArray[Any]],
) -> LogDifference | None:
    """What differs in two calls of the same name."""
    name = _named(Call(kind, a))
    what = "state" if name == "physics" else name
    left, right = (None if x is None else x.tolist() for x in (a.get("env_ids"), b.get("env_ids")))
    if left != right:
        return LogDifference(step, None, what, "environments", left or "all", right or "all")
    ids = a.pop("env_ids", None)
    b.pop("env_ids", None)
    if kind.kind == "physics":
        return _physics(log, step, kind, other, ids, a, b)
    if kind.kind == "step":
        return _outcomes(step, a, b)
    if kind.mode != other.mode:
        return LogDifference(step, None, name, "mode", kind.mode, other.mode)
    if kind.columns != other.columns:
        return LogDifference(step, None, name, "columns", kind.columns, other.columns)
    if list(a) != list(b):
        drawn = ([n.removeprefix(DRAWN) for n in arrays] for arrays in (a, b))
        return LogDifference(step, None, name, "drawn", *drawn)
    for array, values in a.items():
        if kind.mode == "reset":
            found = _rows(log, step, ids, values, b[array])
        else:
            label = name if kind.kind == "write" else f"{name}, {array.removeprefix(DRAWN)}"
            found = _values(step, label, ids, values, b[array], kind.columns)
        if found is not None:
            return found
    return None


def _physics(
    log: Log,
    step: int,
    kind: CallKind,
    other: CallKind,
    ids: NDArray[np.int64] | None,
    a: dict[str, NDArray[Any]],
    b: dict[str, NDArray[Any]],
) -> LogDifference | None:
    if kind.nstep != other.nstep:
        return LogDifference(step, None, "physics steps", "", kind.nstep, other.nstep)
    if "rows" in a and "rows" in b:
        moved = columns_of(tuple(np.concatenate([np.r_[x:y] for x, y in log.header.moved])))
        found = _rows(log, step, ids, a["rows"], b["rows"], moved)
        if found is not None:
            return found
    else:  # of keyframes there are hashes
        left, right = (x["hashes"] if "hashes" in x else row_hashes(x["rows"]) for x in (a, b))
        at = _first(left[:, None], right[:, None])
        if at is not None:
            hashes = (f"{x[at[0]]:016x}" for x in (left, right))
            return LogDifference(step, _env(ids, at[0]), "result of physics", "hash", *hashes)
    failed = [x["failed"].tolist() if "failed" in x else [] for x in (a, b)]
    if failed[0] != failed[1]:
        return LogDifference(step, None, "failed environments", "", *failed)
    return None


def _outcomes(
    step: int, a: dict[str, NDArray[Any]], b: dict[str, NDArray[Any]]
) -> LogDifference | None:
    for name, called in _OUTCOMES.items():
        left, right = a[name], b[name]
        if left.shape != right.shape:
            return LogDifference(step, None, called, "width", left.shape, right.shape)
        n = len(left)
        at = _first(left.reshape(n, -1), right.reshape(n, -1))
        if at is not None:
            env, column = at
            values = (x.reshape(n, -1)[env, column].item() for x in (left, right))
            return LogDifference(step, env, called, str(column) if left.ndim > 1 else "", *values)
    return None


def _rows(
    log: Log,
    step: int,
    ids: NDArray[np.int64] | None,
    left: NDArray[np.float64],
    right: NDArray[np.float64],
    columns: NDArray[np.int64] | slice = slice(None),
) -> LogDifference | None:
    """The first difference of (n, k) rows that have some columns of whole ones."""
    at = _first(left, right)
    if at is None:
        return None
    column = int(np.arange(log.header.nstate)[columns][at[1]])
    values = float(left[at]), float(right[at])
    for name, named in state_columns(log.model, log.header.layout).items():
        start, stop = log.header.layout[name]
        if start <= column < stop:
            return LogDifference(step, _env(ids, at[0]), name, named[column - start].name, *values)
    raise LogError(f"{log.path}: column {column} belongs to no component")


def _values(
    step: int,
    name: str,
    ids: NDArray[np.int64] | None,
    left: NDArray[np.float64],
    right: NDArray[np.float64],
    columns: tuple[int, ...] | None = None,
) -> LogDifference | None:
    """The first difference of (n, ...) values."""
    if left.shape != right.shape:
        return LogDifference(step, None, name, "shape", left.shape, right.shape)
    n = len(left)
    at = _first(left.reshape(n, -1), right.reshape(n, -1)) if left.size else None
    if at is None:
        return None
    row, column = at
    values = (float(x.reshape(n, -1)[at]) for x in (left, right))
    shown = column if columns is None else columns[column]
    return LogDifference(step, _env(ids, row), name, str(shown), *values)


def _env(ids: NDArray[np.int64] | None, row: int) -> int:
    return row if ids is None else int(ids[row])


def _first(left: NDArray[Any], right: NDArray[Any]) -> tuple[int, int] | None:
    """The first entry of two tables whose bits differ; 0.0 and -0.0 do, equal NaNs do not."""
    kind = {1: np.uint8, 4: np.uint32, 8: np.uint64}[left.dtype.itemsize]
    where = np.ascontiguousarray(left).view(kind) != np.ascontiguousarray(right).view(kind)
    found = np.flatnonzero(where)
    if not len(found):
        return None
    row, column = divmod(int(found[0]), left.shape[1])
    return row, column

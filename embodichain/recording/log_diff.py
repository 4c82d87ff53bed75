"""`diff`: the first place where two logs part, in the order in which things happened.

Messages that replay reads are compared byte for byte; only the first that differs is decoded. Wall
clock, compression, channels for viewers and threads take no part.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64
from embodichain.recording import wire
from embodichain.recording.api import Log
from embodichain.recording.columns import spread
from embodichain.recording.events import LogEvent
from embodichain.recording.header import LogError
from embodichain.recording.messages import State, StepOutcome, WriteRecord
from embodichain.recording.model_columns import state_columns

__all__ = ["DiffReport", "LogDifference", "diff"]

_TOPICS = {
    "/sim/event": LogEvent,
    "/sim/write": WriteRecord,
    "/sim/state": State,
    "/sim/step": StepOutcome,
}
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
            try:
                steps, difference = _of_messages(first, second)
            except wire.WireError as error:
                raise LogError(f"a message is damaged: {error}") from error
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


def _messages(log: Log) -> Iterator[tuple[str, memoryview]]:
    for topic, _, payload in log.full_messages():
        if topic in _TOPICS:
            yield topic, payload


def _of_messages(a: Log, b: Log) -> tuple[int, LogDifference | None]:
    """Steps that are the same, and the first difference."""
    steps = 0
    for left, right in zip_longest(_messages(a), _messages(b)):
        if left is None or right is None:
            return steps, _ended(steps, left, right)
        if left != right:
            found = _compare(a, b, left, right)
            if found is not None:
                return steps, found
        steps += left[0] == "/sim/step"
    return steps, None


def _ended(
    steps: int,
    left: tuple[str, memoryview] | None,
    right: tuple[str, memoryview] | None,
) -> LogDifference:
    """One log goes on where the other has ended."""
    ended = f"the log ends after {steps} steps"
    says = [ended if found is None else _named(*found) for found in (left, right)]
    return LogDifference(steps, None, "end", "", *says)


def _named(topic: str, payload: memoryview) -> str:
    message: Any = _TOPICS[topic].decode(payload)  # type: ignore[attr-defined]
    if isinstance(message, LogEvent):
        return f"event {message.term}"
    if isinstance(message, WriteRecord):
        return f"write {message.field or message.op}"
    return {"/sim/state": "state", "/sim/step": "step"}[topic]


def _compare(
    log: Log, other: Log, left: tuple[str, memoryview], right: tuple[str, memoryview]
) -> LogDifference | None:
    """What differs in two messages; None if only how it is written."""
    a: Any = _TOPICS[left[0]].decode(left[1])  # type: ignore[attr-defined]
    b: Any = _TOPICS[right[0]].decode(right[1])  # type: ignore[attr-defined]
    names = _named(*left), _named(*right)
    step = min(a.step, b.step)
    if left[0] != right[0] or names[0] != names[1] or a.step != b.step:
        return LogDifference(step, None, "what happened", "", *names)
    if isinstance(a, State):
        return _states(log, other, a, b)
    if isinstance(a, StepOutcome):
        return _steps(a, b)
    if isinstance(a, WriteRecord):
        return _writes(log, a, b, names[0])
    return _events(log, a, b, names[0])


def _states(log: Log, other: Log, a: State, b: State) -> LogDifference | None:
    if a.nstep != b.nstep:
        return LogDifference(a.step, None, "physics steps", "", a.nstep, b.nstep)
    chosen = _environments(a, b, "state")
    if isinstance(chosen, LogDifference):
        return chosen
    left, right = _whole(log, a), _whole(other, b)
    at = _first(left, right)
    if at is None:
        return None
    row, column = at
    for name, columns in state_columns(log.model, log.header.layout).items():
        start, stop = log.header.layout[name]
        if start <= column < stop:
            env = row if chosen is None else int(chosen[row])
            named = columns[column - start].name
            values = float(left[row, column]), float(right[row, column])
            return LogDifference(a.step, env, name, named, *values)
    raise LogError(f"{log.path}: column {column} belongs to no component")


def _whole(log: Log, state: State) -> F64:
    """(n, nstate) rows; which columns are left out, each log says for itself."""
    header, rows = log.header, state.rows
    return spread(header.ranges_of(rows.shape[1]), rows, header.nstate)


def _steps(a: StepOutcome, b: StepOutcome) -> LogDifference | None:
    for name, called in _OUTCOMES.items():
        left, right = getattr(a, name), getattr(b, name)
        if left.shape != right.shape:
            return LogDifference(a.step, None, called, "width", left.shape, right.shape)
        n = len(left)
        at = _first(left.reshape(n, -1), right.reshape(n, -1))
        if at is not None:
            env, column = at
            values = (x.reshape(n, -1)[env, column].item() for x in (left, right))
            return LogDifference(a.step, env, called, str(column) if left.ndim > 1 else "", *values)
    if a.physics.hashes.shape == b.physics.hashes.shape:
        at = _first(a.physics.hashes[:, None], b.physics.hashes[:, None])
        if at is not None:
            hashes = (f"{m.physics.hashes[at[0]]:016x}" for m in (a, b))
            return LogDifference(a.step, at[0], "result of physics", "hash", *hashes)
    return LogDifference(a.step, None, "failed environments", "", *(
        [] if m.physics.failed is None else m.physics.failed.tolist() for m in (a, b)
    ))  # fmt: skip


def _writes(log: Log, a: WriteRecord, b: WriteRecord, name: str) -> LogDifference | None:
    chosen = _environments(a, b, name)
    if isinstance(chosen, LogDifference):
        return chosen
    left, right = (None if isinstance(m.columns, slice) else m.columns.tolist() for m in (a, b))
    if left != right or a.values.shape != b.values.shape:
        return LogDifference(a.step, None, name, "columns", left, right)
    return _values(a.step, name, _ids(log, chosen), a.values, b.values, left)


def _events(log: Log, a: LogEvent, b: LogEvent, name: str) -> LogDifference | None:
    chosen = _environments(a, b, name)
    if isinstance(chosen, LogDifference):
        return chosen
    if list(a.drawn) != list(b.drawn):
        return LogDifference(a.step, None, name, "drawn", list(a.drawn), list(b.drawn))
    for what, left in a.drawn.items():
        right = b.drawn[what]
        if left.shape != right.shape:
            return LogDifference(a.step, None, f"{name}, {what}", "shape", left.shape, right.shape)
        drawn = left.ravel(), right.ravel()
        found = _values(a.step, f"{name}, {what}", _ids(log, chosen), *drawn)
        if found is not None:
            return found
    return LogDifference(a.step, None, name, "mode", a.mode, b.mode) if a.mode != b.mode else None


def _values(
    step: int,
    name: str,
    envs: list[int],
    left: NDArray[np.float64],
    right: NDArray[np.float64],
    columns: list[int] | None = None,
) -> LogDifference | None:
    """The first difference of flat values, rows of these environments one after the other."""
    at = _first(left[:, None], right[:, None])
    if at is None:
        return None
    flat, width = at[0], max(1, len(left) // max(1, len(envs)))
    whole = width * len(envs) == len(left)
    env = envs[flat // width] if whole else None
    column = flat % width if whole else flat
    shown = columns[column] if columns and column < len(columns) else column
    return LogDifference(step, env, name, str(shown), float(left[flat]), float(right[flat]))


def _ids(log: Log, chosen: NDArray[np.int64] | None) -> list[int]:
    return list(range(log.num_envs)) if chosen is None else chosen.tolist()


def _environments(a: Any, b: Any, name: str) -> NDArray[np.int64] | None | LogDifference:
    """The environments of both messages, None for all; or that they are not the same."""
    left, right = ([] if m.env_ids is None else m.env_ids.tolist() for m in (a, b))
    if left == right:
        chosen: NDArray[np.int64] | None = a.env_ids
        return chosen
    values = (ids or "all" for ids in (left, right))
    return LogDifference(a.step, None, name, "environments", *values)


def _first(left: NDArray[Any], right: NDArray[Any]) -> tuple[int, int] | None:
    """The first entry of two tables whose bits differ; 0.0 and -0.0 do, equal NaNs do not."""
    size = left.dtype.itemsize
    kind = {1: np.uint8, 4: np.uint32, 8: np.uint64}[size]
    where = np.ascontiguousarray(left).view(kind) != np.ascontiguousarray(right).view(kind)
    found = np.flatnonzero(where)
    if not len(found):
        return None
    row, column = divmod(int(found[0]), left.shape[1])
    return row, column

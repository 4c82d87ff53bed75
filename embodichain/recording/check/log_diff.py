"""`diff`: the first difference between two logs, in the order in which calls happened.

Control steps are compared bit for bit, call by call: draws of events, writes, results of physics,
actions, rewards and flags. Grouping of steps in messages, wall clock, compression, channels for
viewers and numbers of threads are not compared.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.format.block import DRAWN, Call, CallKind, Run
from embodichain.recording.format.columns import Moved, state_columns
from embodichain.recording.format.hashing import row_hashes
from embodichain.recording.format.log_error import LogError
from embodichain.recording.read.api import Log
from embodichain.recording.read.trajectory import runs

__all__ = ["DiffReport", "LogDifference", "diff"]

_HEADER = ("task", "num_envs", "control_dt", "physics_dt", "substeps", "layout")
"""Fields that must be equal for rows to be comparable."""


@dataclass(frozen=True, slots=True)
class LogDifference:
    """The first difference between two logs.

    Attributes:
        step: Control step; None if the difference concerns the whole log.
        env: Environment; None if it does not concern a single one.
        field: What differs: ``qpos``, ``reward``, ``event move_cube``, ``write body_mass``, ...
        column: Its column: a joint, a coordinate of a body, an index; empty if it has none.
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
        """Return one line."""
        where = "" if self.step is None else f"step {self.step}, "
        where += "" if self.env is None else f"environment {self.env}, "
        name = f"{self.field}[{self.column}]" if self.column else self.field
        return f"{where}{name}: {self.a!r} and {self.b!r}"


@dataclass(frozen=True, slots=True)
class DiffReport:
    """Result of comparing two logs.

    Attributes:
        a: The first log.
        b: The second log.
        steps: Number of control steps that are equal in both, from the first on.
        difference: The first difference; None if there is none.
        notes: Other differences: seeds, versions, a log that was cut.
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
        LogError: If one is not an embodichain log, or has no states.
    """
    with Log(a) as first, Log(b) as second:
        for log in (first, second):
            log.header.require_states(log.path)
        steps = 0
        difference = _of_headers(first, second)
        if difference is None:
            steps, difference = _of_steps(first, second)
        if difference is None and first.header.model != second.header.model:
            difference = LogDifference(
                None, None, "model", "", first.header.model, second.header.model
            )
        return DiffReport(first.path, second.path, steps, difference, _notes(first, second))


def _of_headers(a: Log, b: Log) -> LogDifference | None:
    for name in _HEADER:
        left = getattr(a.header, name)
        right = getattr(b.header, name)
        if left != right:
            return LogDifference(None, None, name, "", left, right)
    return None


def _notes(a: Log, b: Log) -> list[str]:
    notes = [f"{log.path}: {warning}" for log in (a, b) for warning in log.warnings]
    for name in ("seed", "mujoco_version", "model"):
        left = getattr(a.header, name)
        right = getattr(b.header, name)
        if left != right:
            notes.append(f"{name}: {left} and {right}")
    return notes


class _Cursor:
    """A position among the control steps of a log."""

    def __init__(self, log: Log) -> None:
        self._runs = runs(log.reader)
        self.start: Run | None = None  # the first start
        self.run: Run | None = None
        self.at = 0
        self.move(0)

    @property
    def step(self) -> int:
        """The next control step."""
        return 0 if self.run is None else self.run.first + self.at

    def move(self, steps: int) -> None:
        """Advance by a number of steps, at most to the end of the run."""
        self.at += steps
        while self.run is None or self.at >= self.run.count:
            run = next(self._runs, None)
            if run is not None and run.of_kind("start"):
                self.start = self.start or run
                continue
            self.run = run
            self.at = 0
            if run is None:
                return


def _of_steps(a: Log, b: Log) -> tuple[int, LogDifference | None]:
    """Number of equal steps, and the first difference."""
    steps = 0
    left = _Cursor(a)
    right = _Cursor(b)
    compare = _Comparison(a)
    if left.start is not None and right.start is not None:
        found = compare.calls(left.start, 0, right.start, 0)
        if found is not None:
            return 0, found
    while left.run is not None and right.run is not None:
        count = min(left.run.count - left.at, right.run.count - right.at)
        if left.step == right.step and _same(left.run, left.at, right.run, right.at, count):
            steps += count if left.run.steps else 0
        else:
            for t in range(count):
                found = compare.calls(left.run, left.at + t, right.run, right.at + t)
                if found is not None:
                    return steps, found
                steps += left.run.steps > 0
        left.move(count)
        right.move(count)
    if left.run is None and right.run is None:
        return steps, None
    ended = f"the log ends after {steps} steps"
    says = [ended if c.run is None else _named(c.run.calls[0].kind) for c in (left, right)]
    return steps, LogDifference(steps, None, "end", "", *says)


def _same(a: Run, at: int, b: Run, bt: int, count: int) -> bool:
    """Whether `count` steps have the same bytes."""
    if [call.kind for call in a.calls] != [call.kind for call in b.calls]:
        return False
    pairs = (
        (x.arrays[n], y.arrays[n]) for x, y in zip(a.calls, b.calls, strict=True) for n in x.arrays
    )
    return all(x[at : at + count].tobytes() == y[bt : bt + count].tobytes() for x, y in pairs)


def _named(kind: CallKind) -> str:
    names = {"event": f"event {kind.name}", "write": f"write {kind.name or kind.mode}"}
    return names.get(kind.kind, kind.kind)


class _Comparison:
    """Finds and names the first difference of two control steps.

    Args:
        log: One of the two logs; their rows have the same layout.
    """

    def __init__(self, log: Log) -> None:
        self._log = log
        self._moved = Moved(log.header.moved).columns

    def calls(self, a: Run, at: int, b: Run, bt: int) -> LogDifference | None:
        """Compare a step of a run with one of another."""
        step = min(a.first + at, b.first + bt)
        if a.first + at != b.first + bt:
            says = f"step {a.first + at}", f"step {b.first + bt}"
            return LogDifference(step, None, "what happened", "", *says)
        for i in range(max(len(a.calls), len(b.calls))):
            names = [_named(r.calls[i].kind) if i < len(r.calls) else "nothing" for r in (a, b)]
            if names[0] != names[1]:
                return LogDifference(step, None, "what happened", "", *names)
            found = self._call(step, a.calls[i], at, b.calls[i], bt)
            if found is not None:
                return found
        return None

    def _call(self, step: int, a: Call, at: int, b: Call, bt: int) -> LogDifference | None:
        """Compare two calls of the same name."""
        name = _named(a.kind)
        left = {array: values[at] for array, values in a.arrays.items()}
        right = {array: values[bt] for array, values in b.arrays.items()}
        ids = left.pop("env_ids", None)
        others = right.pop("env_ids", None)
        if (ids is None) != (others is None) or not np.array_equal(ids, others):
            says = ("all" if x is None else x.tolist() for x in (ids, others))
            return LogDifference(step, None, name, "environments", *says)
        for what in ("mode", "nstep", "columns"):
            mine = getattr(a.kind, what)
            other = getattr(b.kind, what)
            if mine != other:
                return LogDifference(step, None, name, what, mine, other)
        if "hashes" in left or "hashes" in right:  # recorded with keyframes
            for arrays in (left, right):
                if "rows" in arrays:
                    arrays["hashes"] = row_hashes(np.ascontiguousarray(arrays.pop("rows")))
        if left.keys() != right.keys():
            return LogDifference(step, None, name, "values", sorted(left), sorted(right))
        for array, values in left.items():
            found = self._values(step, a.kind, array, ids, values, right[array])
            if found is not None:
                return found
        return None

    def _values(
        self,
        step: int,
        kind: CallKind,
        array: str,
        ids: NDArray[np.int64] | None,
        left: NDArray[Any],
        right: NDArray[Any],
    ) -> LogDifference | None:
        """Compare (n, ...) values bit for bit: 0.0 and -0.0 differ, equal NaNs do not."""
        if left.shape != right.shape:
            field, _ = self._name(kind, array, 0)
            return LogDifference(step, None, field, "shape", left.shape, right.shape)
        if not left.size:
            return None
        mine, other = (np.ascontiguousarray(x).reshape(len(x), -1) for x in (left, right))
        words = f"u{mine.dtype.itemsize}"
        where = np.flatnonzero(mine.view(words) != other.view(words))
        if not len(where):
            return None
        row, column = divmod(int(where[0]), mine.shape[1])
        field, name = self._name(kind, array, column)
        says = (x[row, column].item() for x in (mine, other))
        if array == "hashes":
            says = (f"{x:016x}" for x in says)
        env = row if ids is None else int(ids[row])
        return LogDifference(
            step, env, field, name if left.ndim > 1 or name == "hash" else "", *says
        )

    def _name(self, kind: CallKind, array: str, column: int) -> tuple[str, str]:
        """Name of an array's content, and name of its column."""
        if array == "hashes":
            return "result of physics", "hash"
        if array in ("rows", "row") or kind.mode == "reset" and kind.kind == "write":
            return self._component(int(self._moved[column]) if array == "rows" else column)
        if kind.kind == "write":
            return _named(kind), str(column if kind.columns is None else kind.columns[column])
        if kind.kind == "event":
            return f"{_named(kind)}, {array.removeprefix(DRAWN)}", str(column)
        return {"episode_ids": "episode", "failed": "failed environments"}.get(array, array), str(
            column
        )

    def _component(self, column: int) -> tuple[str, str]:
        """Component and name of a column of full rows."""
        layout = self._log.header.layout
        for name, named in state_columns(self._log.model, layout).items():
            start, stop = layout[name]
            if start <= column < stop:
                return name, named[column - start].name
        raise LogError(f"{self._log.path}: column {column} belongs to no component")

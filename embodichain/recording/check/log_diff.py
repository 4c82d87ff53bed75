"""`diff`: the first difference between two logs, in the order in which calls happened.

Control steps are compared bit for bit, call by call: draws of events, writes, results of physics,
actions, rewards and flags. Grouping of steps in messages, wall clock, compression, channels for
viewers and numbers of threads are not compared.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.format.log_error import LogError
from embodichain.recording.format.messages.block import DRAWN, Call, CallKind, Run
from embodichain.recording.format.messages.columns import Moved, state_columns
from embodichain.recording.format.messages.hashing import row_hashes
from embodichain.recording.read.api import Log
from embodichain.recording.read.trajectory import runs

__all__ = ["DiffReport", "LogDifference", "diff"]

_HEADER = ("task", "num_envs", "control_dt", "physics_dt", "substeps", "layout")
"""Fields that must be equal for rows to be comparable."""
_FIELDS = {"episode_ids": "episode", "failed": "failed environments"}
"""Names of arrays, where a report uses others."""


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
        name = f"{self.field}[{self.column}]" if self.column else self.field
        text = f"{name}: {self.a!r} and {self.b!r}"
        if self.env is not None:
            text = f"environment {self.env}, {text}"
        if self.step is not None:
            text = f"step {self.step}, {text}"
        return text


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
        difference = _compare_headers(first, second)
        if difference is None:
            steps, difference = _compare_steps(first, second)
        if difference is None:
            difference = _compare_field("model", first, second)
        return DiffReport(
            a=first.path,
            b=second.path,
            steps=steps,
            difference=difference,
            notes=_notes(first, second),
        )


def _compare_headers(a: Log, b: Log) -> LogDifference | None:
    for name in _HEADER:
        difference = _compare_field(name, a, b)
        if difference is not None:
            return difference
    return None


def _compare_field(name: str, a: Log, b: Log) -> LogDifference | None:
    """Compare a field of the headers."""
    value_a = getattr(a.header, name)
    value_b = getattr(b.header, name)
    if value_a == value_b:
        return None
    return LogDifference(step=None, env=None, field=name, column="", a=value_a, b=value_b)


def _notes(a: Log, b: Log) -> list[str]:
    notes = [f"{log.path}: {warning}" for log in (a, b) for warning in log.warnings]
    for name in ("seed", "mujoco_version", "model"):
        value_a = getattr(a.header, name)
        value_b = getattr(b.header, name)
        if value_a != value_b:
            notes.append(f"{name}: {value_a} and {value_b}")
    return notes


class _Position(NamedTuple):
    """A control step of a log.

    Attributes:
        run: The run that it belongs to.
        t: Its index within the run.
    """

    run: Run
    t: int

    @property
    def step(self) -> int:
        """Number of the control step."""
        return self.run.first + self.t

    def call_name(self, index: int) -> str:
        """Name of one of its calls."""
        if index >= len(self.run.calls):
            return "nothing"
        return _name_of_call(self.run.calls[index].kind)


class _Cursor:
    """Goes through the control steps of a log.

    Attributes:
        start: The first start of the log.
        run: The current run; None at the end of the log.
        t: Index of the current step within it.
    """

    def __init__(self, log: Log) -> None:
        self._runs = runs(log.reader)
        self.start: Run | None = None
        self.run: Run | None = None
        self.t = 0
        self._next_run()

    def advance(self, steps: int) -> None:
        """Go on by a number of steps, at most to the end of the run."""
        self.t += steps
        if self.run is not None and self.t >= self.run.count:
            self._next_run()

    def _next_run(self) -> None:
        self.t = 0
        for run in self._runs:
            if not run.of_kind("start"):
                self.run = run
                return
            # Later starts follow from the first one and the calls after it.
            if self.start is None:
                self.start = run
        self.run = None


def _compare_steps(a: Log, b: Log) -> tuple[int, LogDifference | None]:
    """Number of equal steps, and the first difference."""
    steps = 0
    cursor_a = _Cursor(a)
    cursor_b = _Cursor(b)
    comparison = _Comparison(a)
    if cursor_a.start is not None and cursor_b.start is not None:
        difference = comparison.of_steps(_Position(cursor_a.start, 0), _Position(cursor_b.start, 0))
        if difference is not None:
            return 0, difference
    while cursor_a.run is not None and cursor_b.run is not None:
        begin_a = _Position(cursor_a.run, cursor_a.t)
        begin_b = _Position(cursor_b.run, cursor_b.t)
        count = min(begin_a.run.count - begin_a.t, begin_b.run.count - begin_b.t)
        # Comparing many steps at once is fast; one at a time, to say where they differ.
        if begin_a.step == begin_b.step and _are_equal(begin_a, begin_b, count):
            steps += count if begin_a.run.steps else 0
        else:
            for t in range(count):
                difference = comparison.of_steps(
                    _Position(begin_a.run, begin_a.t + t),
                    _Position(begin_b.run, begin_b.t + t),
                )
                if difference is not None:
                    return steps, difference
                steps += begin_a.run.steps > 0
        cursor_a.advance(count)
        cursor_b.advance(count)
    if cursor_a.run is None and cursor_b.run is None:
        return steps, None
    return steps, LogDifference(
        step=steps,
        env=None,
        field="end",
        column="",
        a=_next_call(cursor_a, steps),
        b=_next_call(cursor_b, steps),
    )


def _next_call(cursor: _Cursor, steps: int) -> str:
    """What a log has after a number of steps."""
    if cursor.run is None:
        return f"the log ends after {steps} steps"
    return _name_of_call(cursor.run.calls[0].kind)


def _are_equal(a: _Position, b: _Position, count: int) -> bool:
    """Whether the next `count` steps have the same bytes."""
    if [call.kind for call in a.run.calls] != [call.kind for call in b.run.calls]:
        return False
    for call_a, call_b in zip(a.run.calls, b.run.calls, strict=True):
        for name, values in call_a.arrays.items():
            bytes_a = values[a.t : a.t + count].tobytes()
            bytes_b = call_b.arrays[name][b.t : b.t + count].tobytes()
            if bytes_a != bytes_b:
                return False
    return True


def _name_of_call(kind: CallKind) -> str:
    if kind.kind == "event":
        return f"event {kind.name}"
    if kind.kind == "write":
        return f"write {kind.name or kind.mode}"
    return kind.kind


class _Comparison:
    """Finds and names the first difference of two control steps.

    Args:
        log: One of the two logs; their rows have the same layout.
    """

    def __init__(self, log: Log) -> None:
        self._log = log
        self._moved = Moved(log.header.moved).columns

    def of_steps(self, a: _Position, b: _Position) -> LogDifference | None:
        """Compare two control steps, call by call."""
        step = min(a.step, b.step)
        if a.step != b.step:
            return LogDifference(
                step=step,
                env=None,
                field="what happened",
                column="",
                a=f"step {a.step}",
                b=f"step {b.step}",
            )
        for index in range(max(len(a.run.calls), len(b.run.calls))):
            name_a = a.call_name(index)
            name_b = b.call_name(index)
            if name_a != name_b:
                return LogDifference(
                    step=step,
                    env=None,
                    field="what happened",
                    column="",
                    a=name_a,
                    b=name_b,
                )
            difference = self._of_calls(
                step,
                a.run.calls[index].kind,
                b.run.calls[index].kind,
                _arrays_in_step(a.run.calls[index], a.t),
                _arrays_in_step(b.run.calls[index], b.t),
            )
            if difference is not None:
                return difference
        return None

    def _of_calls(
        self,
        step: int,
        kind_a: CallKind,
        kind_b: CallKind,
        arrays_a: dict[str, NDArray[Any]],
        arrays_b: dict[str, NDArray[Any]],
    ) -> LogDifference | None:
        """Compare two calls of the same name."""
        name = _name_of_call(kind_a)
        ids_a = arrays_a.pop("env_ids", None)
        ids_b = arrays_b.pop("env_ids", None)
        if _listed_ids(ids_a) != _listed_ids(ids_b):
            return LogDifference(
                step,
                None,
                field=name,
                column="environments",
                a=_listed_ids(ids_a),
                b=_listed_ids(ids_b),
            )
        for attribute in ("mode", "nstep", "columns"):
            value_a = getattr(kind_a, attribute)
            value_b = getattr(kind_b, attribute)
            if value_a != value_b:
                return LogDifference(
                    step=step,
                    env=None,
                    field=name,
                    column=attribute,
                    a=value_a,
                    b=value_b,
                )
        if "hashes" in arrays_a or "hashes" in arrays_b:
            # One of them was recorded with keyframes: compare hashes of the other's rows.
            _hash_rows(arrays_a)
            _hash_rows(arrays_b)
        if arrays_a.keys() != arrays_b.keys():
            return LogDifference(
                step=step,
                env=None,
                field=name,
                column="values",
                a=sorted(arrays_a),
                b=sorted(arrays_b),
            )
        for array, values in arrays_a.items():
            difference = self._of_values(step, kind_a, array, ids_a, values, arrays_b[array])
            if difference is not None:
                return difference
        return None

    def _of_values(
        self,
        step: int,
        kind: CallKind,
        array: str,
        ids: NDArray[np.int64] | None,
        values_a: NDArray[Any],
        values_b: NDArray[Any],
    ) -> LogDifference | None:
        """Compare (n, ...) values bit for bit: 0.0 and -0.0 differ, equal NaNs do not."""
        if values_a.shape != values_b.shape:
            name = self._name_of_value(kind, array, column=0)
            return LogDifference(
                step, None, name.field, "shape", a=values_a.shape, b=values_b.shape
            )
        if not values_a.size:
            return None
        table_a = np.ascontiguousarray(values_a).reshape(len(values_a), -1)
        table_b = np.ascontiguousarray(values_b).reshape(len(values_b), -1)
        bits = f"u{table_a.dtype.itemsize}"
        differs = np.flatnonzero(table_a.view(bits) != table_b.view(bits))
        if not len(differs):
            return None
        row, column = divmod(int(differs[0]), table_a.shape[1])
        name = self._name_of_value(kind, array, column)
        value_a = table_a[row, column].item()
        value_b = table_b[row, column].item()
        column_name = name.column
        if array == "hashes":
            value_a = f"{value_a:016x}"
            value_b = f"{value_b:016x}"
        elif values_a.ndim == 1:
            column_name = ""  # one number an environment
        return LogDifference(
            step=step,
            env=row if ids is None else int(ids[row]),
            field=name.field,
            column=column_name,
            a=value_a,
            b=value_b,
        )

    def _name_of_value(self, kind: CallKind, array: str, column: int) -> _ValueName:
        """Name of a column of an array."""
        if array == "hashes":
            return _ValueName("result of physics", "hash")
        if array == "rows":
            return self._name_in_row(int(self._moved[column]))
        if array == "row" or (kind.kind == "write" and kind.mode == "reset"):
            return self._name_in_row(column)
        if kind.kind == "write":
            if kind.columns is not None:
                column = kind.columns[column]
            return _ValueName(_name_of_call(kind), str(column))
        if kind.kind == "event":
            return _ValueName(f"{_name_of_call(kind)}, {array.removeprefix(DRAWN)}", str(column))
        return _ValueName(_FIELDS.get(array, array), str(column))

    def _name_in_row(self, column: int) -> _ValueName:
        """Name of a column of full rows."""
        layout = self._log.header.layout
        for component, columns in state_columns(self._log.model, layout).items():
            start, stop = layout[component]
            if start <= column < stop:
                return _ValueName(component, columns[column - start].name)
        raise LogError(f"{self._log.path}: column {column} belongs to no component")


class _ValueName(NamedTuple):
    """How `LogDifference` names a number: its field, and its column within the field."""

    field: str
    column: str


def _arrays_in_step(call: Call, t: int) -> dict[str, NDArray[Any]]:
    return {name: values[t] for name, values in call.arrays.items()}


def _listed_ids(ids: NDArray[np.int64] | None) -> list[int] | str:
    if ids is None:
        return "all"
    values: list[int] = ids.tolist()
    return values


def _hash_rows(arrays: dict[str, NDArray[Any]]) -> None:
    """Replace the rows of a physics call by their hashes."""
    if "rows" in arrays:
        arrays["hashes"] = row_hashes(np.ascontiguousarray(arrays.pop("rows")))

"""`LogArrays`: arrays read from a log, as numpy, torch or a pandas frame; `gather` reads them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import F64
from embodichain.recording.format.log_error import LogError
from embodichain.recording.format.messages.block import CallKind, Run
from embodichain.recording.format.messages.columns import Column
from embodichain.recording.read.chunks import LogReader
from embodichain.recording.read.simulation import Simulation
from embodichain.recording.read.trajectory import (
    FollowedRows,
    Span,
    changes,
    follow,
    outcomes,
    runs,
)
from embodichain.utils.errors import ConfigError
from embodichain.utils.short_repr import short_repr
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    import pandas as pd
    import torch

__all__ = ["OUTCOMES", "LogArrays", "first_step", "gather"]


OUTCOMES = {
    "actions": ("action", np.float64),
    "rewards": ("reward", np.float64),
    "terminated": ("terminated", np.bool_),
    "truncated": ("truncated", np.bool_),
    "episodes": ("episode_ids", np.int64),
}
"""Field to its array in a ``step`` call, and its type."""


@dataclass(frozen=True)
class LogArrays:
    """T control steps of N environments.

    ``data["qpos"]`` is (T, N, nq), ``data["rewards"]`` (T, N); `columns` names the last axis.

    Attributes:
        steps: (T,) control steps, counted from the start of the recording.
        env_ids: (N,) environments.
        control_dt: Length of a control step in seconds.
        columns: Field to name and unit of its columns; a single one for fields of shape (T, N).
        values: Field to array, time first, environments second.
    """

    steps: NDArray[np.int64]
    env_ids: NDArray[np.int64]
    control_dt: float
    columns: Mapping[str, list[Column]]
    values: Mapping[str, NDArray[Any]]

    def __repr__(self) -> str:
        """Return T, N and the shapes of the fields, in one line."""
        shapes = {field: values.shape for field, values in self.values.items()}
        return short_repr(self, steps=len(self.steps), num_envs=len(self.env_ids), fields=shapes)

    def __getitem__(self, field: str) -> NDArray[Any]:
        """The array of a field.

        Raises:
            ConfigError: If the field was not read.
        """
        if field not in self.values:
            hint = did_you_mean(field, self.values)
            raise ConfigError(f"no field {field!r} was read.{hint} Fields: {', '.join(self)}")
        return self.values[field]

    def __iter__(self) -> Iterator[str]:
        """Names of the fields."""
        return iter(self.values)

    def __len__(self) -> int:
        """Number of control steps T."""
        return len(self.steps)

    def names(self, field: str) -> list[str]:
        """Names of a field's columns, in order."""
        return [column.name for column in self.columns[field]]

    @property
    def time(self) -> NDArray[np.float64]:
        """(T,) seconds of simulated time since the start of the recording."""
        return self.steps.astype(np.float64) * np.float64(self.control_dt)

    def torch(self) -> dict[str, torch.Tensor]:
        """The arrays as tensors that share their memory."""
        import torch

        return {field: torch.from_numpy(values) for field, values in self.values.items()}

    def flat(self) -> Iterator[tuple[Column, NDArray[Any]]]:
        """A table with a row for each step and environment: its columns, each (T * N,)."""
        num_envs = len(self.env_ids)
        yield Column("step", ""), np.repeat(self.steps, num_envs)
        yield Column("time", "s"), np.repeat(self.time, num_envs)
        yield Column("env", ""), np.tile(self.env_ids, len(self.steps))
        for field, values in self.values.items():
            table = values.reshape(len(self.steps) * num_envs, len(self.columns[field]))
            for index, (name, unit) in enumerate(self.columns[field]):
                full_name = field if name == field else f"{field}/{name}"
                yield Column(full_name, unit), table[:, index]

    def frame(self) -> pd.DataFrame:
        """A pandas frame with a row for each step and environment.

        Raises:
            ConfigError: If pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError as error:
            raise ConfigError("a frame needs pandas: pip install 'embodichain[pandas]'") from error
        return pd.DataFrame({column.name: values for column, values in self.flat()})


def gather(
    reader: LogReader,
    rows: FollowedRows,
    span: Span,
    names: Sequence[str],
    columns: Mapping[str, Sequence[Column]],
) -> LogArrays:
    """Read some fields of some steps.

    Args:
        reader: The log.
        rows: Rows of the selected environments; followed only if a component of rows is read.
        span: The control steps. If a component of rows is read, steps with unknown rows are left
            out.
        names: Components of rows, and keys of `OUTCOMES`.
        columns: Columns of each field.

    Raises:
        LogError: If the log is inconsistent.
    """
    header = reader.require_header()
    env_ids = rows.env_ids
    slices = {name: slice(*header.layout[name]) for name in names if name in header.layout}
    steps: list[NDArray[np.int64]] = []
    pieces: dict[str, list[NDArray[Any]]] = {name: [] for name in names}
    positions = slice(None) if len(env_ids) == header.num_envs else env_ids
    for run, index in _run_steps(reader, rows, span, slices, pieces):
        steps.append(run.first + index)
        outcome = run.calls[-1]
        for name in names:
            if name not in slices:
                key, dtype = OUTCOMES[name]
                pieces[name].append(outcome.arrays[key][index][:, positions].astype(dtype))
    values: dict[str, NDArray[Any]] = {}
    for name in names:
        if not pieces[name]:
            values[name] = _no_steps(name, len(env_ids), len(columns[name]))
            continue
        try:
            # The pieces are freed one field after the other: together they are as large as the
            # result.
            values[name] = np.concatenate(pieces.pop(name))
        except ValueError as error:
            raise LogError(f"{reader.path}: steps differ in their {name}: {error}") from error
    field_columns = {name: list(columns[name]) for name in names}
    if "actions" in values:
        width = values["actions"].shape[-1]
        if width != len(field_columns["actions"]):
            # Their names come from the log's first step, which a damaged log may lack.
            field_columns["actions"] = [Column(str(i), "") for i in range(width)]
    return LogArrays(
        steps=np.concatenate([np.empty(0, np.int64), *steps]),
        env_ids=env_ids,
        control_dt=header.control_dt,
        columns=field_columns,
        values=values,
    )


def _no_steps(name: str, num_envs: int, num_columns: int) -> NDArray[Any]:
    """The array of a field in which there are no steps."""
    if name not in OUTCOMES:
        return np.empty((0, num_envs, num_columns))
    _, dtype = OUTCOMES[name]
    if name == "actions":
        return np.empty((0, num_envs, num_columns), dtype)
    return np.empty((0, num_envs), dtype)


def _run_steps(
    reader: LogReader,
    rows: FollowedRows,
    span: Span,
    slices: Mapping[str, slice],
    pieces: dict[str, list[NDArray[Any]]],
) -> Iterator[tuple[Run, NDArray[np.int64]]]:
    """Yield runs, and indices of their known steps within the span.

    Args:
        reader: The log.
        rows: The rows, followed if there are `slices`.
        span: The control steps.
        slices: Components of the input of physics.
        pieces: The values of these components, (steps, n, k), are appended here.
    """
    if not slices:
        for run in runs(reader, span, outcomes):
            index = _within(run, span)
            if len(index):
                yield run, index
        return

    def is_read(kind: CallKind) -> bool:
        if outcomes(kind):
            return len(slices) < len(pieces)
        if kind.kind != "write" or isinstance(rows, Simulation):
            return changes(kind)
        # Without physics, only writes to these components change what is read.
        return kind.mode == "reset" or (kind.mode == "state" and kind.name in {*slices, "row"})

    followed = follow(reader, rows, span, is_read)
    for _, run_steps in groupby(followed, lambda run_and_t: run_and_t[0].first):
        states: dict[str, list[F64]] = {name: [] for name in slices}
        steps = []
        for step in run_steps:
            steps.append(step)
            for name, columns in slices.items():
                states[name].append(rows.rows[:, columns].copy())
        for name, values in states.items():
            pieces[name].append(np.array(values))
        run, _ = steps[0]
        yield run, np.array([t for _, t in steps])


def _within(run: Run, span: Span) -> NDArray[np.int64]:
    """Indices of the steps of a run that are in the span."""
    start = max(span.first - run.first, 0)
    stop = run.steps
    if span.last is not None:
        stop = min(stop, span.last - run.first + 1)
    return np.arange(start, stop)


def first_step(reader: LogReader, span: Span) -> int | None:
    """Return the first step of a span that is in a log; None if there is none.

    Raises:
        LogError: If a message is damaged.
    """
    for run in runs(reader, span, outcomes):
        step = max(run.first, span.first)
        if step >= run.first + run.steps:
            continue
        if step in span:
            return step
        return None
    return None

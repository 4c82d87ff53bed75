"""`LogArrays`: arrays read from a log, as numpy, torch or a pandas frame; `gather` reads them."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import F64
from embodichain.recording.format.block import CallKind, Run
from embodichain.recording.format.columns import Column
from embodichain.recording.format.log_error import LogError
from embodichain.recording.read.chunks import LogReader
from embodichain.recording.read.simulation import Simulation
from embodichain.recording.read.trajectory import Rows, Span, changes, follow, outcomes, runs
from embodichain.utils.errors import ConfigError
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
        n = len(self.env_ids)
        yield Column("step", ""), np.repeat(self.steps, n)
        yield Column("time", "s"), np.repeat(self.time, n)
        yield Column("env", ""), np.tile(self.env_ids, len(self.steps))
        for field, values in self.values.items():
            wide = values.reshape(len(self.steps) * n, len(self.columns[field]))
            for index, (name, unit) in enumerate(self.columns[field]):
                yield Column(name if name == field else f"{field}/{name}", unit), wide[:, index]

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
    rows: Rows,
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
    ids = rows.env_ids
    slices = {name: slice(*header.layout[name]) for name in names if name in header.layout}
    steps: list[NDArray[np.int64]] = []
    pieces: dict[str, list[NDArray[Any]]] = {name: [] for name in names}
    take = slice(None) if len(ids) == header.num_envs else ids
    for run, index in _parts(reader, rows, span, slices, pieces):
        steps.append(run.first + index)
        for name in names:
            if name not in slices:
                key, dtype = OUTCOMES[name]
                pieces[name].append(run.calls[-1].arrays[key][index][:, take].astype(dtype))
    values: dict[str, NDArray[Any]] = {}
    named = {name: list(columns[name]) for name in names}
    for name in names:
        shape = (0, len(ids), len(named[name])) if name in (*slices, "actions") else (0, len(ids))
        empty: NDArray[Any] = np.empty(shape, OUTCOMES[name][1] if name in OUTCOMES else np.float64)
        try:
            values[name] = np.concatenate(pieces.pop(name) or [empty])
        except ValueError as error:
            raise LogError(f"{reader.path}: steps differ in their {name}: {error}") from error
    width = values["actions"].shape[-1] if "actions" in values else 0
    if width != len(named.get("actions", ())):  # the first step of a damaged log may be unknown
        named["actions"] = [Column(str(i), "") for i in range(width)]
    every_step = np.concatenate([np.empty(0, np.int64), *steps])
    return LogArrays(every_step, ids, header.control_dt, named, values)


def _parts(
    reader: LogReader,
    rows: Rows,
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

    def wanted(kind: CallKind) -> bool:
        if outcomes(kind):
            return len(slices) < len(pieces)
        if kind.kind != "write" or isinstance(rows, Simulation):
            return changes(kind)
        return kind.mode == "reset" or (kind.mode == "state" and kind.name in {*slices, "row"})

    for _, found in groupby(follow(reader, rows, span, wanted), lambda step: step[0].first):
        states: list[list[F64]] = [[] for _ in slices]
        steps = []
        for step in found:
            steps.append(step)
            for values, columns in zip(states, slices.values(), strict=True):
                values.append(rows.rows[:, columns].copy())
        for name, values in zip(slices, states, strict=True):
            pieces[name].append(np.array(values))
        yield steps[0][0], np.array([t for _, t in steps])


def _within(run: Run, span: Span) -> NDArray[np.int64]:
    """Indices of the steps of a run that are in the span."""
    last = sys.maxsize if span.last is None else span.last
    return np.arange(max(span.first - run.first, 0), min(last - run.first + 1, run.steps))


def first_step(reader: LogReader, span: Span) -> int | None:
    """Return the first step of a span that is in a log; None if there is none.

    Raises:
        LogError: If a message is damaged.
    """
    for run in runs(reader, span, outcomes):
        step = max(run.first, span.first)
        if step < run.first + run.steps:
            return step if step in span else None
    return None

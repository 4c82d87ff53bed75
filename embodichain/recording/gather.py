"""Fills arrays from a log: components of the rows that physics received, and what steps gave."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64
from embodichain.recording.arrays import LogArrays
from embodichain.recording.block import Run
from embodichain.recording.chunks import LogReader
from embodichain.recording.log_error import LogError
from embodichain.recording.model_columns import Column
from embodichain.recording.simulation import DifferenceFound
from embodichain.recording.trajectory import Rows, Span, follow, runs

__all__ = ["OUTCOMES", "first_step", "gather"]

OUTCOMES = {
    "actions": ("action", np.float64),
    "rewards": ("reward", np.float64),
    "terminated": ("terminated", np.bool_),
    "truncated": ("truncated", np.bool_),
    "episodes": ("episode_ids", np.int64),
}
"""Field to the array of a ``step`` call that it is, and its type."""

_Part = tuple[Run, NDArray[np.int64], Mapping[str, F64]]
"""A run, which of its steps, and components of the rows in them: (T, n, k)."""


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
        rows: Of the environments that are wanted; followed where a component is read.
        span: The control steps. Those whose rows are not known are left out where a component of
            them is read.
        names: Components of rows, and keys of `OUTCOMES`.
        columns: Columns of each field.

    Raises:
        LogError: If the log says what cannot be.
    """
    layout, ids = reader.require_header().layout, rows.env_ids
    slices = {name: slice(*layout[name]) for name in names if name in layout}
    steps: list[NDArray[np.int64]] = []
    pieces: dict[str, list[NDArray[Any]]] = {name: [] for name in names}
    everyone = len(ids) == reader.require_header().num_envs
    try:
        for run, index, states in _parts(reader, rows, span, slices):
            steps.append(run.first + index)
            outcome = run.calls[-1].arrays
            for name in names:
                if name in slices:
                    pieces[name].append(states[name])
                else:
                    key, dtype = OUTCOMES[name]
                    found = outcome[key][index]
                    pieces[name].append((found if everyone else found[:, ids]).astype(dtype))
    except DifferenceFound as found:
        where = f"{reader.path} does not simulate to what it says"
        raise LogError(f"{where}: {found.difference}") from found
    values = {}
    for name in names:
        shape = (0, len(ids), len(columns[name])) if name in (*slices, "actions") else (0, len(ids))
        dtype = OUTCOMES[name][1] if name in OUTCOMES else np.float64
        values[name] = np.concatenate([np.empty(shape, dtype), *pieces.pop(name)])
    control_dt = reader.require_header().control_dt
    every_step = np.concatenate([np.empty(0, np.int64), *steps])
    return LogArrays(every_step, ids, control_dt, {n: list(columns[n]) for n in names}, values)


def _parts(
    reader: LogReader, rows: Rows, span: Span, slices: Mapping[str, slice]
) -> Iterator[_Part]:
    """The steps of a span, those of each run together."""
    if not slices:
        yield from _steps(reader, span)
        return
    for _, steps in groupby(follow(reader, rows, span), key=lambda found: id(found[0])):
        index: list[int] = []
        states: dict[str, list[F64]] = {name: [] for name in slices}
        for found in steps:
            run, t = found
            index.append(t)
            for name, columns in slices.items():
                states[name].append(rows.rows[:, columns].copy())
        yield run, np.array(index), {name: np.stack(values) for name, values in states.items()}


def _steps(reader: LogReader, span: Span) -> Iterator[_Part]:
    """The same without rows: nothing is followed."""
    last = sys.maxsize if span.last is None else span.last
    for run in runs(reader, span):
        index = np.arange(max(span.first - run.first, 0), min(last - run.first + 1, run.steps))
        if len(index):
            yield run, index, {}


def first_step(reader: LogReader, span: Span) -> int | None:
    """Return the first of some steps that is in a log; None if none is.

    Raises:
        LogError: If a message is damaged.
    """
    for run in runs(reader, span):
        step = max(run.first, span.first)
        if step < run.first + run.steps:
            return step if step in span else None
    return None

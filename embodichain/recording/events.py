"""What a log tells beside states and steps: events of the event manager, and writes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import F64, EnvIndex
from embodichain.recording.block import DRAWN
from embodichain.recording.chunks import LogReader
from embodichain.recording.trajectory import columns_of, runs

__all__ = ["LogEvent", "LogWrite", "read_events", "read_writes"]


@dataclass(frozen=True, slots=True)
class LogEvent:
    """A term of the event manager fired.

    Attributes:
        step: Control step: how many were finished before.
        term: The term.
        mode: ``startup``, ``reset``, ``interval``, ``command``.
        env_ids: (n,) where; None is everywhere.
        drawn: What it drew: name to (n, ...) array.
    """

    step: int
    term: str
    mode: str
    env_ids: EnvIndex | None
    drawn: dict[str, NDArray[np.float64]]


@dataclass(frozen=True, slots=True)
class LogWrite:
    """A write to the simulation outside physics.

    Attributes:
        step: Control step: how many were finished before.
        op: ``state``, ``model``, ``reset`` or ``set_const``, as in `lab.sim.engine.api.Write`.
        field: Component of the state, or model field; empty for ``set_const``.
        env_ids: (n,) environments; None is all.
        columns: (k,) columns within the field, or a slice of them.
        values: (n, k) values; of a ``reset`` the rows that it left; None for ``set_const``.
    """

    step: int
    op: str
    field: str
    env_ids: EnvIndex | None
    columns: NDArray[np.int64] | slice
    values: F64 | None


def read_events(reader: LogReader) -> Iterator[LogEvent]:
    """Yield the events of a log.

    Raises:
        LogError: If a message is damaged.
    """
    for run in runs(reader, wanted=lambda kind: kind.kind == "event"):
        calls = run.of_kind("event")
        for t in range(run.count):
            for call in calls:
                arrays, kind = {name: values[t] for name, values in call.arrays.items()}, call.kind
                ids = arrays.pop("env_ids", None)
                drawn = {name.removeprefix(DRAWN): values for name, values in arrays.items()}
                yield LogEvent(run.first + t, kind.name, kind.mode, ids, drawn)


def read_writes(reader: LogReader) -> Iterator[LogWrite]:
    """Yield the writes of a log.

    Raises:
        LogError: If a message is damaged.
    """
    for run in runs(reader, wanted=lambda kind: kind.kind == "write"):
        calls = run.of_kind("write")
        for t in range(run.count):
            for call in calls:
                arrays, kind = {name: values[t] for name, values in call.arrays.items()}, call.kind
                ids, values = arrays.get("env_ids"), arrays.get("values")
                columns = columns_of(kind.columns)
                yield LogWrite(run.first + t, kind.mode, kind.name, ids, columns, values)

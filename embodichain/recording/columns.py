"""Columns of a state row: which of them physics writes, and what each is called.

Inputs (controls, applied forces, mocap poses...) are columns that physics reads and never writes.
They follow from a start and the writes since, so what physics returns is recorded without them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from embodichain.lab.sim.engine.api import F64

__all__ = ["INPUTS", "Ranges", "column_name", "moved_ranges", "take", "width_of"]

Ranges = list[tuple[int, int]]
"""Columns of a row, as half-open ranges."""

INPUTS = frozenset(
    {
        "qfrc_applied",
        "xfrc_applied",
        "ctrl",
        "eq_active",
        "mocap_pos",
        "mocap_quat",
        "userdata",
    }
)
"""Components that physics reads and never writes."""


def moved_ranges(layout: Mapping[str, slice]) -> Ranges:
    """Columns of whole rows that physics may write; at least one range, if perhaps empty."""
    nstate = max(columns.stop for columns in layout.values())
    keep = np.ones(nstate + 1, np.bool_)
    for name in INPUTS & layout.keys():
        keep[layout[name]] = False
    keep[nstate] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[False], keep]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)] or [(0, 0)]


def width_of(ranges: Sequence[tuple[int, int]]) -> int:
    """How many columns these are."""
    return sum(stop - start for start, stop in ranges)


def take(ranges: Ranges, rows: F64) -> F64:
    """Copy columns of (n, nstate) rows side by side: (n, width)."""
    out = np.empty((len(rows), width_of(ranges)))
    at = 0
    for start, stop in ranges:
        out[:, at : at + stop - start] = rows[:, start:stop]
        at += stop - start
    return out


def column_name(layout: Mapping[str, slice], column: int) -> str:
    """``qpos[3]`` for a column of a row."""
    for name, cols in layout.items():
        if cols.start <= column < cols.stop:
            return f"{name}[{column - cols.start}]"
    return f"column {column}"

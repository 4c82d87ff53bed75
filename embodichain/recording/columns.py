"""Which columns of a state row are written, and what each column is called.

Applied forces are inputs that nobody writes in most tasks: 51 of 123 columns for an arm with a
free cube. They stay out of the file until the first write that is not zero; from there on rows are
whole. Inputs follow from the last state that has them and the writes since, so most states have
only the columns that physics writes. A message says by its width which columns it has.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from embodichain.lab.sim.engine.base import F64, Write

__all__ = [
    "INPUTS_ALWAYS_ZERO",
    "INPUTS_EVERY",
    "NEEDS_HEED",
    "Ranges",
    "RowColumns",
    "column_name",
    "moved_ranges",
    "spread",
    "width_of",
]

Ranges = list[tuple[int, int]]
"""Columns of a row, as half-open ranges."""

INPUTS_EVERY = 50
"""Control steps from one state with inputs to the next, at most: others have what physics writes,
and their inputs follow from the writes since."""

INPUTS_ALWAYS_ZERO = ("qfrc_applied", "xfrc_applied")
_INPUTS = (*INPUTS_ALWAYS_ZERO, "ctrl", "eq_active", "mocap_pos", "mocap_quat", "userdata")
"""Components that physics reads and never writes; what they are follows from writes alone."""
NEEDS_HEED = frozenset({*INPUTS_ALWAYS_ZERO, "row"})
"""Fields of writes that may leave something in columns that are left out."""


class RowColumns:
    """The columns in use; starts narrow, becomes whole at the first applied force.

    Args:
        layout: Component name to its columns within a row.
    """

    def __init__(self, layout: Mapping[str, slice]) -> None:
        self.layout = dict(layout)
        self.nstate: int = max(cols.stop for cols in self.layout.values())
        self.kept = _complement([self.layout[n] for n in INPUTS_ALWAYS_ZERO], self.nstate)
        self.moved = moved_ranges(self.layout)
        self.moved_width = width_of(self.moved)
        self.ranges = self.kept
        self.width = width_of(self.kept)

    @property
    def whole(self) -> bool:
        """Whether every column is written."""
        return bool(self.width == self.nstate)

    def widen(self) -> None:
        """Write whole rows from now on."""
        self.ranges = [(0, self.nstate)]
        self.width = self.nstate

    def heed(self, write: Write) -> None:
        """Widen if a write leaves something in a column that was left out."""
        if self.whole or write.op != "state" or write.values is None:
            return
        if write.field in INPUTS_ALWAYS_ZERO:
            if write.values.view(np.uint64).any():
                self.widen()
        elif write.field == "row":
            full = isinstance(write.columns, slice) and write.columns == slice(None)
            if not full or not self.narrow_enough(write.values):
                self.widen()

    def narrow_enough(self, rows: F64) -> bool:
        """Whether the columns that are left out are all +0 in these whole rows."""
        left_out = [self.layout[name] for name in INPUTS_ALWAYS_ZERO]
        words = np.ascontiguousarray(rows).view(np.uint64)
        return not any(words[:, cols].any() for cols in left_out)

    def take(self, rows: F64, out: F64) -> None:
        """Copy the columns in use of whole rows, (n, nstate), into (n, width)."""
        _side_by_side(self.ranges, rows, out)

    def take_moved(self, rows: F64, out: F64) -> None:
        """Copy the columns that physics may have written, (n, nstate), into (n, moved_width)."""
        _side_by_side(self.moved, rows, out)


def moved_ranges(layout: Mapping[str, slice]) -> Ranges:
    """Columns of whole rows that physics may write, as half-open ranges."""
    nstate = max(columns.stop for columns in layout.values())
    return _complement([layout[name] for name in _INPUTS if name in layout], nstate)


def _side_by_side(ranges: Ranges, rows: F64, out: F64) -> None:
    at = 0
    for start, stop in ranges:
        out[:, at : at + stop - start] = rows[:, start:stop]
        at += stop - start


def spread(kept: Ranges, narrow: F64, nstate: int) -> F64:
    """Whole rows of what was written, (n, width) -> (n, nstate); columns left out are zero."""
    if narrow.shape[1] == nstate:
        return narrow
    out = np.zeros((len(narrow), nstate))
    at = 0
    for start, stop in kept:
        out[:, start:stop] = narrow[:, at : at + stop - start]
        at += stop - start
    return out


def width_of(ranges: Ranges) -> int:
    """How many columns these are."""
    return sum(stop - start for start, stop in ranges)


def _complement(holes: list[slice], size: int) -> Ranges:
    """Half-open ranges of [0, size) outside the holes; at least one, if perhaps empty."""
    keep = np.ones(size + 1, np.bool_)
    for hole in holes:
        keep[hole] = False
    keep[size] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[False], keep]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)] or [(0, 0)]


def column_name(layout: Mapping[str, Any], column: int) -> str:
    """``qpos[3]`` for a column of a row."""
    for name, cols in layout.items():
        if cols.start <= column < cols.stop:
            return f"{name}[{column - cols.start}]"
    return f"column {column}"

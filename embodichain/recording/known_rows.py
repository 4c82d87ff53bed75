"""`KnownRows`: the rows of all environments as physics calls and writes have left them.

Nobody has to copy rows that follow from what was recorded. Columns that physics writes (*moved*)
are apart from its *inputs* (controls, mocap poses...), which only writes change: a state in the
file normally has the former alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64, EnvIndex
from embodichain.lab.sim.engine.layout import as_slice
from embodichain.recording.columns import Ranges, moved_ranges
from embodichain.recording.hashing import RowHash

__all__ = ["KnownRows"]


class Place(Protocol):
    """What a write writes, and where: of a `Write`, or of a `WriteRecord`."""

    @property
    def op(self) -> str: ...
    @property
    def field(self) -> str: ...
    @property
    def columns(self) -> NDArray[np.int64] | slice: ...


_Target = tuple[bool, Any, Any, int]
"""Whether a write changes inputs; columns there, or among the moved ones; which of its values, and
of how many."""
_Sums = NDArray[np.uint64] | None
"""(N,) what some columns add to hashes, if it is known."""


class KnownRows:
    """Rows that are told once and followed from there.

    Args:
        layout: Component name to its columns within a row.
    """

    def __init__(self, layout: Mapping[str, slice]) -> None:
        self._layout = dict(layout)
        self._nstate: int = max(columns.stop for columns in self._layout.values())
        self.moved_columns = _indices(moved_ranges(self._layout))
        self._inputs: F64 = np.zeros((0, 0))  # (N, inputs in use), this object's own
        self._moved: F64 | None = None  # (N, moved), not to be written to while it is lent
        self._lent = False
        self._input_columns: NDArray[np.int64] = np.zeros(0, np.int64)
        self._targets: dict[int, _Target] = {}
        self._written: dict[int, F64] = {}  # by place, what is not in `_inputs` yet; it is lent
        self._sums: dict[int, _Sums] = {}  # for hashes, of places that were written, none twice
        self._resting = np.zeros(0, np.bool_)  # inputs of no such place
        self._resting_sums: _Sums = None
        self.columns([(0, self._nstate)])

    def columns(self, ranges: Ranges) -> None:
        """From here on these columns are in use, at least those that were; others are zero."""
        self._put_in()
        before = self._input_columns if self._moved is not None else None
        used = self._used = _indices(ranges)
        moved = np.isin(used, self.moved_columns)
        self._moved_at = as_slice(np.flatnonzero(moved))
        self._inputs_at = as_slice(np.flatnonzero(~moved))
        self._input_columns = used[~moved]
        self._targets.clear()
        self._resting = np.ones(len(self._input_columns), np.bool_)
        self._forget_sums()
        if before is not None:
            wider = np.zeros((len(self._inputs), len(self._input_columns)))
            wider[:, np.isin(self._input_columns, before)] = self._inputs
            self._inputs = wider

    def take(self, rows: F64) -> None:
        """These are the rows, (N, columns in use)."""
        self._inputs = np.array(rows[:, self._inputs_at], order="C")
        self._moved, self._lent = np.array(rows[:, self._moved_at], order="C"), False
        self._written.clear()
        self._forget_sums()

    def returned(self, moved: F64) -> None:
        """Physics of all environments has returned these moved columns, which are lent."""
        self._moved, self._lent = moved, True

    def returned_some(self, ids: EnvIndex, rows: F64) -> None:
        """Physics of some environments has returned these rows, (n, columns in use)."""
        if self._moved is not None:
            self._own()[ids] = rows[:, self._moved_at]

    def settle(self) -> None:
        """What was lent goes."""
        if self._lent:
            self._own()
        self._put_in()

    def _there(self) -> F64:
        if self._moved is None:
            raise RuntimeError("rows were not told before they are needed")
        return self._moved

    def _own(self) -> F64:
        moved = self._there()
        if self._lent:
            moved, self._lent = moved.copy(), False
            self._moved = moved
        return moved

    def write(self, place: int, write: Place, env_ids: EnvIndex | None, values: F64) -> None:
        """Change rows as a write to components of states did; others make them unknown.

        Args:
            place: Number of what is written and where.
            write: What that is.
            env_ids: (n,) environments; None is all.
            values: (n, k); those of inputs of all environments are lent.

        Raises:
            ValueError: If there is no such component, or not as many values; `IndexError` if there
                is no such column.
        """
        if write.op != "state" or write.field == "row" or self._moved is None:
            return
        is_input, columns, which, width = self._targets.get(place) or self._target(place, write)
        if not is_input:
            rows = self._own()
        else:
            self._disturb(place, columns)
            if env_ids is None:
                if values.shape != (shape := (len(self._inputs), width)):
                    raise ValueError(f"values are {values.shape} where {shape} were announced")
                self._written[place] = values
                return
            self._put_in()
            rows = self._inputs
        if env_ids is None:
            rows[:, columns] = values[:, which]
        elif isinstance(columns, slice):
            rows[env_ids, columns] = values[:, which]
        else:
            rows[env_ids[:, None], columns] = values[:, which]

    def _disturb(self, place: int, columns: Any) -> None:
        """Inputs change: from here on those of this place are hashed apart from others."""
        if place not in self._sums:
            if not self._resting[columns].all():  # another place has some of them
                self._put_in()
                self._forget_sums()
            self._resting[columns] = False
            self._resting_sums = None
        self._sums[place] = None

    def _forget_sums(self) -> None:
        self._sums.clear()
        self._resting[:] = True
        self._resting_sums = None

    def _put_in(self) -> None:
        """Have everything that was written in `_inputs`."""
        for place, values in self._written.items():
            _, columns, which, _ = self._targets[place]
            self._inputs[:, columns] = values[:, which]
        self._written.clear()

    def _target(self, place: int, write: Place) -> _Target:
        """Where a write goes; columns that are not in use get nothing but zeros."""
        if write.field not in self._layout:
            known = ", ".join(self._layout)
            raise ValueError(f"{write.field!r} is written, no component of states: {known}")
        columns = np.arange(self._nstate)[self._layout[write.field]][write.columns]
        is_input = not np.isin(columns, self.moved_columns).any()
        there = self._input_columns if is_input else self.moved_columns
        kept = np.flatnonzero(np.isin(columns, there))
        at = as_slice(np.searchsorted(there, columns[kept]))
        which: Any = slice(None) if len(kept) == len(columns) else kept
        found = self._targets[place] = is_input, at, which, len(columns)
        return found

    def written_inputs(self, place: int, write: Place) -> NDArray[np.int64] | None:
        """(k,) columns of a row that the k values of a write go to; None unless all are inputs."""
        if write.op != "state" or write.field == "row":
            return None
        is_input, at, which, _ = self._targets.get(place) or self._target(place, write)
        whole = isinstance(which, slice)
        return self._input_columns[at] if is_input and whole else None

    def whole(self) -> F64:
        """(N, columns in use), a copy."""
        moved = self._there()
        rows: F64 = np.empty((len(moved), len(self._used)))
        rows[:, self._moved_at] = moved
        rows[:, self._inputs_at] = self.inputs
        return rows

    def input_columns(self, component: str) -> slice | None:
        """Where a component lies in `inputs`; None if it is not in use, and zero."""
        wanted = self._layout[component]
        first, last = np.searchsorted(self._input_columns, (wanted.start, wanted.stop)).tolist()
        return slice(first, last) if last - first == wanted.stop - wanted.start else None

    @property
    def told(self) -> bool:
        """Whether rows are known."""
        return self._moved is not None

    @property
    def moved(self) -> F64:
        """(N, moved) columns that physics writes, live; do not write or keep."""
        return self._there()

    @property
    def inputs(self) -> F64:
        """(N, inputs in use), live; do not write or keep."""
        self._put_in()
        return self._inputs

    def of(self, ids: NDArray[np.int64]) -> F64:
        """(n, nstate) rows of some environments, a copy."""
        moved = self._there()
        rows = np.zeros((len(ids), self._nstate))
        rows[:, self.moved_columns] = moved[ids]
        rows[:, self._input_columns] = self._inputs[ids]
        for place, values in self._written.items():
            _, columns, which, _ = self._targets[place]
            rows[:, self._input_columns[columns]] = values[ids][:, which]
        return rows

    def hashes(self, row_hash: RowHash) -> NDArray[np.uint64]:
        """(N,) hashes of the rows."""
        sums = row_hash.sums(self._there(), self.moved_columns)
        for place, known in self._sums.items():
            if known is None:
                known = self._sums[place] = self._sums_of(place, row_hash)
            sums += known
        if self._resting_sums is None:
            at = as_slice(np.flatnonzero(self._resting))
            self._resting_sums = row_hash.sums(self._inputs[:, at], self._input_columns[at])
        sums += self._resting_sums
        return row_hash.mixed(sums)

    def _sums_of(self, place: int, row_hash: RowHash) -> NDArray[np.uint64]:
        _, columns, which, _ = self._targets[place]
        values = self._written.get(place)
        there = self._inputs[:, columns] if values is None else values[:, which]
        return row_hash.sums(there, self._input_columns[columns])

    def hashes_together(
        self,
        row_hash: RowHash,
        moved: F64,
        written: Iterable[tuple[NDArray[np.int64], F64, bool]],
    ) -> NDArray[np.uint64]:
        """(K, N) hashes of the rows that physics returns in each of the next K steps.

        Args:
            row_hash: Makes them.
            moved: (K, N, moved) what it returns.
            written: What is written in each step: (k,) columns of a row, all of them inputs and no
                two the same; (K, N, k) values; whether that happens before physics.
        """
        self._put_in()
        sums = row_hash.sums(moved, self.moved_columns)
        stays = np.ones(len(self._input_columns), np.bool_)
        for columns, values, before in written:
            at = np.searchsorted(self._input_columns, columns)
            added = row_hash.sums(values, columns)
            stays[at] = False
            if before:
                sums += added
            else:  # physics of the step after finds it
                sums[0] += row_hash.sums(self._inputs[:, at], columns)
                sums[1:] += added[:-1]
        sums += row_hash.sums(self._inputs[:, stays], self._input_columns[stays])
        return row_hash.mixed(sums)


def _indices(ranges: Ranges) -> NDArray[np.int64]:
    return np.concatenate([np.arange(start, stop) for start, stop in ranges])

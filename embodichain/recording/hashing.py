"""A 64-bit hash of each environment's row, vectorised: what physics returned, in 8 bytes.

For words w_j (the bits of column j of the row) and fixed odd coefficients c_j:

    h = mix(sum_j c_j * (w_j xor (w_j >> 32))  mod 2^64)

Any single changed bit changes h: xor-shift, multiplication by an odd number and `mix` (SplitMix64's
finalizer) are bijections of 64-bit words. The xor-shift comes first because a product alone keeps
only parity of the top bit: two changed signs (a negated quaternion) would cancel. A zero word adds
nothing, so leaving out columns that are zero does not change the hash. Not cryptographic: it finds
accidents, not forgers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64

__all__ = ["RowHash"]

U64 = NDArray[np.uint64]
_HALF = np.uint64(32)
_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_SHIFTS = np.uint64(30), np.uint64(27), np.uint64(31)
_CACHED = 2**14
"""Numbers that are hashed at once; more would leave the cache before they are used again."""
_FACTORS = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


def _mix(z: U64) -> U64:
    """SplitMix64's output function (Steele, Lea and Flood, OOPSLA 2014), in place."""
    z ^= z >> _SHIFTS[0]
    z *= _FACTORS[0]
    z ^= z >> _SHIFTS[1]
    z *= _FACTORS[1]
    z ^= z >> _SHIFTS[2]
    return z


def _sums(taken: F64, coefficients: U64) -> U64:
    words = taken.view(np.uint64)
    mixed = words >> _HALF
    mixed ^= words
    found: U64 = np.vecdot(mixed, coefficients)  # `@` is half as fast with integers
    return found


class RowHash:
    """Hashes rows of a fixed width; keeps its scratch memory.

    Args:
        nstate: Columns of a whole row.
    """

    def __init__(self, nstate: int) -> None:
        index = np.arange(1, nstate + 1, dtype=np.uint64)
        self._coefficients = _mix(index * _GAMMA) | np.uint64(1)
        self._scratch: U64 = np.empty((0, 0), np.uint64)
        self._used: tuple[list[tuple[int, int]], U64] = ([(0, nstate)], self._coefficients)

    def __call__(self, rows: F64, ranges: list[tuple[int, int]]) -> U64:
        """Return (n,) hashes.

        Args:
            rows: (n, nstate) rows, contiguous within a row.
            ranges: Columns to look at, as half-open ranges; the others must be zero.
        """
        words = rows.view(np.uint64)
        coefficients = self._coefficients_of(ranges)
        shape = len(rows), len(coefficients)
        if self._scratch.shape != shape:
            self._scratch = np.empty(shape, np.uint64)
        scratch, at = self._scratch, 0
        for start, stop in ranges:
            part = scratch[:, at : at + stop - start]
            source = words[:, start:stop]
            np.right_shift(source, _HALF, out=part)
            np.bitwise_xor(part, source, out=part)
            at += stop - start
        return _mix(np.vecdot(scratch, coefficients))

    def of_columns(self, taken: F64, ranges: list[tuple[int, int]]) -> U64:
        """Return (n,) hashes of rows whose columns in use were copied side by side.

        Args:
            taken: (n, width) those columns, contiguous.
            ranges: Which columns they are.
        """
        return _mix(_sums(taken, self._coefficients_of(ranges)))

    def sums(self, taken: F64, columns: NDArray[np.int64]) -> U64:
        """Return (n,) or (K, n) what some columns add to the hash before it is `mixed`.

        Args:
            taken: (n, k) or (K, n, k) those columns, contiguous within a row.
            columns: (k,) which they are.
        """
        coefficients = self._coefficients[columns]
        if taken.ndim == 2:
            return _sums(taken, coefficients)
        found = np.empty(taken.shape[:-1], np.uint64)
        each = max(1, _CACHED // max(1, taken[0].size))
        for at in range(0, len(taken), each):
            found[at : at + each] = _sums(taken[at : at + each], coefficients)
        return found

    @staticmethod
    def mixed(sums: U64) -> U64:
        """Return (n,) hashes from the sums over all columns, in place."""
        return _mix(sums)

    def _coefficients_of(self, ranges: list[tuple[int, int]]) -> U64:
        if self._used[0] != ranges:
            self._used = ranges, np.concatenate([self._coefficients[a:b] for a, b in ranges])
        return self._used[1]

"""A 64-bit hash of each environment's row after physics.

For words w_j (the bits of column j of the row) and fixed odd coefficients c_j:

    h = mix(sum_j c_j * (w_j xor (w_j >> 32))  mod 2^64)

Any single changed bit changes h: xor-shift, multiplication by an odd number and `mix` (SplitMix64's
finalizer) are bijections of 64-bit words. The xor-shift comes first because a product alone keeps
only parity of the top bit: two changed signs (a negated quaternion) would cancel. The hash is not
cryptographic: it detects accidental changes, not forged ones.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import F64

__all__ = ["row_hashes"]

U64 = NDArray[np.uint64]
_HALF = np.uint64(32)
_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_SHIFTS = np.uint64(30), np.uint64(27), np.uint64(31)
_FACTORS = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


def _mix(z: U64) -> U64:
    """SplitMix64's output function (Steele, Lea and Flood, OOPSLA 2014), in place."""
    z ^= z >> _SHIFTS[0]
    z *= _FACTORS[0]
    z ^= z >> _SHIFTS[1]
    z *= _FACTORS[1]
    z ^= z >> _SHIFTS[2]
    return z


@cache
def _coefficients(width: int) -> U64:
    return _mix(np.arange(1, width + 1, dtype=np.uint64) * _GAMMA) | np.uint64(1)


def row_hashes(rows: F64) -> U64:
    """Return (n,) hashes of (n, width) contiguous rows."""
    words = rows.view(np.uint64)
    mixed = words >> _HALF
    mixed ^= words
    return _mix(np.vecdot(mixed, _coefficients(rows.shape[1])))

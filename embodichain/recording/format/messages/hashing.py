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
from embodichain.utils.random import GAMMA, splitmix64

__all__ = ["row_hashes"]

U64 = NDArray[np.uint64]
_HALF = np.uint64(32)


@cache
def _coefficients(width: int) -> U64:
    return splitmix64(np.arange(1, width + 1, dtype=np.uint64) * GAMMA) | np.uint64(1)


def row_hashes(rows: F64) -> U64:
    """Return (n,) hashes of (n, width) contiguous rows."""
    words = rows.view(np.uint64)
    mixed = words >> _HALF
    mixed ^= words
    return splitmix64(np.vecdot(mixed, _coefficients(rows.shape[1])))

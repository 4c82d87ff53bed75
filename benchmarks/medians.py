"""How sure a median is."""

from __future__ import annotations

import math
from collections.abc import Sequence

__all__ = ["sure"]

_NORMAL_90 = 1.645


def sure(values: Sequence[float]) -> tuple[float, float]:
    """Where the median lies with 90 %, from sorted values: the sign test's interval."""
    n = len(values)
    rank = max(0, math.floor((n - _NORMAL_90 * math.sqrt(n)) / 2))
    return values[rank], values[-1 - rank]

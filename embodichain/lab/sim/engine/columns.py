"""`columns_of`: indices as a slice, where that is possible."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.api import Columns

__all__ = ["columns_of"]


def columns_of(ids: Sequence[int] | NDArray[Any]) -> Columns:
    """Return a slice if indices ascend evenly (gives views, not copies), else the indices."""
    return _columns(np.asarray(ids, np.int64).tobytes())


@lru_cache(maxsize=1024)
def _columns(ids: bytes) -> Columns:
    array = np.frombuffer(ids, np.int64)
    if not len(array):
        return array
    step = int(array[1] - array[0]) if len(array) > 1 else 1
    if step > 0 and (np.diff(array) == step).all():
        return slice(int(array[0]), int(array[-1]) + 1, step if step > 1 else None)
    return array

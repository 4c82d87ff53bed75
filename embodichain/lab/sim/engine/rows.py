"""Which entries of the rows a write means, and what it left there."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["as_slice", "left", "picked", "where"]


def as_slice(indices: NDArray[np.int64]) -> Any:
    """Ascending indices, as a slice where they are neighbours: that costs half."""
    if len(indices) and (np.diff(indices) == 1).all():
        return slice(int(indices[0]), int(indices[-1]) + 1)
    return indices


def where(env_ids: EnvIndex | None, columns: NDArray[np.int64] | slice) -> tuple[Any, Any]:
    """The index of these columns in the rows of these environments."""
    if env_ids is None:
        return slice(None), columns
    return (env_ids if isinstance(columns, slice) else env_ids[:, None]), columns


def picked(view: NDArray[Any], env_ids: EnvIndex | None, columns: NDArray[np.int64] | slice) -> F64:
    """What a write left in the rows, as float64: a live view if it means all environments."""
    found: F64 = view[where(env_ids, columns)].astype(np.float64, copy=False)
    return found


def left(
    view: F64, values: Any, env_ids: EnvIndex | None, columns: NDArray[np.int64] | slice
) -> F64:
    """The same as `picked`, of a write of these values: themselves if they lie side by side.

    Whoever copies them finds them in the cache, and in a third of the time.
    """
    found = picked(view, env_ids, columns)
    if env_ids is not None or type(values) is not np.ndarray or values.dtype is not found.dtype:
        return found
    given: F64 = values
    return given if given.shape == found.shape and given.flags.c_contiguous else found

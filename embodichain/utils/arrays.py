"""Functions that take numpy arrays and arrays on a device (`DeviceArray`) alike."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import torch

__all__ = [
    "contiguous",
    "is_host",
    "may_be_set",
    "precise",
    "rows_at",
    "tensor_of",
    "zeros",
]


def is_host(array: Any) -> bool:
    """Whether an array, or anything else, is not on a device."""
    return not hasattr(type(array), "tensor")


def may_be_set(mask: Any) -> bool:
    """Whether a flag of a mask is set; True on a device, where that is not known."""
    return not is_host(mask) or bool(mask.any())


def tensor_of(array: Any) -> torch.Tensor:
    """Return a tensor that shares memory with an array, where the array is."""
    if is_host(array):
        import torch  # scenes are checked without it

        return torch.from_numpy(array)
    found: torch.Tensor = array.tensor
    return found


def zeros(shape: tuple[int, ...], like: Any) -> NDArray[np.float64]:
    """Return zeros, where an array is: float64, on a device in the type of its numbers."""
    found: NDArray[np.float64] = (
        np.zeros(shape) if is_host(like) else type(like)(like.tensor.new_zeros(shape))
    )
    return found


def contiguous(array: Any, dtype: Any = None) -> NDArray[Any]:
    """Return numbers in order of their indices, on the host as `numpy.ascontiguousarray`.

    Rounding of numpy's functions depends on the order in memory; that of a device does not.
    """
    if is_host(array):
        return np.ascontiguousarray(array, dtype)
    found: NDArray[Any] = array if dtype is None else array.astype(dtype, copy=False)
    return found


def precise(array: Any) -> NDArray[Any]:
    """Return numbers as float64 on a device too, where arrays are float32 otherwise."""
    found: NDArray[Any] = array if is_host(array) else type(array)(array.tensor.double())
    return found


def rows_at(table: NDArray[Any], indices: Any) -> NDArray[Any]:
    """Return rows of an array of the host at indices (n,), where these are."""
    found: NDArray[Any] = table[indices] if is_host(indices) else indices.rows_of(table)
    return found

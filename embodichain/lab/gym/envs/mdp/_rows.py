"""Sums over the columns of (N, K) arrays, and conversion of arrays to tensors.

A sum is a dot product of each contiguous row: its rounding does not depend on the number of
environments, unlike that of a numpy reduction.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.utils.arrays import contiguous, tensor_of
from embodichain.utils.math import norm, quat_conjugate, quat_multiply, squares

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.utils.array_types import Floats

__all__ = [
    "action_rows",
    "angle_between",
    "mean",
    "norm",
    "squares",
    "tensor",
    "total",
]


def total(values: NDArray[Any]) -> Floats:
    """Sum of the rows, (N, K) -> (N,); 0 where K is 0."""
    rows = contiguous(values, np.float64)
    return np.vecdot(rows, _ones(rows.shape[1]))


@cache
def _ones(count: int) -> Floats:
    return np.ones(count)


def mean(values: Floats) -> Floats:
    """Mean of the rows, (N, K) -> (N,)."""
    return total(values) / max(values.shape[1], 1)


def angle_between(a: Floats, b: Floats) -> Floats:
    """(N,) rad in [0, pi] of the rotation from one orientation to another, (N, 4) wxyz each.

    2 atan2(|v|, |w|) of the difference, which is exact near 0, unlike an arc cosine.
    """
    difference = quat_multiply(quat_conjugate(a), b)
    sine = norm(difference[:, 1:])
    cosine = np.abs(difference[:, 0])
    return 2.0 * np.arctan2(sine, contiguous(cosine))


def action_rows(env: TermContext, action: Any) -> Floats:
    """(N, A) float64 copy of the action that rewards receive.

    Raises:
        TypeError: If it is not a tensor: the columns of a `TensorDict` have no order.
    """
    if not hasattr(action, "detach"):
        raise TypeError(f"this term needs an action tensor, got {type(action).__name__}")
    return env.arrays.of(action).astype(np.float64)


def tensor(array: NDArray[np.float64] | NDArray[np.bool_]) -> torch.Tensor:
    """A new tensor, float32 or bool."""
    return tensor_of(array if array.dtype == np.bool_ else array.astype(np.float32))

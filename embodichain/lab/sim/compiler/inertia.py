"""Moments of inertia about a body's own axes: one formula for the compiler and for handles."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

__all__ = ["inertia_about_axes"]

F64 = NDArray[np.float64]


def inertia_about_axes(iquat: F64, moments: F64) -> F64:
    """Diagonal of the inertia tensor in the body's axes.

    Terms are added in a fixed order: another number of environments changes no bit.

    Args:
        iquat: (4,) orientation of the principal axes in the body, wxyz.
        moments: (..., 3) principal moments, kg m^2.
    """
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, iquat)
    squares = rotation.reshape(3, 3) ** 2
    found: F64 = moments[..., :1] * squares[:, 0]
    found = found + moments[..., 1:2] * squares[:, 1]
    return found + moments[..., 2:] * squares[:, 2]

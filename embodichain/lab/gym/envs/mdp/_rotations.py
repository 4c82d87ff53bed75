"""Orientations in the forms that observations use, from wxyz quaternions; float64, row by row."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from embodichain.utils.math import quat_to_matrix

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.api import F64

__all__ = ["Heading", "Rotation", "as_rotation", "heading", "pose_matrix", "unique_quat"]

Rotation = Literal["quat", "matrix", "rot6d"]
Heading = Literal["yaw", "sin_cos"]


def unique_quat(quat: F64) -> F64:
    """The one of q and -q, which are the same rotation, that has w >= 0, (..., 4)."""
    return np.where(quat[..., :1] < 0.0, -quat, quat)


def as_rotation(quat: F64, kind: Rotation) -> F64:
    """Orientations as quaternions with w >= 0, matrices, or six numbers.

    Six numbers are the first column of the matrix, then the second: a form without jumps (Zhou et
    al., "On the continuity of rotation representations in neural networks", CVPR 2019).

    Args:
        quat: (..., 4) unit wxyz.
        kind: The form.

    Returns:
        (..., 4), (..., 3, 3) or (..., 6).
    """
    if kind == "quat":
        return unique_quat(quat)
    matrix = quat_to_matrix(quat)
    if kind == "matrix":
        return matrix
    return np.concatenate([matrix[..., 0], matrix[..., 1]], axis=-1)


def heading(quat: F64, kind: Heading) -> F64:
    """Direction of the x axis in the horizontal plane, about z from the world's x axis.

    Args:
        quat: (N, 4) unit wxyz.
        kind: ``yaw``, the angle in (-pi, pi]; or ``sin_cos``, its sine and cosine, without a jump.

    Returns:
        (N, 1) rad or (N, 2); yaw 0 where the x axis is vertical.
    """
    w, x, y, z = (quat[:, i] for i in range(4))
    ahead, left = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)
    if kind == "yaw":
        found: F64 = np.arctan2(left, ahead)[:, None]
        return found
    length = np.sqrt(ahead * ahead + left * left)
    vertical = length == 0.0
    length = np.where(vertical, 1.0, length)
    return np.stack([left / length, np.where(vertical, 1.0, ahead / length)], axis=1)


def pose_matrix(position: F64, quat: F64) -> F64:
    """(..., 4, 4) of positions (..., 3) and unit wxyz quaternions (..., 4)."""
    out = np.zeros((*position.shape[:-1], 4, 4))
    out[..., :3, :3] = quat_to_matrix(quat)
    out[..., :3, 3] = position
    out[..., 3, 3] = 1.0
    return out

"""Initial poses of entities, and moments of inertia about a body's axes."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.cfg import ObjectBaseCfg
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import euler_xyz_to_quat, matrix_to_quat, normalize_quat

__all__ = ["inertia_about_axes", "initial_pose"]

F64 = NDArray[np.float64]


def initial_pose(cfg: ObjectBaseCfg) -> tuple[F64, F64]:
    """Return position (3,) in metres and unit wxyz quaternion (4,).

    `init_local_pose` wins over `init_quat`, that over `init_rot` (degrees, intrinsic XYZ).

    Raises:
        ConfigError: If a value has the wrong shape, is not finite, or is no rotation.
    """
    if cfg.init_local_pose is not None:
        return _from_matrix(cfg.init_local_pose)
    pos = _vector(cfg.init_pos, 3, "init_pos")
    if cfg.init_quat is not None:
        quat = _vector(cfg.init_quat, 4, "init_quat")
        try:
            return pos, normalize_quat(quat)
        except ValueError as error:
            raise ConfigError([Problem("init_quat", f"{error}, got {quat.tolist()}")]) from error
    angles = _vector(cfg.init_rot, 3, "init_rot")
    return pos, euler_xyz_to_quat(angles * (math.pi / 180.0))


def _from_matrix(value: object) -> tuple[F64, F64]:
    matrix = _vector(value, 16, "init_local_pose").reshape(4, 4)
    rotation = matrix[:3, :3]
    off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if off > 1e-3 or np.linalg.det(rotation) < 0 or not np.allclose(matrix[3], [0, 0, 0, 1]):
        message = "must be a 4x4 rigid transform: a rotation, a translation, last row 0 0 0 1"
        raise ConfigError([Problem("init_local_pose", message)])
    return matrix[:3, 3].copy(), matrix_to_quat(rotation)


def _vector(value: object, size: int, key: str) -> F64:
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise ConfigError([Problem(key, f"wants {size} numbers, got {value!r}")]) from None
    if array.size != size or not np.isfinite(array).all():
        raise ConfigError([Problem(key, f"wants {size} finite numbers, got {array.tolist()}")])
    return array.reshape(-1).copy()


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

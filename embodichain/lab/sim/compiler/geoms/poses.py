"""Initial poses of entities, from a position and one of three forms of orientation."""

from __future__ import annotations

import math

import numpy as np

from embodichain.lab.sim.cfg import ObjectBaseCfg
from embodichain.lab.sim.compiler.index import F64
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import euler_xyz_to_quat, matrix_to_quat, normalize_quat

__all__ = ["check_pose", "given_pose", "initial_pose"]

_NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])


def initial_pose(cfg: ObjectBaseCfg) -> tuple[F64, F64]:
    """Return position (3,) in metres and unit wxyz quaternion (4,); by default no change.

    `init_local_pose` overrides `init_quat`, which overrides `init_rot` (degrees, intrinsic XYZ).

    Raises:
        ConfigError: If a value has the wrong shape, is not finite, or is not a rotation.
    """
    pos, quat = given_pose(cfg)
    if pos is None:
        pos = np.zeros(3)
    if quat is None:
        quat = _NO_TURN.copy()
    return pos, quat


def given_pose(cfg: ObjectBaseCfg) -> tuple[F64 | None, F64 | None]:
    """As `initial_pose`; None for a position or an orientation that the config does not give."""
    if cfg.init_local_pose is not None:
        matrix = _vector(cfg.init_local_pose, 16, "init_local_pose").reshape(4, 4)
        rotation = matrix[:3, :3]
        is_orthogonal = np.abs(rotation @ rotation.T - np.eye(3)).max() <= 1e-3
        is_mirrored = np.linalg.det(rotation) < 0
        if not is_orthogonal or is_mirrored or not np.allclose(matrix[3], [0, 0, 0, 1]):
            message = "must be a 4x4 rigid transform: a rotation, a translation, last row 0 0 0 1"
            raise ConfigError([Problem("init_local_pose", message)])
        return matrix[:3, 3].copy(), matrix_to_quat(rotation)
    # Both are None in an `ArticulationCfg` that does not give them.
    init_pos: object = cfg.init_pos
    init_rot: object = cfg.init_rot
    pos = None if init_pos is None else _vector(init_pos, 3, "init_pos")
    if cfg.init_quat is not None:
        quat = _vector(cfg.init_quat, 4, "init_quat")
        try:
            return pos, normalize_quat(quat)
        except ValueError as error:
            raise ConfigError([Problem("init_quat", f"{error}, got {quat.tolist()}")]) from error
    if init_rot is None:
        return pos, None
    return pos, euler_xyz_to_quat(_vector(init_rot, 3, "init_rot") * (math.pi / 180.0))


def _vector(value: object, size: int, key: str) -> F64:
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise ConfigError([Problem(key, f"must be {size} numbers, got {value!r}")]) from None
    if array.size != size or not np.isfinite(array).all():
        raise ConfigError([Problem(key, f"must be {size} finite numbers, got {array.tolist()}")])
    return array.reshape(-1).copy()


def check_pose(cfg: ObjectBaseCfg) -> list[Problem]:
    """Return what is wrong with an initial pose."""
    try:
        initial_pose(cfg)
    except ConfigError as error:
        return list(error.problems)
    return []

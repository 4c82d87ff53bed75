"""Velocities of roots and ranges over six axes, shared by events that move or push whole entities.

A free joint keeps its linear velocity in the environment's axes and its angular one in the body's;
everything here is in the environment's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.drawing import Uniform
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import euler_xyz_to_quat, quat_conjugate, quat_rotate

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = [
    "AXES",
    "need_free_root",
    "read_root_velocity",
    "rpy_to_quat",
    "six_axes",
    "write_root_velocity",
]

AXES = ("x", "y", "z", "roll", "pitch", "yaw")


def six_axes(name: str, ranges: Mapping[Any, Sequence[float]] | None) -> Uniform | None:
    """A draw of shape (6,) from a map from axes to [low, high]; absent axes are 0.

    None if no axis is named: there is nothing to draw.
    """
    if not ranges:
        return None
    low, high = np.array([ranges.get(axis, (0.0, 0.0)) for axis in AXES], np.float64).T
    return Uniform(name, low, high)


def rpy_to_quat(angles: F64) -> F64:
    """Wxyz quaternions of roll, pitch, yaw in rad about fixed axes, R = Rz Ry Rx, (..., 3)."""
    return quat_conjugate(euler_xyz_to_quat(-angles))


def need_free_root(entity: ResolvedEntity, path: str = "entity_cfg.uid") -> None:
    """Refuse an entity whose root has no velocity.

    Raises:
        ConfigError: If its base is fixed, or it is an object that is not dynamic.
    """
    if entity.asset.entity.free_qvel_adr < 0:
        message = (
            f"{entity.uid!r} cannot get a velocity: it needs body_type: dynamic (an object) or "
            "fix_base: false (a robot)"
        )
        raise ConfigError([Problem(path, message)])


def read_root_velocity(asset: Any) -> F64:
    """(N, 6) linear velocity of the root's origin in m/s, then angular in rad/s; a copy."""
    start = asset.entity.free_qvel_adr
    qvel = asset.engine.state("qvel")[:, start : start + 6]
    turned = quat_rotate(asset.read_pose()[1], qvel[:, 3:])
    return np.concatenate([qvel[:, :3], turned], axis=1)


def write_root_velocity(asset: Any, velocity: F64, env_ids: EnvIndex | None) -> None:
    """Set the root's velocity.

    Args:
        asset: A handle with a free root.
        velocity: (n, 6) linear in m/s, then angular in rad/s.
        env_ids: (n,) environments, or None for all.
    """
    start = asset.entity.free_qvel_adr
    quat = asset.read_pose()[1]
    local = quat_rotate(quat_conjugate(quat if env_ids is None else quat[env_ids]), velocity[:, 3:])
    values = np.concatenate([velocity[:, :3], local], axis=1)
    asset.engine.write("qvel", values, env_ids, slice(start, start + 6))

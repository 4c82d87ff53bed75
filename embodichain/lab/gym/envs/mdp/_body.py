"""Orientation and velocity of an entity or of its picked link, float64, in a fixed order of sums.

Positions are in `_spatial`. Quaternions are wxyz.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _spatial
from embodichain.utils.math import cross, quat_conjugate, quat_multiply, quat_rotate

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.base import F64

__all__ = [
    "angle_between",
    "angular_velocity",
    "body_angular_velocity",
    "body_id",
    "body_linear_velocity",
    "body_velocity",
    "cos_tilt",
    "heading_velocity",
    "linear_velocity",
    "orientation",
    "projected_gravity",
    "velocity",
]


def body_id(entity: ResolvedEntity) -> int:
    """MuJoCo body of the picked link, else of the root."""
    link = entity.link_body
    return int(entity.asset.entity.root_body_id) if link is None else link


def orientation(entity: ResolvedEntity) -> F64:
    """(N, 4) wxyz: a live view, not to be written to or kept."""
    link = entity.link_body
    found: F64 = (
        entity.asset.read_pose()[1]
        if link is None
        else entity.asset.engine.derived("xquat")[:, link]
    )
    return found


def _free_qvel(entity: ResolvedEntity) -> F64 | None:
    """(N, 6) velocity of a floating root's own joint: linear in world axes, angular in its own."""
    start = entity.asset.entity.free_qvel_adr
    if entity.link_body is not None or start < 0:
        return None
    found: F64 = entity.asset.engine.state("qvel")[:, start : start + 6]
    return found


def linear_velocity(entity: ResolvedEntity) -> F64:
    """(N, 3) m/s of the origin, world axes.

    A floating root's is its joint's own. Else it is MuJoCo's `cvel`, which is (angular, linear) at
    the centre of mass of the kinematic tree, moved to the origin: v = v_com + w x (origin - com).
    """
    free = _free_qvel(entity)
    if free is not None:
        return free[:, :3]
    engine, body = entity.asset.engine, body_id(entity)
    cvel = engine.derived("cvel")[:, body]
    com = engine.derived("subtree_com")[:, int(engine.model.body_rootid[body])]
    arm = engine.derived("xpos")[:, body] - com
    found: F64 = cvel[:, 3:] + cross(cvel[:, :3], arm)
    return found


def angular_velocity(entity: ResolvedEntity) -> F64:
    """(N, 3) rad/s, world axes."""
    free = _free_qvel(entity)
    if free is not None:
        return quat_rotate(orientation(entity), free[:, 3:])
    found: F64 = entity.asset.engine.derived("cvel")[:, body_id(entity), :3]
    return found


def velocity(entity: ResolvedEntity) -> tuple[F64, F64]:
    """Linear velocity of the origin in m/s and angular in rad/s, (N, 3) each, world axes."""
    return linear_velocity(entity), angular_velocity(entity)


def body_linear_velocity(entity: ResolvedEntity) -> F64:
    """(N, 3) m/s of the origin, in the axes of the body itself."""
    return quat_rotate(quat_conjugate(orientation(entity)), linear_velocity(entity))


def body_angular_velocity(entity: ResolvedEntity) -> F64:
    """(N, 3) rad/s, in the axes of the body itself."""
    free = _free_qvel(entity)
    if free is not None:
        return free[:, 3:]
    return quat_rotate(quat_conjugate(orientation(entity)), angular_velocity(entity))


def body_velocity(entity: ResolvedEntity) -> tuple[F64, F64]:
    """`velocity` in the axes of the body itself."""
    return body_linear_velocity(entity), body_angular_velocity(entity)


def heading_velocity(entity: ResolvedEntity) -> F64:
    """(N, 3) linear velocity in the heading frame: the world's, turned about z to the body's yaw.

    The heading is the direction of the body's x axis in the plane; of a body whose x axis is
    vertical, the world's x axis.
    """
    linear = linear_velocity(entity)
    w, x, y, z = (orientation(entity)[:, i] for i in range(4))
    ahead, left = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)
    length = np.sqrt(ahead * ahead + left * left)
    vertical = length == 0.0
    length = np.where(vertical, 1.0, length)
    cos, sin = np.where(vertical, 1.0, ahead / length), left / length
    return np.stack(
        [
            cos * linear[:, 0] + sin * linear[:, 1],
            cos * linear[:, 1] - sin * linear[:, 0],
            linear[:, 2],
        ],
        axis=1,
    )


def projected_gravity(entity: ResolvedEntity) -> F64:
    """(N, 3) the world's unit vector straight down, in the body's axes: (0, 0, -1) when upright."""
    w, x, y, z = (orientation(entity)[:, i] for i in range(4))
    return np.stack(
        [2.0 * (w * y - x * z), -2.0 * (y * z + w * x), 2.0 * (x * x + y * y) - 1.0], axis=1
    )


def cos_tilt(entity: ResolvedEntity) -> F64:
    """(N,) cosine of the angle between the body's z axis and the world's."""
    q = orientation(entity)
    x, y = q[:, 1], q[:, 2]
    found: F64 = 1.0 - 2.0 * (x * x + y * y)
    return found


def angle_between(a: F64, b: F64) -> F64:
    """(N,) rad in [0, pi] of the rotation from one orientation to another, (N, 4) each.

    2 atan2(|v|, |w|) of the difference, which is exact near 0 where an arc cosine is not.
    """
    difference = quat_multiply(quat_conjugate(a), b)
    sine, cosine = _spatial.norm(difference[:, 1:]), np.abs(difference[:, 0])
    found: F64 = 2.0 * np.arctan2(sine, np.ascontiguousarray(cosine))
    return found

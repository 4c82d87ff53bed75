"""Postures of a robot: its start, positions drawn within its limits, what touches there."""

from __future__ import annotations

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.robot.contacts.link_siblings import Pair
from embodichain.lab.sim.compiler.robot.files.initial_state import Keyframe
from embodichain.lab.sim.compiler.robot.files.robot_joints import movable_joints
from embodichain.utils.random import GAMMA, splitmix64

__all__ = ["DEPTH", "POSTURES", "deepest_contacts", "draw_postures", "start_posture"]

DEPTH = 1e-3
"""Metres: links that are deeper in each other overlap."""
POSTURES = 200
"""How many postures stand for all that a robot can take."""
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)


def start_posture(model: mujoco.MjModel, qpos: F64, keyframe: Keyframe | None) -> F64:
    """Return (nq,) positions of all joints at the start, the root where the file has it.

    Args:
        model: The robot's model.
        qpos: (D,) positions of its hinges and slides.
        keyframe: Gives those of its ball joints, if the file has one.
    """
    start: F64 = model.qpos0.copy()
    start[model.jnt_qposadr[movable_joints(model)]] = qpos
    if keyframe is not None:
        for name, (quat, _) in keyframe.balls.items():
            first = int(model.joint(name).qposadr[0])
            start[first : first + 4] = quat
    return start


def draw_postures(model: mujoco.MjModel, start: F64, count: int = POSTURES) -> F64:
    """Return fixed positions of a model's joints, uniform within their limits.

    A hinge without limits turns by half a turn to both sides. Other joints stay at the start:
    slides without limits, ball and free joints.

    Args:
        model: The model.
        start: (nq,) positions at the start.
        count: How many.

    Returns:
        (count, nq) positions, the same in every process.
    """
    is_hinge = model.jnt_type == _HINGE
    is_slide = model.jnt_type == _SLIDE
    is_limited = model.jnt_limited.astype(np.bool_)
    drawn = np.flatnonzero(is_hinge | (is_slide & is_limited))
    low = np.where(is_limited, model.jnt_range[:, 0], -np.pi)[drawn]
    high = np.where(is_limited, model.jnt_range[:, 1], np.pi)[drawn]
    counters = np.arange(1, count * len(drawn) + 1, dtype=np.uint64) * GAMMA
    unit = (splitmix64(counters) >> np.uint64(11)).astype(np.float64) * 2.0**-53
    postures = np.tile(start, (count, 1))
    postures[:, model.jnt_qposadr[drawn]] = low + unit.reshape(count, -1) * (high - low)
    return postures


def deepest_contacts(
    model: mujoco.MjModel, data: mujoco.MjData, qpos: F64, disabled: int = 0
) -> dict[Pair, float]:
    """Return pairs of bodies that touch at a position -> the depth of the deepest contact, m.

    Args:
        model: The model; options that switch contacts off have no effect.
        data: Its state, which changes.
        qpos: (nq,) the position.
        disabled: Flags of `mjtDisableBit`, such as the filter of parent and child.
    """
    disableflags = model.opt.disableflags
    enableflags = model.opt.enableflags
    model.opt.disableflags = disabled
    model.opt.enableflags = 0
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    model.opt.disableflags = disableflags
    model.opt.enableflags = enableflags
    bodies = np.sort(model.geom_bodyid[data.contact.geom], axis=1).tolist()
    depths: dict[Pair, float] = {}
    for (a, b), distance in zip(bodies, data.contact.dist.tolist(), strict=True):
        depths[a, b] = max(depths.get((a, b), -np.inf), -distance)
    return depths

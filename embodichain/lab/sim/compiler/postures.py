"""Postures of a robot: its start, positions drawn within its limits, and what touches there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.link_siblings import Pair
from embodichain.lab.sim.compiler.robot_joints import Keyframe, movable_joints
from embodichain.utils.random import GAMMA, splitmix64

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.articulation import ParsedArticulation

__all__ = ["DEPTH", "deepest_contacts", "draw_postures", "overlapping_links", "start_posture"]

DEPTH = 1e-3
"""Metres: links that are deeper in each other overlap."""
_POSTURES = 200
_SHARE = 0.05
_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


def start_posture(model: mujoco.MjModel, qpos: F64, keyframe: Keyframe | None) -> F64:
    """Return (nq,) positions of all joints at the start, the root where the file has it.

    Args:
        model: The robot's model.
        qpos: (D,) positions of its hinges and slides.
        keyframe: Gives those of its ball joints, if the file has one.
    """
    start: F64 = model.qpos0.copy()
    start[model.jnt_qposadr[movable_joints(model)]] = qpos
    for name, (quat, _) in (keyframe.balls if keyframe is not None else {}).items():
        first = int(model.joint(name).qposadr[0])
        start[first : first + 4] = quat
    return start


def draw_postures(model: mujoco.MjModel, start: F64, count: int = _POSTURES) -> F64:
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
    hinge = model.jnt_type == _HINGE
    limited = model.jnt_limited.astype(np.bool_)
    drawn = np.flatnonzero(hinge | ((model.jnt_type == _SLIDE) & limited))
    low = np.where(limited, model.jnt_range[:, 0], -np.pi)[drawn]
    high = np.where(limited, model.jnt_range[:, 1], np.pi)[drawn]
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
    flags = model.opt.disableflags, model.opt.enableflags
    model.opt.disableflags, model.opt.enableflags = disabled, 0
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    model.opt.disableflags, model.opt.enableflags = flags
    bodies = np.sort(model.geom_bodyid[data.contact.geom], axis=1).tolist()
    found: dict[Pair, float] = {}
    for (a, b), distance in zip(bodies, data.contact.dist.tolist(), strict=True):
        found[a, b] = max(found.get((a, b), -np.inf), -distance)
    return found


def overlapping_links(parsed: ParsedArticulation) -> dict[tuple[str, str], float]:
    """Return pairs of links that collide and overlap in many postures -> share of the postures.

    These are hulls that are larger than what they stand for, or real limits of the robot. Pairs
    that the config names in `self_collision.include` are left out.

    Args:
        parsed: The robot.

    Returns:
        Pairs that are more than 1 mm in each other in more than 5 % of 200 fixed postures, the
        most frequent first.
    """
    model = parsed.model
    data = mujoco.MjData(model)
    start = start_posture(model, parsed.init_qpos, parsed.keyframe)
    columns = [int(model.joint(name).qposadr[0]) for name in parsed.joint_names]
    counts: dict[Pair, int] = {}
    for qpos in draw_postures(model, start):
        qpos[columns] = _with_followers(parsed, qpos[columns])
        for pair, depth in deepest_contacts(model, data, qpos).items():
            if pair[0] and depth > DEPTH:
                counts[pair] = counts.get(pair, 0) + 1
    often = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    named = {
        (model.body(a).name, model.body(b).name): n / _POSTURES
        for (a, b), n in often
        if n > _SHARE * _POSTURES
    }
    return {k: v for k, v in named.items() if k not in parsed.self_collision.included}


def _with_followers(parsed: ParsedArticulation, qpos: F64) -> F64:
    """Set joints that follow others; a chain of them is followed to its end."""
    rules = [
        *zip(
            parsed.mimic_ids,
            parsed.mimic_parents,
            parsed.mimic_multipliers,
            parsed.mimic_offsets,
            strict=True,
        )
    ]
    for _ in range(len({*parsed.mimic_ids} & {*parsed.mimic_parents}) + 1):
        for follower, leader, multiplier, offset in rules:
            qpos[follower] = multiplier * qpos[leader] + offset
    return qpos

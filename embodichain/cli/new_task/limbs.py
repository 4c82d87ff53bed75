"""`find_limbs` and `find_wheels`: what a robot stands on, by the tree of its links.

A URDF does not say whether its base moves, and files from CAD call no link a foot.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from embodichain.cli.new_task.tool_point import corners_of

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]

__all__ = ["Limb", "find_limbs", "find_wheels", "only_wheels"]

_HAND = re.compile(r"finger|thumb|jaw|claw|grip|knuckle", re.IGNORECASE)
"""How the links of hands are called: fingers are equal chains, too."""
_EQUAL = 0.1
"""Share by which the lengths of equal limbs differ, at most."""
_HANGING = -0.3
"""Largest z component of the mean direction of limbs on which a robot stands."""
_SPREAD = 0.5
"""Length of the mean direction below which limbs point away from each other, as a spider's do."""
_CENTRED = 0.25
"""Distance of a wheel's middle from its axle, as a share of its radius, at most."""
_MOST_JOINTS_OF_A_WHEEL = 2
"""A wheel that is steered."""


@dataclass(frozen=True)
class Limb:
    """A chain of hinges from the trunk.

    Attributes:
        end: Its last link.
        joints: Its hinges, from the trunk on.
    """

    end: str
    joints: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Chain:
    """A chain with its size.

    Attributes:
        limb: The chain.
        length: The way from joint to joint and to the end, m.
        base: (3,) its first joint, m.
        tip: (3,) the end of its last link, m.
    """

    limb: Limb
    length: float
    base: F64
    tip: F64


def find_limbs(model: mujoco.MjModel, data: mujoco.MjData, root: str) -> list[Limb]:
    """Find the legs of a robot: equal chains of hinges from its trunk that hang or spread.

    Fingers, arms with a gripper, and chains that are closed into loops are not legs; neither are
    two arms that end higher than another part of the robot.

    Args:
        model: The robot.
        data: A state of it.
        root: Its root link.
    """
    if model.neq and _closes_loops(model):
        return []
    chains = [chain for chain in _chains(model, data, root) if len(chain.limb.joints) >= 2]
    largest: list[_Chain] = []
    for chain in chains:
        equal = [other for other in chains if _are_equal(chain, other)]
        if len(equal) > len(largest):
            largest = equal
    if len(largest) < 2:
        return []
    directions = np.array([chain.tip - chain.base for chain in largest])
    mean = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).mean(axis=0)
    hangs = bool(mean[2] < _HANGING)
    if len(largest) == 2:
        tips = min(float(chain.tip[2]) for chain in largest)
        others = corners_of(model, data, _fixed_on(model, int(model.body(root).id)))
        if not hangs or tips > float(others[:, 2].min()):
            return []
    elif not hangs and float(np.linalg.norm(mean)) > _SPREAD:
        return []
    return [chain.limb for chain in largest]


def find_wheels(model: mujoco.MjModel, data: mujoco.MjData) -> list[str]:
    """Find the joints that turn wheels, if wheels are all that a robot has.

    A wheel turns without limits about an axis through its middle, at the end of a chain; another
    joint may steer it. A robot with an arm, or with legs that end in wheels, has none here.
    """
    import mujoco

    parents = {int(parent) for parent in model.body_parentid}
    wheels: list[str] = []
    used: set[int] = set()
    for body in range(1, model.nbody):
        if body in parents and _moves_others(model, body):
            continue
        chain = _joints_above(model, body)
        if not chain or model.body_jntnum[body] == 0:
            continue
        joint = chain[-1]
        is_turning = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        if is_turning and not model.jnt_limited[joint] and _is_centred(model, data, joint):
            hinges = [i for i in chain if model.jnt_type[i] == mujoco.mjtJoint.mjJNT_HINGE]
            if len(hinges) <= _MOST_JOINTS_OF_A_WHEEL:
                wheels.append(model.joint(joint).name)
                used.update(chain)
    movable = {i for i in range(model.njnt) if model.jnt_type[i] != mujoco.mjtJoint.mjJNT_FREE}
    if not wheels or movable - used:
        return []
    return wheels


def only_wheels(wheels: Sequence[str]) -> str:
    """Say of a robot with nothing but wheels why no task is written for it, and what there is."""
    text = f"no chain of its joints moves a tool or a leg: they turn wheels ({', '.join(wheels)})"
    return f"{text}. A task in which wheels are driven: docs/robots.md#wheels"


def _closes_loops(model: mujoco.MjModel) -> bool:
    import mujoco

    loops = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
    return any(kind in loops for kind in model.eq_type)


def _are_equal(first: _Chain, second: _Chain) -> bool:
    if len(first.limb.joints) != len(second.limb.joints):
        return False
    return abs(first.length - second.length) <= _EQUAL * max(first.length, second.length)


def _chains(model: mujoco.MjModel, data: mujoco.MjData, root: str) -> list[_Chain]:
    """The chains of hinges that begin at the trunk and do not branch."""
    trunk = _fixed_on(model, int(model.body(root).id))
    chains = []
    for body in range(1, model.nbody):
        if int(model.body_parentid[body]) in trunk and body not in trunk:
            chain = _chain_from(model, data, body)
            if chain is not None:
                chains.append(chain)
    return chains


def _chain_from(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> _Chain | None:
    """The chain that begins with a body; None if it branches, slides, or belongs to a hand."""
    import mujoco

    joints: list[int] = []
    while True:
        first = int(model.body_jntadr[body])
        here = range(first, first + int(model.body_jntnum[body]))
        if any(model.jnt_type[i] != mujoco.mjtJoint.mjJNT_HINGE for i in here):
            return None
        joints += here
        names = [model.body(body).name, *(model.joint(i).name for i in here)]
        if any(map(_HAND.search, names)):
            return None
        link = _fixed_on(model, body)
        moving = [
            child
            for child in range(body + 1, model.nbody)
            if int(model.body_parentid[child]) in link and child not in link
        ]
        if len(moving) > 1:
            return None
        if not moving:
            break
        body = moving[0]
    anchors = [data.xanchor[i].copy() for i in joints]
    points = corners_of(model, data, link)
    distances = np.linalg.norm(points - anchors[-1], axis=1)
    tip = points[distances >= 0.95 * distances.max()].mean(axis=0)
    ways = np.diff([*anchors, tip], axis=0)
    length = float(np.linalg.norm(ways, axis=1).sum())
    if length == 0.0 or not np.linalg.norm(tip - anchors[0]):
        return None
    limb = Limb(model.body(body).name, tuple(model.joint(i).name for i in joints))
    return _Chain(limb, length=length, base=anchors[0], tip=tip)


def _fixed_on(model: mujoco.MjModel, body: int) -> list[int]:
    """A body and those that do not move relative to it."""
    fixed = [body]
    for other in range(body + 1, model.nbody):
        if int(model.body_parentid[other]) in fixed and not model.body_jntnum[other]:
            fixed.append(other)
    return fixed


def _moves_others(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body carries another that moves relative to it."""
    link = _fixed_on(model, body)
    return any(
        int(model.body_parentid[other]) in link and other not in link
        for other in range(body + 1, model.nbody)
    )


def _joints_above(model: mujoco.MjModel, body: int) -> list[int]:
    """The joints between the root and a body, from the root on, without a free joint."""
    import mujoco

    joints: list[int] = []
    while body:
        first = int(model.body_jntadr[body])
        here: Sequence[int] = range(first, first + int(model.body_jntnum[body]))
        joints[:0] = [i for i in here if model.jnt_type[i] != mujoco.mjtJoint.mjJNT_FREE]
        body = int(model.body_parentid[body])
    return joints


def _is_centred(model: mujoco.MjModel, data: mujoco.MjData, joint: int) -> bool:
    """Whether what a joint turns is round about its axis, as far as a box around it tells."""
    points = corners_of(model, data, _fixed_on(model, int(model.jnt_bodyid[joint])))
    axis = data.xaxis[joint]
    across = points - data.xanchor[joint]
    across = across - np.outer(across @ axis, axis)
    radius = float(np.linalg.norm(across, axis=1).max())
    middle = float(np.linalg.norm(0.5 * (across.min(axis=0) + across.max(axis=0))))
    return radius > 0 and middle <= _CENTRED * radius

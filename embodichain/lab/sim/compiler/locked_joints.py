"""`locked_joints` of an articulation: joints that are fixed at a position.

A locked joint is no degree of freedom: physics computes fewer of them than with a stiff drive.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco

from embodichain.lab.sim.compiler.names import match
from embodichain.lab.sim.compiler.robot_files import ModelFile, compile_quietly
from embodichain.utils.errors import Problem
from embodichain.utils.math import quat_multiply, quat_rotate, rotvec_to_quat

__all__ = ["lock_joints"]

_KINDS = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


def lock_joints(file: ModelFile, locked: Mapping[str, float]) -> list[Problem]:
    """Remove joints of a URDF, whose links get the poses that they have at given positions.

    `file.spec` and `file.model` change; with a mistake they do not.

    Args:
        file: The robot's file.
        locked: Joint regex -> position, rad or m.

    Returns:
        Every mistake, with paths that begin with ``locked_joints``.
    """
    if not locked:
        return []
    if not file.is_urdf:
        message = "joints of an MJCF cannot be locked: remove them from the file"
        return [Problem("locked_joints", message)]
    model = file.model
    names = [model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] in _KINDS]
    mimics = {name for eq in file.spec.equalities for name in (eq.name1, eq.name2) if name}
    positions: dict[str, float] = {}
    problems: list[Problem] = []
    for pattern, position in locked.items():
        path = f"locked_joints.{pattern}"
        found, wrong = match(pattern, names, "joint", path)
        problems += wrong
        for name in (names[i] for i in found):
            if name in positions:
                problems.append(Problem(path, f"another entry matches joint {name!r} too"))
            if name in mimics:
                problems.append(Problem(path, f"joint {name!r} follows or leads another (mimic)"))
            positions[name] = position
            low, high = model.joint(name).range
            if model.joint(name).limited[0] and not low <= position <= high:
                message = f"{position:g} is outside the limits of joint {name!r}"
                problems.append(Problem(path, f"{message}, [{low:g}, {high:g}]"))
    if problems:
        return problems
    for name, position in positions.items():
        _lock(file, name, position)
    file.model = compile_quietly(file.spec)
    return []


def _lock(file: ModelFile, name: str, position: float) -> None:
    """Remove a joint; a URDF's has its origin in that of its link."""
    joint = file.model.joint(name)
    link = file.model.body(int(joint.bodyid[0]))
    pos, quat = link.pos.copy(), link.quat.copy()
    if joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE:
        pos += quat_rotate(quat, joint.axis * position)
    else:
        quat = quat_multiply(quat, rotvec_to_quat(joint.axis * position))
    body = file.spec.body(link.name)
    body.pos, body.quat = pos, quat
    file.spec.delete(file.spec.joint(name))

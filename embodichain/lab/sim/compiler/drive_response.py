"""How fast drives are, for `show`: the top speed that their effort allows, the time constant."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.articulation import ParsedArticulation
from embodichain.lab.sim.compiler.index import F64

__all__ = ["joint_inertia", "time_constants", "top_speeds"]

_HINGE_RANGE, _SLIDE_RANGE = 2 * math.pi, 1.0
"""Distance that counts for a joint without limits, rad and m."""


def joint_inertia(parsed: ParsedArticulation) -> F64:
    """(D,) diagonal of the joint-space inertia at the initial positions, armature included."""
    model, data = parsed.model, mujoco.MjData(parsed.model)
    joints = [model.joint(name) for name in parsed.joint_names]
    data.qpos[[joint.qposadr[0] for joint in joints]] = parsed.init_qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_makeM(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    dofs = [joint.dofadr[0] for joint in joints]
    found: F64 = inertia[dofs, dofs]
    return found


def top_speeds(parsed: ParsedArticulation) -> F64:
    """(D,) largest speed in a move through the joint's range, rad/s or m/s; NaN without a drive.

    The smallest of three bounds: accelerating over half the range at effort / inertia, so that
    v^2 = effort x range / inertia; effort / passive damping; and stiffness x range / damping, where
    spring and damper balance. Other joints, gravity and dry friction are left out.
    """
    hinges = np.array([int(parsed.model.joint(n).type[0]) for n in parsed.joint_names])
    endless = np.where(hinges == int(mujoco.mjtJoint.mjJNT_HINGE), _HINGE_RANGE, _SLIDE_RANGE)
    width = np.diff(parsed.qpos_limits, axis=1)[:, 0]
    width = np.where(np.isfinite(width), width, endless)
    effort = parsed.max_effort
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = (
            np.sqrt(effort * width / joint_inertia(parsed)),
            effort / parsed.joint_damping,
            np.where(parsed.stiffness > 0, parsed.stiffness * width / parsed.damping, np.inf),
        )
    return np.where(_driven(parsed), np.fmin.reduce(bounds), np.nan)


def time_constants(parsed: ParsedArticulation) -> F64:
    """(D,) seconds, within the effort limit; NaN without a drive.

    That of the slowest root of I x'' + damping x' + stiffness x = 0; damping is the drive's and the
    joint's.
    """
    inertia, stiffness = joint_inertia(parsed), parsed.stiffness
    damping = parsed.damping + parsed.joint_damping
    root = np.sqrt(np.maximum(damping**2 - 4 * inertia * stiffness, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.where(
            stiffness > 0,
            np.where(root > 0, (damping + root) / (2 * stiffness), 2 * inertia / damping),
            inertia / damping,
        )
    return np.where(_driven(parsed), found, np.nan)


def _driven(parsed: ParsedArticulation) -> F64:
    driven: F64 = np.array([bool(name) for name in parsed.drives], np.bool_)
    return driven

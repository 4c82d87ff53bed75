"""Descriptions of actuators and drives for `show`: kinds, top speeds, time constants."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.robot.drives.pd_drives import inertia_matrix
from embodichain.lab.sim.compiler.robot.files.robot_joints import gear_of
from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation

__all__ = [
    "ActuatorDescription",
    "describe_actuators",
    "joint_inertia",
    "time_constants",
    "top_speeds",
]


@dataclass(frozen=True)
class ActuatorDescription:
    """One actuator, in words and numbers.

    Attributes:
        name: Its name in the model.
        kind: ``position``, ``velocity``, ``motor``, ``damper``, ``muscle``, ``general``...; with
            a prefix such as ``filter`` if it has an activation state.
        target: The object it acts on: ``joint arm/elbow``, ``tendon hand/split``...
        gear: First number of its gear.
        gain: Force per unit of control (or of activation).
        stiffness: kp, its force per unit of length.
        damping: kv, its force per unit of velocity.
        ctrlrange: Range of every control; None where not limited.
        forcerange: Range of its force; None if not limited.
    """

    name: str
    kind: str
    target: str
    gear: float
    gain: float
    stiffness: float
    damping: float
    ctrlrange: tuple[tuple[float, float] | None, ...]
    forcerange: tuple[float, float] | None


def describe_actuators(model: mujoco.MjModel) -> tuple[ActuatorDescription, ...]:
    """Describe every actuator of a model."""
    return tuple(_describe(model, i) for i in range(model.nactuator))


def _describe(model: mujoco.MjModel, i: int) -> ActuatorDescription:
    controls = range(
        model.actuator_ctrladr[i], model.actuator_ctrladr[i] + model.actuator_ctrlnum[i]
    )
    affine = int(model.actuator_biastype[i]) == mujoco.mjtBias.mjBIAS_AFFINE
    low, high = model.actuator_forcerange[i]
    return ActuatorDescription(
        name=model.actuator(i).name,
        kind=_kind(model, i),
        target=_target(model, i),
        gear=gear_of(model, i),
        gain=float(model.actuator_gainprm[i, 0]),
        stiffness=-float(model.actuator_biasprm[i, 1]) + 0.0 if affine else 0.0,
        damping=-float(model.actuator_biasprm[i, 2]) + 0.0 if affine else 0.0,
        ctrlrange=tuple(
            (float(model.actuator_ctrlrange[k, 0]), float(model.actuator_ctrlrange[k, 1]))
            if model.actuator_ctrllimited[k]
            else None
            for k in controls
        ),
        forcerange=(float(low), float(high)) if model.actuator_forcelimited[i] else None,
    )


def _kind(model: mujoco.MjModel, i: int) -> str:
    gaintype, biastype = int(model.actuator_gaintype[i]), int(model.actuator_biastype[i])
    dynamics = _word(mujoco.mjtDyn, int(model.actuator_dyntype[i]), "mjDYN_")
    affine, no_bias = (
        biastype == mujoco.mjtBias.mjBIAS_AFFINE,
        biastype == mujoco.mjtBias.mjBIAS_NONE,
    )
    if gaintype == mujoco.mjtGain.mjGAIN_FIXED and (affine or no_bias):
        _, kp, kv = -model.actuator_biasprm[i, :3] if affine else np.zeros(3)
        kind = "position" if kp > 0 else "velocity" if kv > 0 else "motor"
        if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_BODY:
            kind = "adhesion"
    else:
        kind = _word(mujoco.mjtGain, gaintype, "mjGAIN_")
        kind = "damper" if kind == "affine" and no_bias else kind
    return kind if dynamics in ("none", kind) else f"{dynamics} {kind}"


def _word(enum: type, value: int, prefix: str) -> str:
    return str(enum(value).name).removeprefix(prefix).lower()


def _target(model: mujoco.MjModel, i: int) -> str:
    kind = mujoco.mjtTrn(int(model.actuator_trntype[i]))
    target = int(model.actuator_trnid[i, 0])
    named = {
        mujoco.mjtTrn.mjTRN_JOINT: ("joint", model.joint),
        mujoco.mjtTrn.mjTRN_JOINTINPARENT: ("joint", model.joint),
        mujoco.mjtTrn.mjTRN_TENDON: ("tendon", model.tendon),
        mujoco.mjtTrn.mjTRN_SITE: ("site", model.site),
        mujoco.mjtTrn.mjTRN_SLIDERCRANK: ("crank site", model.site),
        mujoco.mjtTrn.mjTRN_BODY: ("body", model.body),
    }.get(kind)
    if named is None:
        # SO3 acts on a ball joint, or on a site with a reference site.
        on_site = int(model.actuator_trnid[i, 1]) >= 0
        named = ("site", model.site) if on_site else ("ball joint", model.joint)
    what, element = named
    return f"{what} {element(target).name}"


_HINGE_RANGE, _SLIDE_RANGE = 2 * math.pi, 1.0
"""Assumed range of a joint without limits, rad and m."""


def joint_inertia(parsed: ParsedArticulation) -> F64:
    """(D,) diagonal of the joint-space inertia at the initial positions, armature included."""
    joints = [parsed.model.joint(name) for name in parsed.joint_names]
    data = mujoco.MjData(parsed.model)
    data.qpos[[joint.qposadr[0] for joint in joints]] = parsed.init_qpos
    dofs = [joint.dofadr[0] for joint in joints]
    return inertia_matrix(parsed.model, data)[dofs, dofs]


def top_speeds(parsed: ParsedArticulation) -> F64:
    """(D,) top speed in a move through the joint's range, rad/s or m/s; NaN without a drive.

    The smallest of three bounds: accelerating over half the range at effort / inertia, so that
    v^2 = effort x range / inertia; effort / passive damping; and stiffness x range / damping, where
    spring and damper balance. Other joints, gravity and dry friction are ignored.
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
    """(D,) time constants in seconds, within the effort limit; NaN without a drive.

    They belong to the slowest root of I x'' + damping x' + stiffness x = 0, where damping is the
    sum of the drive's and the joint's.
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


def _driven(parsed: ParsedArticulation) -> NDArray[np.bool_]:
    return np.array([bool(name) for name in parsed.drives], np.bool_)

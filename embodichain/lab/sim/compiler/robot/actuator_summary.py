"""Descriptions of actuators and drives for `show`: kinds, top speeds, time constants."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.robot.drives.chatter import inertia_matrix
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
    is_affine = int(model.actuator_biastype[i]) == mujoco.mjtBias.mjBIAS_AFFINE
    first_control = int(model.actuator_ctrladr[i])
    ctrlrange: list[tuple[float, float] | None] = []
    for k in range(first_control, first_control + int(model.actuator_ctrlnum[i])):
        is_limited = bool(model.actuator_ctrllimited[k])
        ctrlrange.append(_bounds(model.actuator_ctrlrange[k]) if is_limited else None)
    forcerange = None
    if model.actuator_forcelimited[i]:
        forcerange = _bounds(model.actuator_forcerange[i])
    return ActuatorDescription(
        name=model.actuator(i).name,
        kind=_kind(model, i),
        target=_target(model, i),
        gear=gear_of(model, i),
        gain=float(model.actuator_gainprm[i, 0]),
        # Plus zero, so that no gain is printed as -0.
        stiffness=-float(model.actuator_biasprm[i, 1]) + 0.0 if is_affine else 0.0,
        damping=-float(model.actuator_biasprm[i, 2]) + 0.0 if is_affine else 0.0,
        ctrlrange=tuple(ctrlrange),
        forcerange=forcerange,
    )


def _bounds(limits: F64) -> tuple[float, float]:
    return float(limits[0]), float(limits[1])


def _kind(model: mujoco.MjModel, i: int) -> str:
    """Return the kind of an actuator, see `ActuatorDescription.kind`."""
    dynamics = _word(mujoco.mjtDyn, int(model.actuator_dyntype[i]), "mjDYN_")
    kind = _kind_of_force(model, i)
    if dynamics in ("none", kind):
        return kind
    return f"{dynamics} {kind}"


def _kind_of_force(model: mujoco.MjModel, i: int) -> str:
    """Return the kind of an actuator by its gain and bias alone."""
    gain_type = int(model.actuator_gaintype[i])
    bias_type = int(model.actuator_biastype[i])
    is_affine = bias_type == mujoco.mjtBias.mjBIAS_AFFINE
    has_no_bias = bias_type == mujoco.mjtBias.mjBIAS_NONE
    if gain_type != mujoco.mjtGain.mjGAIN_FIXED or not (is_affine or has_no_bias):
        word = _word(mujoco.mjtGain, gain_type, "mjGAIN_")
        return "damper" if word == "affine" and has_no_bias else word
    if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_BODY:
        return "adhesion"
    if is_affine and model.actuator_biasprm[i, 1] < 0:
        return "position"
    if is_affine and model.actuator_biasprm[i, 2] < 0:
        return "velocity"
    return "motor"


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


_HINGE_RANGE = 2 * math.pi
_SLIDE_RANGE = 1.0
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
    joint_types = np.array([int(parsed.model.joint(n).type[0]) for n in parsed.joint_names])
    is_hinge = joint_types == int(mujoco.mjtJoint.mjJNT_HINGE)
    width = np.diff(parsed.qpos_limits, axis=1)[:, 0]
    width = np.where(np.isfinite(width), width, np.where(is_hinge, _HINGE_RANGE, _SLIDE_RANGE))
    effort = parsed.max_effort
    with np.errstate(divide="ignore", invalid="ignore"):
        accelerated = np.sqrt(effort * width / joint_inertia(parsed))
        damped = effort / parsed.joint_damping
        pulled = parsed.stiffness * width / parsed.damping
    pulled = np.where(parsed.stiffness > 0, pulled, np.inf)
    speeds = np.fmin.reduce((accelerated, damped, pulled))
    return np.where(_has_drive(parsed), speeds, np.nan)


def time_constants(parsed: ParsedArticulation) -> F64:
    """(D,) time constants in seconds, within the effort limit; NaN without a drive.

    They belong to the slowest root of I x'' + damping x' + stiffness x = 0, where damping is the
    sum of the drive's and the joint's.
    """
    inertia = joint_inertia(parsed)
    stiffness = parsed.stiffness
    damping = parsed.damping + parsed.joint_damping
    root = np.sqrt(np.maximum(damping**2 - 4 * inertia * stiffness, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        overdamped = (damping + root) / (2 * stiffness)
        oscillating = 2 * inertia / damping
        without_spring = inertia / damping
    with_spring = np.where(root > 0, overdamped, oscillating)
    seconds = np.where(stiffness > 0, with_spring, without_spring)
    return np.where(_has_drive(parsed), seconds, np.nan)


def _has_drive(parsed: ParsedArticulation) -> NDArray[np.bool_]:
    return np.array([bool(name) for name in parsed.drives], np.bool_)

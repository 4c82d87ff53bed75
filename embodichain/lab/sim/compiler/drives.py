"""PD drives: which gain belongs to which joint, and the actuator that carries them.

Spring and damper are both in the actuator, so that the effort limit bounds the whole drive, as in
PhysX, Isaac Lab and mjlab. Damping and friction that a file gives a joint stay in the joint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.cfg import JointDrivePropertiesCfg
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import match
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = [
    "NO_EFFORT_LIMIT",
    "DriveGains",
    "FileJoints",
    "apply_drives",
    "control_gain",
    "resolve_drives",
]

NO_EFFORT_LIMIT = 1e9
"""Efforts at least this large count as unlimited (EmbodiChain's default is 1e10)."""


@dataclass(frozen=True, eq=False)
class FileJoints:
    """What a file says of its D joints. Arrays are (D,), `qpos_limits` (D, 2); inf: no limit."""

    names: tuple[str, ...]
    qpos_limits: F64
    qvel_limits: F64
    qf_limits: F64
    damping: F64
    friction: F64
    armature: F64
    inertia: F64
    """Joint-space inertia at qpos0 (`dof_M0`), kg m^2 or kg."""


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Resolved drives of D joints, each (D,): what the model gets. Effort inf: no limit.

    A joint without a drive has stiffness 0, its own damping and the file's effort limit.
    """

    stiffness: F64
    damping: F64
    max_effort: F64
    max_velocity: F64
    friction: F64
    armature: F64
    driven: NDArray[np.bool_]
    armature_given: NDArray[np.bool_]
    """Joints whose armature the config gives."""


def resolve_drives(
    cfg: JointDrivePropertiesCfg,
    joints: FileJoints,
    parts: Mapping[str, Sequence[int]],
    mimic: Sequence[int],
) -> tuple[DriveGains, list[Problem]]:
    """Return one value of each property per joint, and every mistake in the config.

    A map's keys are joint regexes or control-part names; parts are applied last. Joints that no key
    names keep the field's default. Joints that mimic another one have no drive of their own: they
    keep the file's damping. So does everything with ``drive_type: none``. A `friction` of 0 (the
    default) keeps the file's; a map with 0 clears it. ``acceleration`` multiplies both gains by the
    joint's inertia at qpos0.

    Args:
        cfg: The drives' config.
        joints: What the file says.
        parts: Control parts and their joints.
        mimic: Joints that mimic another one.
    """
    problems: list[Problem] = []

    def value(name: str, default: F64) -> F64:
        return _per_joint(name, getattr(cfg, name), default, joints.names, parts, problems)

    count = len(joints.names)
    stiffness = value("stiffness", np.full(count, 1e4))
    damping = value("damping", np.full(count, 1e3))
    if cfg.max_velocity == "file":
        velocity = np.minimum(joints.qvel_limits, 1e10)
    elif cfg.max_velocity is None:
        velocity = np.full(count, 1e10)
    else:
        velocity = value("max_velocity", np.full(count, 1e10))
    if not (velocity > 0).all():
        message = "must be positive; null is no limit"
        problems.append(Problem("max_velocity", message))
    if cfg.max_effort == "file":
        effort = joints.qf_limits.copy()
    else:
        effort = value("max_effort", np.full(count, 1e10))
    if not (effort > 0).all():
        message = "must be positive; a joint that shall not push needs stiffness 0 instead"
        problems.append(Problem("max_effort", message))
        effort = np.where(effort > 0, effort, np.inf)
    effort = np.where(effort >= NO_EFFORT_LIMIT, np.inf, effort)
    friction = joints.friction.copy()
    if isinstance(cfg.friction, Mapping) or cfg.friction != 0:
        friction = value("friction", friction)
    unknown: F64 = np.full(count, np.nan)
    armature = unknown if cfg.armature is None else value("armature", unknown)
    given = ~np.isnan(armature)
    armature = np.where(given, armature, joints.armature)
    if cfg.drive_type == "acceleration":
        stiffness, damping = stiffness * joints.inertia, damping * joints.inertia
    undriven = np.zeros(count, np.bool_)
    undriven[list(mimic)] = True
    if cfg.drive_type == "none":
        undriven[:] = True
    stiffness = np.where(undriven, 0.0, stiffness)
    damping = np.where(undriven, joints.damping, damping)
    effort = np.where(undriven, joints.qf_limits, effort)
    gains = DriveGains(stiffness, damping, effort, velocity, friction, armature, ~undriven, given)
    return gains, problems


def _per_joint(
    key: str,
    value: Any,
    default: F64,
    names: Sequence[str],
    parts: Mapping[str, Sequence[int]],
    problems: list[Problem],
) -> F64:
    """Spread a number or a map over the joints; appends to `problems`."""
    out = default.copy()
    if not isinstance(value, Mapping):
        number = _number(value, key, problems)
        return out if number is None else np.full_like(out, number)
    for name, entry in sorted(value.items(), key=lambda item: item[0] in parts):
        path = f"{key}.{name}"
        if name in parts:
            ids: Sequence[int] = parts[name]
        else:
            ids, wrong = match(name, names, "joint", path)
            if wrong and parts:
                message = f"{wrong[0].message}; control parts: {listing(parts, name)}"
                hint = wrong[0].hint or did_you_mean(name, parts).strip()
                wrong = [Problem(path, message, hint)]
            problems += wrong
        number = _number(entry, path, problems)
        if number is not None:
            out[list(ids)] = number
    return out


def _number(value: Any, path: str, problems: list[Problem]) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError):
        problems.append(Problem(path, f"wants a number, got {value!r}"))
        return None
    if not number >= 0.0:
        problems.append(Problem(path, f"must not be negative, got {number}"))
        return None
    return number


def apply_drives(
    spec: mujoco.MjSpec,
    cfg: JointDrivePropertiesCfg,
    gains: DriveGains,
    names: Sequence[str],
    mimic: Sequence[int],
) -> None:
    """Write gains into a spec: joints, and one actuator named like its joint for every drive.

    The file's own actuators go, with the sensors that read them, unless ``drive_type`` is none.
    """
    for i, name in enumerate(names):
        joint = spec.joint(name)
        joint.armature = float(gains.armature[i])
        joint.frictionloss = float(gains.friction[i])
    if cfg.drive_type == "none":
        return
    _remove_actuators(spec)
    for i, name in enumerate(names):
        joint = spec.joint(name)
        # Efforts are limited in the drive, where set_joint_drive can change them per environment.
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.actfrcrange = [0.0, 0.0]
        if i in mimic:
            continue
        _add_drive(
            spec,
            name,
            float(gains.stiffness[i]),
            float(gains.damping[i]),
            float(gains.max_effort[i]),
        )


def control_gain(stiffness: F64, damping: F64) -> F64:
    """What a drive multiplies its control by: the damping where there is no stiffness.

    The control is then a velocity target, else a position target; see `objects.drives`.
    """
    return np.where(stiffness > 0, stiffness, damping)


def _add_drive(
    spec: mujoco.MjSpec, joint: str, stiffness: float, damping: float, effort: float
) -> None:
    """Force = stiffness x (ctrl - q) - damping x v, clamped to +-effort.

    Without stiffness damping x (ctrl - v): MuJoCo's velocity actuator.
    """
    actuator = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.gainprm[0] = stiffness if stiffness > 0 else damping
    actuator.biasprm[1] = -stiffness
    actuator.biasprm[2] = -damping
    actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
    limited = bool(np.isfinite(effort))
    actuator.forcelimited = (
        mujoco.mjtLimited.mjLIMITED_TRUE if limited else mujoco.mjtLimited.mjLIMITED_FALSE
    )
    if limited:
        actuator.forcerange = [-effort, effort]


def _remove_actuators(spec: mujoco.MjSpec) -> None:
    gone = {actuator.name for actuator in spec.actuators}
    for sensor in list(spec.sensors):
        if sensor.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR and sensor.objname in gone:
            spec.delete(sensor)
    for actuator in list(spec.actuators):
        spec.delete(actuator)

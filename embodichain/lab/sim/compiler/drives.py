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

from embodichain.lab.sim.compiler.actuators import JOINT_TRANSMISSIONS, Servos
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import match
from embodichain.lab.sim.drive_cfg import NO_LIMIT, FileFirst, JointDrivePropertiesCfg
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = [
    "DriveGains",
    "FileJoints",
    "Mask",
    "apply_drives",
    "resolve_drives",
]

Mask = NDArray[np.bool_]


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
    servos: Servos | None = None
    """What actuators of the file do; None where a file can have none (URDF)."""


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Resolved drives of D joints, each (D,): what the model gets. Effort inf: no limit.

    Where `driven` is False there is no drive of ours: gains are those of the file's servo, if there
    is one, and its effort limit is `max_effort` where `relimited`.
    """

    stiffness: F64
    damping: F64
    max_effort: F64
    max_velocity: F64
    friction: F64
    armature: F64
    driven: Mask
    armature_given: Mask
    """Joints whose armature the config gives."""
    relimited: Mask


def resolve_drives(
    cfg: JointDrivePropertiesCfg,
    joints: FileJoints,
    parts: Mapping[str, Sequence[int]],
    mimic: Sequence[int],
) -> tuple[DriveGains, list[Problem]]:
    """Return one value of each property per joint, and every mistake in the config.

    A map's keys are joint regexes or control-part names; parts are applied last. Joints that mimic
    another one have no drive of their own. A `friction` of 0 (the default) keeps the file's; a map
    with 0 clears it. ``acceleration`` multiplies both gains by the joint's inertia at qpos0.

    In a URDF every other joint has a drive, with the fields' defaults where no key names it. In an
    MJCF those have one that `stiffness` or `damping` names (a number names what the file's
    actuators act on, or all joints if it has none); what is not given is the file's own servo's,
    else the fields' default.
    Without a drive (`drive_type: none` included) joints keep the file's damping and actuators.

    Args:
        cfg: The drives' config.
        joints: What the file says.
        parts: Control parts and their joints.
        mimic: Joints that mimic another one.
    """
    problems: list[Problem] = []
    count, servos = len(joints.names), joints.servos
    no_joint = np.zeros(count, np.bool_)

    def value(name: str, default: F64) -> tuple[F64, Mask]:
        """The values, and which joints were given one."""
        wanted = getattr(cfg, name)
        if wanted == "file" or (servos is not None and isinstance(wanted, FileFirst)):
            return default.copy(), no_joint
        found = _per_joint(name, wanted, np.full(count, np.nan), joints.names, parts, problems)
        given = ~np.isnan(found)
        return np.where(given, found, default), given

    stiffness, stiff = value("stiffness", _first(servos, "stiffness", np.full(count, 1e4)))
    damping, damped = value("damping", _first(servos, "damping", np.full(count, 1e3)))
    velocity = np.full(count, 1e10)
    if cfg.max_velocity == "file":
        velocity = np.minimum(joints.qvel_limits, 1e10)
    elif cfg.max_velocity is not None:
        velocity, _ = value("max_velocity", velocity)
    if not (velocity > 0).all():
        message = "must be positive; null is no limit"
        problems.append(Problem("max_velocity", message))
    files = servos is not None or cfg.max_effort == "file"
    effort, limited = value("max_effort", joints.qf_limits if files else np.full(count, 1e10))
    friction = joints.friction.copy()
    if isinstance(cfg.friction, Mapping) or cfg.friction != 0:
        friction, _ = value("friction", friction)
    armature, armed = joints.armature.copy(), no_joint
    if cfg.armature is not None:
        armature, armed = value("armature", armature)
    if not (effort > 0).all():
        message = "must be positive; a joint that shall not push needs stiffness 0 instead"
        problems.append(Problem("max_effort", message))
        effort = np.where(effort > 0, effort, np.inf)
    effort = np.where(effort >= NO_LIMIT, np.inf, effort)
    driven = np.ones(count, np.bool_)
    relimited = no_joint.copy()
    if servos is None:
        problems += [
            Problem(name, "a URDF holds no gains: give numbers")
            for name in ("stiffness", "damping")
            if getattr(cfg, name) == "file"
        ]
    else:
        driven, wrong = _named(cfg, servos, stiff, damped)
        problems += wrong
        relimited = limited & ~driven & (servos.drive >= 0)
        idle = limited & ~driven & ~relimited
        if isinstance(cfg.max_effort, Mapping) and idle.any():
            names = ", ".join(joints.names[i] for i in np.flatnonzero(idle))
            message = f"joints without a drive or servo: {names}; give stiffness or damping"
            problems.append(Problem("max_effort", message))
    driven[list(mimic)] = False
    if cfg.drive_type == "none":
        driven[:] = relimited[:] = False
    if cfg.drive_type == "acceleration":
        stiffness = np.where(stiff | (servos is None), stiffness * joints.inertia, stiffness)
        damping = np.where(damped | (servos is None), damping * joints.inertia, damping)
    # Without a drive: the file's servo, or the joint itself.
    own = np.zeros(count), joints.damping, joints.qf_limits
    if servos is not None:
        servo = servos.drive >= 0
        own = (
            servos.stiffness,
            np.where(servo, servos.damping, joints.damping),
            np.where(servo, servos.max_effort, joints.qf_limits),
        )
    stiffness = np.where(driven, stiffness, own[0])
    damping = np.where(driven, damping, own[1])
    effort = np.where(driven | relimited, effort, own[2])
    gains = DriveGains(
        stiffness, damping, effort, velocity, friction, armature, driven, armed, relimited
    )
    return gains, problems


def _first(servos: Servos | None, name: str, default: F64) -> F64:
    """What the file's position servos say, where there are any."""
    if servos is None:
        return default
    return np.where(servos.stiffness > 0, getattr(servos, name), default)


def _named(
    cfg: JointDrivePropertiesCfg, servos: Servos, stiff: Mask, damped: Mask
) -> tuple[Mask, list[Problem]]:
    """Return which joints of an MJCF the gains name."""
    driven = np.zeros(len(stiff), np.bool_)
    problems: list[Problem] = []
    for name, given in (("stiffness", stiff), ("damping", damped)):
        if isinstance(getattr(cfg, name), Mapping):
            driven |= given
        elif given.any():
            driven |= servos.actuated | (servos.count == 0)
            if not driven.any() and cfg.drive_type != "none":
                message = (
                    "one number is for the joints that the file's actuators act on, and these act "
                    f"on tendons or sites only: name joints, as in {{'.*': {getattr(cfg, name):g}}}"
                )
                problems.append(Problem(name, message))
    return driven, problems


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
    spec: mujoco.MjSpec, gains: DriveGains, joints: FileJoints
) -> tuple[tuple[str, ...], list[str]]:
    """Write gains into a spec: joints, and one actuator for every drive, named like its joint.

    Actuators of the file on joints that get a drive go, with the sensors that read them.

    Returns:
        The name of each joint's drive, empty where it has none, and what a user should be told.
    """
    names, servos = joints.names, joints.servos
    for i, name in enumerate(names):
        joint = spec.joint(name)
        joint.armature = float(gains.armature[i])
        joint.frictionloss = float(gains.friction[i])
    notes: list[str] = []
    if servos is not None and gains.relimited.any():
        own = list(spec.actuators)
        changed = np.flatnonzero(gains.relimited)
        servo_of = {int(row): own[servos.drive[row]] for row in changed}
        for row, servo in servo_of.items():
            _limit(servo, float(gains.max_effort[row] / abs(servos.gear[row])))
        limited = ", ".join(repr(servo.name) for servo in servo_of.values())
        notes.append(f"max_effort (drive_pros) replaces the force limits of {limited}")
    driven = [name for i, name in enumerate(names) if gains.driven[i]]
    if servos is not None and not driven and not servos.count:
        notes.append("no joint is driven: it has no actuators, and drive_pros names no joint")
    notes += _remove_actuators(spec, driven)
    taken = {actuator.name for actuator in spec.actuators}
    drives = [""] * len(names)
    for i, name in enumerate(names):
        if not gains.driven[i]:
            continue
        joint = spec.joint(name)
        # Efforts are limited in the drive, where set_joint_drive can change them per environment.
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.actfrcrange = [0.0, 0.0]
        drives[i] = name if name not in taken else f"{name}_drive"
        _add_drive(
            spec,
            drives[i],
            name,
            float(gains.stiffness[i]),
            float(gains.damping[i]),
            float(gains.max_effort[i]),
        )
    return tuple(drives), notes


def _add_drive(
    spec: mujoco.MjSpec, name: str, joint: str, stiffness: float, damping: float, effort: float
) -> None:
    """Force = stiffness x (ctrl - q) - damping x v, clamped to +-effort.

    Without stiffness damping x (ctrl - v): MuJoCo's velocity actuator.
    """
    actuator = spec.add_actuator(name=name, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.gainprm[0] = stiffness if stiffness > 0 else damping
    actuator.biasprm[1] = -stiffness
    actuator.biasprm[2] = -damping
    actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
    _limit(actuator, effort)


def _limit(actuator: mujoco.MjsActuator, effort: float) -> None:
    """Clamp an actuator's force to +-effort; inf is no limit."""
    limited = bool(np.isfinite(effort))
    actuator.forcelimited = (
        mujoco.mjtLimited.mjLIMITED_TRUE if limited else mujoco.mjtLimited.mjLIMITED_FALSE
    )
    if limited:
        actuator.forcerange = [-effort, effort]


def _remove_actuators(spec: mujoco.MjSpec, joints: Sequence[str]) -> list[str]:
    """Take out the actuators on joints, and the sensors that read them; say so."""
    gone = {
        actuator.name: actuator.target
        for actuator in spec.actuators
        if int(actuator.trntype) in JOINT_TRANSMISSIONS and actuator.target in joints
    }
    deaf = [
        sensor
        for sensor in spec.sensors
        if sensor.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR and sensor.objname in gone
    ]
    notes: list[str] = []
    if gone:
        pairs = ", ".join(f"{name!r} on {joint!r}" for name, joint in gone.items())
        notes.append(f"drives (drive_pros) replace its actuators: {pairs}")
    if deaf:
        lost = ", ".join(repr(sensor.name) for sensor in deaf)
        notes.append(f"sensors of replaced actuators left out: {lost}")
    for sensor in deaf:
        spec.delete(sensor)
    for actuator in list(spec.actuators):
        if actuator.name in gone:
            spec.delete(actuator)
    return notes

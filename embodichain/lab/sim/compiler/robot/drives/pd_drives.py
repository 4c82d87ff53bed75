"""PD drives: the gains of each joint, and their actuators.

Spring and damper are both in the actuator, so that the effort limit bounds the whole drive, as in
PhysX, Isaac Lab and mjlab. Joints keep the damping and friction of their file.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64, Mask
from embodichain.lab.sim.compiler.names import match
from embodichain.lab.sim.compiler.robot.files.joint_couplings import JointCoupling
from embodichain.lab.sim.compiler.robot.files.robot_joints import (
    JOINT_TRANSMISSIONS,
    FileJoint,
    FileJoints,
)
from embodichain.lab.sim.configs.drive_cfg import NO_LIMIT, JointDrivePropertiesCfg
from embodichain.utils.errors import Problem
from embodichain.utils.fields.defaults import is_given
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["DriveGains", "JointDrive", "apply_drives", "resolve_drives"]

Parts = Mapping[str, Sequence[int]]  # control part -> joint indices

DEFAULT_STIFFNESS = 1e4
DEFAULT_DAMPING = 1e3
"""Gains of a drive for which neither the config nor the file has a number, as in EmbodiChain."""
DEFAULT_MAX_EFFORT = 1e10
NO_VELOCITY_LIMIT = 1e10
"""Also EmbodiChain's: larger than any joint's, `NO_LIMIT` included."""


@dataclass(frozen=True)
class JointDrive:
    """How one joint is driven. SI units; an effort of inf means no limit.

    Attributes:
        joint: The joint, as its file has it.
        is_added: Whether `drive_pros` adds a PD drive, in place of the file's actuators on it.
            Else `stiffness` and `damping` are those of the file's servo, if there is one.
        is_named: Whether maps of `drive_pros` name the joint in both gains.
        limits_servo: Whether `max_effort` replaces the limit of the file's servo.
        stiffness: N m/rad or N/m.
        damping: N m s/rad or N s/m.
        max_effort: N m or N.
        max_velocity: rad/s or m/s.
        friction: N m or N.
        armature: kg m^2 or kg.
        is_armature_given: Whether the config gives the armature.
    """

    joint: FileJoint
    is_added: bool
    is_named: bool
    limits_servo: bool
    stiffness: float
    damping: float
    max_effort: float
    max_velocity: float
    friction: float
    armature: float
    is_armature_given: bool


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Drives of D joints as arrays, each (D,), for what computes with matrices; see `JointDrive`.

    `driven` marks the joints to which `drive_pros` adds a drive.
    """

    stiffness: F64
    damping: F64
    max_effort: F64
    max_velocity: F64
    friction: F64
    armature: F64
    driven: Mask
    armature_given: Mask

    @staticmethod
    def from_drives(drives: Sequence[JointDrive]) -> DriveGains:
        """Return the columns of D drives."""
        return DriveGains(
            stiffness=np.array([drive.stiffness for drive in drives], np.float64),
            damping=np.array([drive.damping for drive in drives], np.float64),
            max_effort=np.array([drive.max_effort for drive in drives], np.float64),
            max_velocity=np.array([drive.max_velocity for drive in drives], np.float64),
            friction=np.array([drive.friction for drive in drives], np.float64),
            armature=np.array([drive.armature for drive in drives], np.float64),
            driven=np.array([drive.is_added for drive in drives], np.bool_),
            armature_given=np.array([drive.is_armature_given for drive in drives], np.bool_),
        )


# ------------------------------------------------------------------------------ config to drives

_Overrides = Mapping[str, Mapping[str, float]]
"""Joint -> property -> the number that the config gives, or the field's default of a URDF's joint:
{"elbow": {"stiffness": 500.0}}."""
_PROPERTIES = ("stiffness", "damping", "max_velocity", "max_effort", "friction", "armature")


def resolve_drives(
    cfg: JointDrivePropertiesCfg,
    joints: FileJoints,
    parts: Parts,
    mimics: Sequence[JointCoupling] = (),
) -> tuple[list[JointDrive], list[Problem]]:
    """Return the drive of each joint, and every mistake in the config.

    Args:
        cfg: The robot's `drive_pros`. A map's keys are joint regexes or names of control parts;
            parts are applied last.
        joints: The joints of the robot's files.
        parts: Control part -> joint indices.
        mimics: Joints that follow others: they have no drive.
    """
    overrides, problems = _read_overrides(cfg, joints, parts)
    selected, selection_problems = _select_joints(cfg, joints, overrides)
    followers = {mimic.joint for mimic in mimics}
    drives = [
        _resolve_drive(
            cfg,
            joint,
            overrides[joint.name],
            is_selected=joint.name in selected,
            is_follower=index in followers,
        )
        for index, joint in enumerate(joints.rows)
    ]
    problems += _check_velocities(cfg, joints, overrides)
    problems += _check_efforts(cfg, joints, overrides)
    if any(joint.is_urdf for joint in joints.rows):
        for name in ("stiffness", "damping"):
            if getattr(cfg, name) == "file":
                problems.append(Problem(name, "a URDF has no gains: give numbers"))
    problems += selection_problems
    problems += _check_limited_joints(cfg, joints, overrides, selected)
    return drives, problems


def _resolve_drive(
    cfg: JointDrivePropertiesCfg,
    joint: FileJoint,
    override: Mapping[str, float],
    is_selected: bool,
    is_follower: bool,
) -> JointDrive:
    """Decide for one joint; what the config does not give is the file's, else a default.

    Args:
        cfg: The robot's `drive_pros`.
        joint: The joint.
        override: What the config gives for it.
        is_selected: Whether it is a URDF's, or the gains select it.
        is_follower: Whether it mimics another one.
    """
    servo = joint.servo
    is_added = is_selected and not is_follower and cfg.drive_type != "none"
    is_named = all(
        isinstance(getattr(cfg, gain), Mapping) and gain in override
        for gain in ("stiffness", "damping")
    )
    limits_servo = (
        "max_effort" in override
        and servo is not None
        and not is_selected
        and cfg.drive_type != "none"
    )

    max_velocity = NO_VELOCITY_LIMIT
    if cfg.max_velocity == "file":
        max_velocity = min(joint.max_velocity, NO_VELOCITY_LIMIT)
    max_velocity = override.get("max_velocity", max_velocity)

    max_effort = _effort(cfg, joint, override)
    if not 0 < max_effort < NO_LIMIT:
        max_effort = math.inf
    if not is_added and not limits_servo:
        max_effort = joint.max_effort if servo is None else servo.max_effort

    stiffness, damping = _gains(cfg, joint, override)
    if not is_added:
        stiffness = 0.0 if servo is None else servo.stiffness
        damping = joint.damping if servo is None else servo.damping

    return JointDrive(
        joint=joint,
        is_added=is_added,
        is_named=is_named,
        limits_servo=limits_servo,
        stiffness=stiffness,
        damping=damping,
        max_effort=max_effort,
        max_velocity=max_velocity,
        friction=override.get("friction", joint.friction),
        armature=override.get("armature", joint.armature),
        is_armature_given="armature" in override,
    )


def _gains(
    cfg: JointDrivePropertiesCfg, joint: FileJoint, override: Mapping[str, float]
) -> tuple[float, float]:
    """Return the stiffness and damping of an added drive.

    Without a number they are those of the file's position servo, else EmbodiChain's defaults.
    """
    stiffness = DEFAULT_STIFFNESS
    damping = DEFAULT_DAMPING
    if joint.servo is not None and joint.servo.stiffness > 0:
        stiffness = joint.servo.stiffness
        damping = joint.servo.damping
    stiffness = override.get("stiffness", stiffness)
    damping = override.get("damping", damping)
    if cfg.drive_type == "acceleration":
        # The config's numbers are per unit of inertia at qpos0; a servo's are forces already.
        if "stiffness" in override or joint.is_urdf:
            stiffness *= joint.inertia
        if "damping" in override or joint.is_urdf:
            damping *= joint.inertia
    return stiffness, damping


def _effort(cfg: JointDrivePropertiesCfg, joint: FileJoint, override: Mapping[str, float]) -> float:
    """Return the effort limit that the config gives a joint, else the file's if it counts."""
    if "max_effort" in override:
        return override["max_effort"]
    if not joint.is_urdf or cfg.max_effort == "file":
        return joint.max_effort
    return DEFAULT_MAX_EFFORT


def _select_joints(
    cfg: JointDrivePropertiesCfg, joints: FileJoints, overrides: _Overrides
) -> tuple[set[str], list[Problem]]:
    """Return the joints whose own actuators a drive replaces, and mistakes.

    In a URDF every joint has a drive. In an MJCF, a map of gains selects the joints that it names;
    a number selects the joints that the file's actuators act on, or all if it has no actuator.
    Numbers do not concern joints of attached MJCF files.
    """
    selected = {joint.name for joint in joints.rows if joint.is_urdf}
    selected_of_mjcf: set[str] = set()
    problems: list[Problem] = []
    for name in ("stiffness", "damping"):
        value = getattr(cfg, name)
        if isinstance(value, Mapping):
            selected_of_mjcf |= {joint for joint in overrides if name in overrides[joint]}
            continue
        own_joints = [
            joint for joint in joints.rows if not joint.is_urdf and not joint.is_attached_mjcf
        ]
        if not any(name in overrides[joint.name] for joint in own_joints):
            continue
        for joint in own_joints:
            if joint.servos.is_actuated or joints.own_actuators == 0:
                selected_of_mjcf.add(joint.name)
        if not selected_of_mjcf and cfg.drive_type != "none":
            message = (
                "one number is for the joints that the file's actuators act on, and these act "
                f"on tendons or sites only: name joints, as in {{'.*': {value:g}}}"
            )
            problems.append(Problem(name, message))
    return selected | selected_of_mjcf, problems


def _check_velocities(
    cfg: JointDrivePropertiesCfg, joints: FileJoints, overrides: _Overrides
) -> list[Problem]:
    """Return mistakes of `max_velocity`: a joint that could never move."""
    if any(override.get("max_velocity") == 0 for override in overrides.values()):
        return [Problem("max_velocity", "must be positive; null means no limit")]
    return []


def _check_efforts(
    cfg: JointDrivePropertiesCfg, joints: FileJoints, overrides: _Overrides
) -> list[Problem]:
    """Return mistakes of `max_effort`: a drive that could not push."""
    if all(_effort(cfg, joint, overrides[joint.name]) > 0 for joint in joints.rows):
        return []
    message = "must be positive; a joint that shall not push needs stiffness 0 instead"
    return [Problem("max_effort", message)]


def _check_limited_joints(
    cfg: JointDrivePropertiesCfg,
    joints: FileJoints,
    overrides: _Overrides,
    selected: set[str],
) -> list[Problem]:
    """Return a mistake if `max_effort` names joints that have nothing to limit."""
    idle = [
        joint.name
        for joint in joints.rows
        if "max_effort" in overrides[joint.name]
        and joint.name not in selected
        and joint.servo is None
    ]
    if not isinstance(cfg.max_effort, Mapping) or not idle:
        return []
    message = f"joints without a drive or servo: {', '.join(idle)}; give stiffness or damping"
    return [Problem("max_effort", message)]


def _read_overrides(
    cfg: JointDrivePropertiesCfg, joints: FileJoints, parts: Parts
) -> tuple[dict[str, dict[str, float]], list[Problem]]:
    """Return what the config says of each joint, and every mistake; see `_Overrides`."""
    overrides: dict[str, dict[str, float]] = {joint.name: {} for joint in joints.rows}
    problems: list[Problem] = []
    for name in _PROPERTIES:
        value = getattr(cfg, name)
        if value is None or value == "file":
            continue
        if name == "friction" and not is_given(value):  # the file's stays, in a URDF too
            continue
        if isinstance(value, Mapping):
            numbers, mistakes = _read_map(name, value, joints.names, parts)
            problems += mistakes
        else:
            numbers = _read_single(value, joints)
        for joint, number in numbers.items():
            overrides[joint][name] = number
    return overrides, problems


def _read_single(value: float, joints: FileJoints) -> dict[str, float]:
    """Return one number for all joints that it concerns.

    A field's default concerns joints of URDF files; a given number all but those of attached MJCFs.
    """
    if is_given(value):
        concerned = [joint.name for joint in joints.rows if not joint.is_attached_mjcf]
    else:
        concerned = [joint.name for joint in joints.rows if joint.is_urdf]
    return dict.fromkeys(concerned, float(value))


def _read_map(
    name: str, value: Mapping[str, Any], names: Sequence[str], parts: Parts
) -> tuple[dict[str, float], list[Problem]]:
    """Return joint -> number, of a map by joint regex or control part; parts are applied last."""
    numbers: dict[str, float] = {}
    problems: list[Problem] = []
    for key, entry in sorted(value.items(), key=lambda item: item[0] in parts):
        path = f"{name}.{key}"
        if key in parts:
            ids: Sequence[int] = parts[key]
        else:
            ids, mistakes = match(key, names, "joint", path)
            if mistakes and parts:
                message = f"{mistakes[0].message}; control parts: {listing(parts, key)}"
                hint = mistakes[0].hint or did_you_mean(key, parts).strip()
                mistakes = [Problem(path, message, hint)]
            problems += mistakes
        numbers |= {names[i]: float(entry) for i in ids}
    return numbers, problems


# ------------------------------------------------------------------------------- drives to a spec


def apply_drives(spec: mujoco.MjSpec, drives: Sequence[JointDrive]) -> tuple[list[str], list[str]]:
    """Write drives into a spec: joint fields, and an actuator per added drive.

    An actuator is named like its joint. The file's actuators on these joints are removed, with the
    sensors that read them.

    Returns:
        The name of each joint's added drive, empty where it has none, and messages for the user.
    """
    for drive in drives:
        joint = spec.joint(drive.joint.name)
        joint.armature = drive.armature
        joint.frictionloss = drive.friction
    notes = _limit_servos(spec, drives)
    named_joints = {drive.joint.name for drive in drives if drive.is_named}
    added_joints = [drive.joint.name for drive in drives if drive.is_added]
    notes += _remove_actuators(spec, added_joints, named_joints)
    used_names = {actuator.name for actuator in spec.actuators}
    names: list[str] = []
    for drive in drives:
        if not drive.is_added:
            names.append("")
            continue
        joint_name = drive.joint.name
        name = f"{joint_name}_drive" if joint_name in used_names else joint_name
        _add_actuator(spec, name, drive)
        names.append(name)
    return names, notes


def _limit_servos(spec: mujoco.MjSpec, drives: Sequence[JointDrive]) -> list[str]:
    """Give servos of the file the limits of the config; return a message."""
    actuators = list(spec.actuators)
    limited: list[str] = []
    for drive in drives:
        servo = drive.joint.servo
        if servo is None or not drive.limits_servo:
            continue
        actuator = actuators[servo.actuator]
        _limit_force(actuator, drive.max_effort / abs(servo.gear))
        limited.append(repr(actuator.name))
    if not limited:
        return []
    return [f"max_effort (drive_pros) replaces the force limits of {', '.join(limited)}"]


def _add_actuator(spec: mujoco.MjSpec, name: str, drive: JointDrive) -> None:
    """Add the actuator of a drive to its joint."""
    joint = spec.joint(drive.joint.name)
    # The drive limits efforts, so that set_joint_drive can change limits per environment.
    joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
    joint.actfrcrange = [0.0, 0.0]
    actuator = spec.add_actuator(name=name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    # Without stiffness the force is damping x (ctrl - v): MuJoCo's velocity actuator.
    actuator.gainprm[0] = drive.stiffness if drive.stiffness > 0 else drive.damping
    actuator.biasprm[1] = -drive.stiffness
    actuator.biasprm[2] = -drive.damping
    actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
    _limit_force(actuator, drive.max_effort)


def _limit_force(actuator: mujoco.MjsActuator, effort: float) -> None:
    """Clamp an actuator's force to +-effort; inf means no limit."""
    actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
    if math.isfinite(effort):
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = [-effort, effort]


def _remove_actuators(
    spec: mujoco.MjSpec, joints: Sequence[str], named_joints: Collection[str]
) -> list[str]:
    """Remove actuators on joints and the sensors that read them; return messages.

    Actuators of named joints are replaced as the config has it, which needs no message.
    """
    replaced = {
        actuator.name: actuator
        for actuator in spec.actuators
        if int(actuator.trntype) in JOINT_TRANSMISSIONS and actuator.target in joints
    }
    if not replaced:
        return []
    pairs = ", ".join(
        f"{name!r} on {actuator.target!r}"
        for name, actuator in replaced.items()
        if actuator.target not in named_joints
    )
    notes = [f"drives (drive_pros) replace its actuators: {pairs}"] if pairs else []
    orphaned_sensors = [
        sensor
        for sensor in spec.sensors
        if sensor.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR and sensor.objname in replaced
    ]
    if orphaned_sensors:
        names = ", ".join(repr(sensor.name) for sensor in orphaned_sensors)
        notes.append(f"sensors of replaced actuators left out: {names}")
    for element in (*orphaned_sensors, *replaced.values()):
        spec.delete(element)
    return notes

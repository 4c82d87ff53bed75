"""Where a robot starts: its file's keyframe, its config's `init_qpos`, and the first controls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64, Mask
from embodichain.lab.sim.compiler.names import match
from embodichain.lab.sim.compiler.robot.files.joint_couplings import JointCoupling
from embodichain.lab.sim.compiler.robot.files.robot_joints import (
    FILTER_DYNAMICS,
    JOINT_TRANSMISSIONS,
    FileJoints,
    Servo,
    gear_of,
    hint_at_degrees,
    movable_joints,
    read_servos,
)
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import listing

__all__ = ["Keyframe", "initial_controls", "read_keyframe", "resolve_qpos"]

_LIMIT_TOLERANCE = 1e-4
"""rad or m by which initial positions may exceed limits, for rounding in files and float32."""


# ---------------------------------------------------------------------------------------- keyframe


@dataclass(frozen=True, eq=False)
class Keyframe:
    """Values of a file's keyframe.

    Attributes:
        name: Its name; may be empty.
        qpos: (D,) positions of the movable joints.
        qvel: (D,) velocities of the movable joints.
        root: (7,) pose of the body with the free joint in the file's world, or None.
        root_qvel: (6,) its velocity: linear in world axes, angular in body axes; zeros without it.
        balls: Ball joint -> (4,) position wxyz and (3,) velocity.
        ctrl: Actuator -> its controls; empty if the keyframe gives none.
        act: Actuator -> its activations; empty if the keyframe gives none.
    """

    name: str
    qpos: F64
    qvel: F64
    root: F64 | None
    root_qvel: F64
    balls: dict[str, tuple[F64, F64]] = field(default_factory=dict)
    ctrl: dict[str, F64] = field(default_factory=dict)
    act: dict[str, F64] = field(default_factory=dict)


def read_keyframe(spec: mujoco.MjSpec, model: mujoco.MjModel) -> Keyframe | None:
    """Return the keyframe called ``home``, else the first, else None.

    Args:
        spec: The parsed file, with the values that the keyframe gives.
        model: The file's model.
    """
    if not model.nkey:
        return None
    names = [model.key(i).name for i in range(model.nkey)]
    key = names.index("home") if "home" in names else 0
    qpos = model.key_qpos[key]
    qvel = model.key_qvel[key]
    movable = movable_joints(model)
    root: F64 | None = None
    root_qvel = np.zeros(6)
    free_joints = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if len(free_joints):
        first = free_joints[0]
        root = qpos[model.jnt_qposadr[first] :][:7].copy()
        root_qvel = qvel[model.jnt_dofadr[first] :][:6].copy()
    keyframe = Keyframe(
        name=names[key],
        qpos=qpos[model.jnt_qposadr[movable]].copy(),
        qvel=qvel[model.jnt_dofadr[movable]].copy(),
        root=root,
        root_qvel=root_qvel,
    )
    for ball in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_BALL):
        position = int(model.jnt_qposadr[ball])
        velocity = int(model.jnt_dofadr[ball])
        keyframe.balls[model.joint(ball).name] = (
            qpos[position : position + 4].copy(),
            qvel[velocity : velocity + 3].copy(),
        )
    in_file = spec.keys[key]
    for actuator in range(model.nactuator):
        name = model.actuator(actuator).name
        if len(in_file.ctrl):
            keyframe.ctrl[name] = model.key_ctrl[key, _control_columns(model, actuator)].copy()
        if len(in_file.act):
            keyframe.act[name] = model.key_act[key, _activation_columns(model, actuator)].copy()
    return keyframe


def _control_columns(model: mujoco.MjModel, actuator: int) -> slice:
    start = int(model.actuator_ctrladr[actuator])
    return slice(start, start + int(model.actuator_ctrlnum[actuator]))


def _activation_columns(model: mujoco.MjModel, actuator: int) -> slice:
    start = int(model.actuator_actadr[actuator])
    return slice(start, start + int(model.actuator_actnum[actuator]))  # empty if stateless


# ---------------------------------------------------------------------------------------- controls


def initial_controls(
    model: mujoco.MjModel, is_driven: Mask, qpos: F64, keyframe: Keyframe | None
) -> tuple[F64, F64]:
    """Return the initial controls (nu,) and activations (na,) of an articulation.

    They are the keyframe's if it gives any and the config does not move the joint. Else position
    servos and drives hold their joint, filters are in steady state, and the rest is MuJoCo's
    neutral value.

    Args:
        model: The articulation, compiled alone.
        is_driven: (D,) which joints have a drive in place of the file's actuators.
        qpos: (D,) initial positions.
        keyframe: The file's, if it has one.
    """
    data = mujoco.MjData(model)
    ctrl = data.ctrl.copy()
    act = data.act.copy()
    held_joint: dict[int, tuple[int, Servo]] = {}  # actuator -> the joint whose position it holds
    for joint, servos in enumerate(read_servos(model, movable_joints(model))):
        if servos.main is not None and servos.main.stiffness > 0:
            held_joint[servos.main.actuator] = joint, servos.main
    for i in range(model.nactuator):
        name = model.actuator(i).name
        controls = _control_columns(model, i)
        activations = _activation_columns(model, i)
        ctrl_is_from_keyframe = keyframe is not None and name in keyframe.ctrl
        if i in held_joint:
            joint, servo = held_joint[i]
            if keyframe is not None and (is_driven[joint] or qpos[joint] != keyframe.qpos[joint]):
                ctrl_is_from_keyframe = False
            if not ctrl_is_from_keyframe:
                ctrl[controls] = servo.scale * qpos[joint]
                if model.actuator_ctrllimited[controls.start]:
                    limits = model.actuator_ctrlrange[controls.start]
                    ctrl[controls] = np.clip(ctrl[controls], *limits)
        if keyframe is not None and ctrl_is_from_keyframe:
            ctrl[controls] = keyframe.ctrl[name]
        dynamics = model.actuator_dyntype[i]
        if keyframe is not None and name in keyframe.act:
            act[activations] = keyframe.act[name]
        elif dynamics in FILTER_DYNAMICS:
            act[activations] = ctrl[controls]
        elif dynamics == mujoco.mjtDyn.mjDYN_INTEGRATOR:
            act[activations] = _resting_setpoint(model, i, qpos)
    return ctrl, act


def _resting_setpoint(model: mujoco.MjModel, actuator: int, qpos: F64) -> float:
    """Return the setpoint at which a joint's integrating servo has no force; 0 for others."""
    joint = np.flatnonzero(movable_joints(model) == model.actuator_trnid[actuator, 0])
    gain = float(model.actuator_gainprm[actuator, 0])
    is_on_joint = model.actuator_trntype[actuator] in JOINT_TRANSMISSIONS
    if not is_on_joint or not len(joint) or gain == 0:
        return 0.0
    bias = float(model.actuator_biasprm[actuator, 1])
    setpoint = -bias / gain * gear_of(model, actuator) * float(qpos[joint[0]])
    if model.actuator_actlimited[actuator]:
        setpoint = float(np.clip(setpoint, *model.actuator_actrange[actuator]))
    return setpoint


# --------------------------------------------------------------------------------------- positions


def resolve_qpos(
    init_qpos: Any,
    joints: FileJoints,
    mimics: Sequence[JointCoupling],
    keyframe: Keyframe | None,
    equalities: Sequence[JointCoupling] = (),
) -> tuple[F64, list[Problem]]:
    """Return initial joint positions (D,) in rad or m, and every mistake in the config.

    Joints that the config does not name take the keyframe's value, else `FileJoint.home`; mimic
    joints follow their leader. Of two joints that an equality of an MJCF couples, the one that the
    config does not name follows the one that it names.

    Args:
        init_qpos: `ArticulationCfg.init_qpos`: None, D values, or a map by joint regex.
        joints: The file's joints.
        mimics: Which of them follow others.
        keyframe: The file's keyframe, if it has one.
        equalities: Joint equalities of MJCF files.
    """
    if keyframe is None:
        qpos = np.array([joint.home for joint in joints.rows], np.float64)
    else:
        qpos = keyframe.qpos.copy()
    positions, problems = _read_positions(init_qpos, joints.names)
    is_named = np.zeros(len(qpos), np.bool_)
    for i, position in positions.items():
        qpos[i] = position
        is_named[i] = True
    for mimic in mimics:
        if not is_named[mimic.joint] and (keyframe is None or is_named[mimic.leader]):
            qpos[mimic.joint] = mimic.slope * qpos[mimic.leader] + mimic.offset
    _move_coupled_joints(equalities, is_named, qpos)
    problems += _outside_limits(qpos, is_named, joints)
    # Only the config's values are checked against limits; rounding beyond limits is clamped.
    low, high = joints.qpos_limits.T
    return np.where(is_named, np.clip(qpos, low, high), qpos), problems


def _outside_limits(qpos: F64, is_named: Mask, joints: FileJoints) -> list[Problem]:
    """Return the problem that named joints start outside their limits, one for all of them."""
    outside: list[str] = []
    hints: list[str] = []
    for i in np.flatnonzero(is_named).tolist():
        joint = joints.rows[i]
        position = float(qpos[i])
        lowest = joint.lower - _LIMIT_TOLERANCE
        highest = joint.upper + _LIMIT_TOLERANCE
        if lowest <= position <= highest:  # NaN is not
            continue
        limits = f"[{joint.lower:g}, {joint.upper:g}]"
        outside.append(f"joint {joint.name!r} starts at {position:g}, outside its limits {limits}")
        hint = hint_at_degrees(position, lowest, highest) if joint.is_hinge else ""
        if hint:
            hints.append(hint)
    if not outside:
        return []
    return [Problem("init_qpos", "; ".join(outside), hints[0] if hints else "")]


def _move_coupled_joints(equalities: Sequence[JointCoupling], is_named: Mask, qpos: F64) -> None:
    """Write the positions of joints that are coupled to named ones into `qpos`."""
    is_placed = is_named.copy()
    for _ in equalities:  # a chain may be named at any of its joints
        for equality in equalities:
            joint = equality.joint
            leader = equality.leader
            if is_placed[leader] and not is_placed[joint]:
                qpos[joint] = equality.slope * qpos[leader] + equality.offset
                is_placed[joint] = True
            elif is_placed[joint] and not is_placed[leader] and equality.slope != 0:
                qpos[leader] = (qpos[joint] - equality.offset) / equality.slope
                is_placed[leader] = True


def _read_positions(init_qpos: Any, names: Sequence[str]) -> tuple[dict[int, float], list[Problem]]:
    """Return index of a joint -> its position in the config, and mistakes."""
    if init_qpos is None:
        return {}, []
    if isinstance(init_qpos, Mapping):
        return _read_positions_by_name(init_qpos, names)
    message = f"must be {len(names)} numbers or a map by joint, got {init_qpos!r}"
    try:
        values = np.asarray(init_qpos, np.float64).reshape(-1)
    except (TypeError, ValueError):
        return {}, [Problem("init_qpos", message)]
    if len(values) != len(names):
        message = (
            f"must be {len(names)} values, one for each joint ({listing(names)}), got {len(values)}"
        )
        return {}, [Problem("init_qpos", message)]
    return dict(enumerate(values.tolist())), []


def _read_positions_by_name(
    init_qpos: Mapping[Any, Any], names: Sequence[str]
) -> tuple[dict[int, float], list[Problem]]:
    """As `_read_positions`, of a map by joint regex; a later entry replaces an earlier one."""
    positions: dict[int, float] = {}
    problems: list[Problem] = []
    for pattern, value in init_qpos.items():
        path = f"init_qpos.{pattern}"
        ids, mistakes = match(str(pattern), names, "joint", path)
        problems += mistakes
        try:
            position = float(value)
        except (TypeError, ValueError):
            problems.append(Problem(path, f"must be a number in rad or m, got {value!r}"))
            continue
        for i in ids:
            positions[i] = position
    return positions, problems

"""An articulation's initial state: the config's positions, else the file's keyframe, else zeros.

Controls and activations follow: the keyframe's, or those at which servos hold the joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.actuators import JOINT_TRANSMISSIONS, Servos
from embodichain.lab.sim.compiler.drives import FileJoints, Mask
from embodichain.lab.sim.compiler.file_joints import Mimics, movable_joints
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import match
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import listing

__all__ = ["Keyframe", "initial_controls", "read_keyframe", "resolve_qpos"]

_FREE, _BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
_FILTERS = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
_INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
_TOLERANCE = 1e-4
"""rad or m by which an initial position may pass a limit: rounding in files and float32."""


@dataclass(frozen=True, eq=False)
class Keyframe:
    """What a file's keyframe says.

    Attributes:
        name: Its name; may be empty.
        qpos: (D,) of the movable joints.
        qvel: (D,) of the movable joints.
        root: (7,) pose of the body with the free joint in the file's world, or None.
        root_qvel: (6,) its velocities: linear in world axes, angular in its own; zeros without it.
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
        spec: The file; says what the keyframe gives.
        model: The same, compiled.
    """
    if not model.nkey:
        return None
    names = [model.key(i).name for i in range(model.nkey)]
    key = names.index("home") if "home" in names else 0
    given = spec.keys[key]
    qpos, qvel = model.key_qpos[key], model.key_qvel[key]
    root, root_qvel = None, np.zeros(6)
    balls: dict[str, tuple[F64, F64]] = {}
    for joint in range(model.njnt):
        start, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        if model.jnt_type[joint] == _FREE and root is None:
            root, root_qvel = qpos[start : start + 7].copy(), qvel[dof : dof + 6].copy()
        elif model.jnt_type[joint] == _BALL:
            pose = qpos[start : start + 4].copy(), qvel[dof : dof + 3].copy()
            balls[model.joint(joint).name] = pose
    movable = movable_joints(model)
    actuators = range(model.nactuator)
    return Keyframe(
        name=names[key],
        qpos=qpos[model.jnt_qposadr[movable]].copy(),
        qvel=qvel[model.jnt_dofadr[movable]].copy(),
        root=root,
        root_qvel=root_qvel,
        balls=balls,
        ctrl={
            model.actuator(i).name: model.key_ctrl[key, _controls(model, i)].copy()
            for i in actuators
            if len(given.ctrl)
        },
        act={
            model.actuator(i).name: model.key_act[key, _activations(model, i)].copy()
            for i in actuators
            if len(given.act)
        },
    )


def _controls(model: mujoco.MjModel, actuator: int) -> slice:
    start = int(model.actuator_ctrladr[actuator])
    return slice(start, start + int(model.actuator_ctrlnum[actuator]))


def _activations(model: mujoco.MjModel, actuator: int) -> slice:
    start = int(model.actuator_actadr[actuator])
    return slice(start, start + int(model.actuator_actnum[actuator]))  # empty if stateless


def initial_controls(
    model: mujoco.MjModel, servos: Servos, driven: Mask, qpos: F64, keyframe: Keyframe | None
) -> tuple[F64, F64]:
    """Return the controls (nu,) and activations (na,) an articulation starts with.

    The keyframe's, where it gives any and the config leaves the joint there. Else position servos
    and drives hold their joint, filters have settled, and the rest is MuJoCo's neutral value.

    Args:
        model: The articulation, compiled alone.
        servos: What acts on its joints.
        driven: (D,) which joints have a drive in place of the file's actuators.
        qpos: (D,) initial positions.
        keyframe: The file's, if it has one.
    """
    data = mujoco.MjData(model)
    ctrl, act = data.ctrl.copy(), data.act.copy()
    rows = {
        int(a): row for row, a in enumerate(servos.drive) if a >= 0 and servos.stiffness[row] > 0
    }
    joints = {int(joint): row for row, joint in enumerate(movable_joints(model))}
    for i in range(model.nactuator):
        name, where, states = model.actuator(i).name, _controls(model, i), _activations(model, i)
        row = rows.get(i)
        there = keyframe is not None and name in keyframe.ctrl
        if keyframe is not None and there and row is not None:
            there = not driven[row] and qpos[row] == keyframe.qpos[row]
        if keyframe is not None and there:
            ctrl[where] = keyframe.ctrl[name]
        elif row is not None:
            ctrl[where] = servos.scale[row] * qpos[row]
            if model.actuator_ctrllimited[where.start]:
                ctrl[where] = np.clip(ctrl[where], *model.actuator_ctrlrange[where.start])
        if keyframe is not None and name in keyframe.act:
            act[states] = keyframe.act[name]
        elif model.actuator_dyntype[i] in _FILTERS:
            act[states] = ctrl[where]
        elif model.actuator_dyntype[i] == _INTEGRATOR:
            act[states] = _integrated(model, i, joints, qpos)
    return ctrl, act


def _integrated(model: mujoco.MjModel, i: int, joints: Mapping[int, int], qpos: F64) -> float:
    """Return the setpoint at which an integrating servo of a joint pulls nowhere; 0 for others."""
    row = joints.get(int(model.actuator_trnid[i, 0]))
    gain = float(model.actuator_gainprm[i, 0])
    if model.actuator_trntype[i] not in JOINT_TRANSMISSIONS or row is None or gain == 0:
        return 0.0
    gear = float(model.actuator_gear[model.actuator_outadr[i], 0])
    setpoint = -float(model.actuator_biasprm[i, 1]) / gain * gear * float(qpos[row])
    if model.actuator_actlimited[i]:
        low, high = model.actuator_actrange[i]
        setpoint = float(np.clip(setpoint, low, high))
    return setpoint


def resolve_qpos(
    value: Any, joints: FileJoints, mimics: Mimics, keyframe: Keyframe | None
) -> tuple[F64, list[Problem]]:
    """Return initial joint positions (D,) in rad or m, and every mistake in the config.

    Joints that the config does not name take the keyframe's value, else the value nearest zero
    within their limits; mimic joints follow their leader.

    Args:
        value: `ArticulationCfg.init_qpos`: None, D values, or a map by joint regex.
        joints: The file's joints.
        mimics: Which of them follow others.
        keyframe: The file's keyframe, if it has one.
    """
    low, high = joints.qpos_limits[:, 0], joints.qpos_limits[:, 1]
    qpos = (
        np.clip(np.zeros(len(joints.names)), low, high)
        if keyframe is None
        else keyframe.qpos.copy()
    )
    given = np.zeros(len(joints.names), np.bool_)
    problems: list[Problem] = []
    if isinstance(value, Mapping):
        _fill(value, joints.names, qpos, given, problems)
    elif value is not None:
        problems += _take(value, joints.names, qpos, given)
    for i, parent, slope, offset in zip(
        mimics.ids, mimics.parents, mimics.multipliers, mimics.offsets, strict=True
    ):
        if not given[i] and (keyframe is None or given[parent]):
            qpos[i] = slope * qpos[parent] + offset
    problems += _outside(qpos, given, joints)
    # Only what was given is held to the limits; rounding beyond them is taken back.
    return np.where(given, np.clip(qpos, low, high), qpos), problems


def _fill(
    value: Mapping[str, Any], names: tuple[str, ...], qpos: F64, given: Any, problems: list[Problem]
) -> None:
    for pattern, entry in value.items():
        path = f"init_qpos.{pattern}"
        ids, wrong = match(str(pattern), names, "joint", path)
        problems += wrong
        try:
            number = float(entry)
        except (TypeError, ValueError):
            problems.append(Problem(path, f"wants a number in rad or m, got {entry!r}"))
            continue
        qpos[list(ids)] = number
        given[list(ids)] = True


def _take(value: Any, names: tuple[str, ...], qpos: F64, given: Any) -> list[Problem]:
    try:
        array = np.asarray(value, np.float64).reshape(-1)
    except (TypeError, ValueError):
        return [
            Problem("init_qpos", f"wants {len(names)} numbers or a map by joint, got {value!r}")
        ]
    if len(array) != len(names):
        message = (
            f"wants {len(names)} values, one for each joint ({listing(names)}), got {len(array)}"
        )
        return [Problem("init_qpos", message)]
    qpos[:] = array
    given[:] = True
    return []


def _outside(qpos: F64, given: Any, joints: FileJoints) -> list[Problem]:
    found: list[Problem] = []
    for i in np.flatnonzero(given):
        low, high = joints.qpos_limits[i]
        if not low - _TOLERANCE <= qpos[i] <= high + _TOLERANCE:  # also catches NaN
            name, limits = joints.names[i], f"[{low:g}, {high:g}]"
            message = f"joint {name!r} starts at {qpos[i]:g}, outside its limits {limits}"
            found.append(Problem("init_qpos", message))
    return found

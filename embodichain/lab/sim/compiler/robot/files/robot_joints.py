"""Joint data of a compiled robot file: limits, mimics, servos, and the initial state.

An actuator's force is ``gain * ctrl + b0 + b1 * length + b2 * velocity`` (MuJoCo's affine force
generation); on a joint, length is ``gear * q`` and the joint's force is ``gear * force``.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64, Ids, Mask
from embodichain.lab.sim.compiler.names import match
from embodichain.lab.sim.compiler.robot.files.urdf_reading import UrdfLimits
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import listing

__all__ = [
    "JOINT_TRANSMISSIONS",
    "FileJoints",
    "Keyframe",
    "Mimics",
    "Servos",
    "control_names",
    "gear_of",
    "initial_controls",
    "movable_joints",
    "read_joints",
    "read_keyframe",
    "read_servos",
    "resolve_qpos",
]

_JOINT, _TRN, _DYN = mujoco.mjtJoint, mujoco.mjtTrn, mujoco.mjtDyn
JOINT_TRANSMISSIONS = (int(_TRN.mjTRN_JOINT), int(_TRN.mjTRN_JOINTINPARENT))
_MOVABLE = (int(_JOINT.mjJNT_HINGE), int(_JOINT.mjJNT_SLIDE))
_FILTERS = (int(_DYN.mjDYN_FILTER), int(_DYN.mjDYN_FILTEREXACT))
_TOLERANCE = 1e-4
"""rad or m by which initial positions may exceed limits, for rounding in files and float32."""


# ------------------------------------------------------------------------------------------ servos


@dataclass(frozen=True, eq=False)
class Servos:
    """Actuators that take position and velocity targets of D joints; arrays are (D,).

    A joint has a position servo if exactly one actuator without activation state acts on it with
    the force ``gain * ctrl - kp * length - kv * velocity``; a velocity servo is one with kp = 0.
    `drive` is the position servo, else the velocity servo, with the control ``scale * target``. The
    other numbers are those of `drive`, in joint units (``gear**2 * kp``).

    Attributes:
        drive: Actuator id, or -1.
        velocity: Actuator id of a velocity servo beside a position servo, or -1.
        gear: 1 without a drive.
        scale: Control per unit of target; 1 without a drive.
        velocity_scale: As `scale`, for `velocity`.
        stiffness: 0 without a position servo.
        damping: 0 without a drive.
        max_effort: inf where there is no limit.
        shares: (D, 2) fractions of `max_effort` that the force range allows down and up.
        actuated: Whether any actuator acts on the joint itself (not through a tendon).
        count: Number of actuators in the model.
    """

    drive: Ids
    velocity: Ids
    gear: F64
    scale: F64
    velocity_scale: F64
    stiffness: F64
    damping: F64
    max_effort: F64
    shares: F64
    actuated: Mask
    count: int


def read_servos(model: mujoco.MjModel, joints: Ids) -> Servos:
    """Find the servos of joints: (D,) ids of hinges and slides."""
    count = len(joints)
    found = Servos(
        drive=np.full(count, -1, np.int64),
        velocity=np.full(count, -1, np.int64),
        gear=np.ones(count),
        scale=np.ones(count),
        velocity_scale=np.ones(count),
        stiffness=np.zeros(count),
        damping=np.zeros(count),
        max_effort=np.full(count, np.inf),
        shares=np.ones((count, 2)),
        actuated=np.zeros(count, np.bool_),
        count=int(model.nactuator),
    )
    on_joint = np.isin(model.actuator_trntype, JOINT_TRANSMISSIONS)
    for row, joint in enumerate(joints):
        acting = np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == joint)).tolist()
        found.actuated[row] = len(acting) > 0
        servos: dict[str, list[int]] = {"position": [], "velocity": [], "": []}
        for actuator in acting:
            servos[_servo_kind(model, actuator)].append(actuator)
        position, velocity = servos["position"], servos["velocity"]
        if len(position) == 1:
            _set_drive(found, row, model, position[0])
            if len(velocity) == 1:
                found.velocity[row] = velocity[0]
                found.velocity_scale[row] = _scale(model, velocity[0], 2)
        elif not position and len(velocity) == 1:
            _set_drive(found, row, model, velocity[0])
    return found


def _set_drive(found: Servos, row: int, model: mujoco.MjModel, actuator: int) -> None:
    kp, kv = (-float(b) + 0.0 for b in model.actuator_biasprm[actuator, 1:3])
    gear = gear_of(model, actuator)
    found.drive[row] = actuator
    found.gear[row], found.scale[row] = gear, _scale(model, actuator, 1 if kp > 0 else 2)
    found.stiffness[row], found.damping[row] = gear**2 * kp, gear**2 * kv
    if model.actuator_forcelimited[actuator]:
        reach = np.abs(model.actuator_forcerange[actuator])
        found.max_effort[row] = abs(gear) * float(reach.max())
        found.shares[row] = reach / reach.max()


def gear_of(model: mujoco.MjModel, actuator: int) -> float:
    """First number of an actuator's gear."""
    return float(model.actuator_gear[model.actuator_outadr[actuator], 0])


def _scale(model: mujoco.MjModel, actuator: int, bias: int) -> float:
    """Control per unit of target; `bias` is the column of the actuator's feedback gain."""
    gain = float(model.actuator_gainprm[actuator, 0])
    return -gear_of(model, actuator) * float(model.actuator_biasprm[actuator, bias]) / gain


def _servo_kind(model: mujoco.MjModel, actuator: int) -> str:
    """Return ``position`` or ``velocity`` for a stateless servo, else an empty string."""
    gain, (b0, b1, b2) = model.actuator_gainprm[actuator, 0], model.actuator_biasprm[actuator, :3]
    linear = (
        model.actuator_dyntype[actuator] == _DYN.mjDYN_NONE
        and model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
        and gear_of(model, actuator) != 0
        and not model.actuator_delay[actuator]
    )
    low, high = model.actuator_forcerange[actuator]
    one_way = model.actuator_forcelimited[actuator] and not low < 0 < high
    if not linear or gain <= 0 or b0 != 0 or b2 > 0 or one_way:
        return ""
    if b1 < 0:
        return "position"
    return "velocity" if b1 == 0 and b2 < 0 else ""


def control_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the name of every control (nu,): its actuator's, with ``.INPUT`` if it has several."""
    names: list[str] = []
    for i in range(model.nactuator):
        name, inputs = model.actuator(i).name, int(model.actuator_ctrlnum[i])
        own = [mujoco.mj_actuatorInputName(model, i, k) or str(k) for k in range(inputs)]
        names += [name] if inputs == 1 else [f"{name}.{put}" for put in own]
    return tuple(names)


# ------------------------------------------------------------------------------------------ joints


@dataclass(frozen=True, eq=False)
class FileJoints:
    """Data of a file's D joints. Arrays are (D,), `qpos_limits` (D, 2); inf is no limit."""

    names: tuple[str, ...]
    qpos_limits: F64
    qvel_limits: F64
    qf_limits: F64
    damping: F64
    friction: F64
    armature: F64
    inertia: F64
    """Joint-space inertia at qpos0 (`dof_M0`), kg m^2 or kg."""
    home: F64
    """Where joints start without a keyframe, rad or m: an MJCF's `qpos0` (`ref` of a joint); for a
    URDF, the value nearest zero within the limits."""
    servos: Servos
    """Servos of the files."""
    from_urdf: Mask
    """Joints of URDF files, which have no actuators."""
    by_name: Mask
    """Joints of attached MJCF files: only names in `drive_pros` change them, no single number."""
    limits: UrdfLimits
    """Limits of URDF files beyond those that the model has."""
    own_actuators: int
    """Number of actuators of the robot's own file, without attached ones."""


@dataclass(frozen=True)
class Mimics:
    """Joints that follow another one: ``q[ids] = multipliers * q[parents] + offsets``."""

    ids: tuple[int, ...] = ()
    parents: tuple[int, ...] = ()
    multipliers: tuple[float, ...] = ()
    offsets: tuple[float, ...] = ()


def movable_joints(model: mujoco.MjModel) -> Ids:
    """Return the ids of hinge and slide joints, in qpos order, without ball and free joints."""
    return np.flatnonzero(np.isin(model.jnt_type, _MOVABLE)).astype(np.int64)


def read_joints(
    model: mujoco.MjModel,
    limits: UrdfLimits,
    urdf: Collection[str],
    attached: tuple[str, ...] = (),
) -> FileJoints:
    """Return a robot's data of its movable joints, as its files have them.

    Args:
        model: The model of the file, attached ones included.
        limits: Of URDF files, what an `MjModel` does not have.
        urdf: Names of joints from URDF files, which have no actuators.
        attached: Prefixes of the names of attached files.
    """
    ids = movable_joints(model)
    names = tuple(model.joint(i).name for i in ids)
    dofs = model.jnt_dofadr[ids]
    limited = model.jnt_limited[ids].astype(np.bool_)[:, None]
    from_urdf = np.array([name in urdf for name in names], np.bool_)
    actuators = [model.actuator(i).name for i in range(model.nactuator)]
    qpos_limits = np.where(limited, model.jnt_range[ids], [[-np.inf, np.inf]])
    qpos0 = model.qpos0[model.jnt_qposadr[ids]]
    return FileJoints(
        names=names,
        qpos_limits=qpos_limits,
        qvel_limits=np.array([limits.velocity.get(name, np.inf) for name in names], np.float64),
        qf_limits=_effort_limits(model, ids),
        damping=model.dof_damping[dofs].copy(),
        friction=model.dof_frictionloss[dofs].copy(),
        armature=model.dof_armature[dofs].copy(),
        inertia=model.dof_M0[dofs].copy(),
        home=np.where(from_urdf, np.clip(np.zeros(len(ids)), *qpos_limits.T), qpos0),
        servos=read_servos(model, ids),
        from_urdf=from_urdf,
        by_name=np.array([name.startswith(attached) for name in names], np.bool_) & ~from_urdf,
        limits=limits,
        own_actuators=sum(not name.startswith(attached) for name in actuators),
    )


def _effort_limits(model: mujoco.MjModel, ids: Ids) -> F64:
    """Return each joint's limit: its own, else that of an actuator on it, else inf."""
    limits: F64 = np.full(model.njnt, np.inf)
    for actuator in range(model.nactuator):
        joint = int(model.actuator_trnid[actuator, 0])
        if model.actuator_trntype[actuator] in JOINT_TRANSMISSIONS:
            gear = abs(gear_of(model, actuator))
            limits[joint] = min(limits[joint], gear * _actuator_limit(model, actuator))
    for joint in ids:
        if model.jnt_actfrclimited[joint]:
            limits[joint] = float(np.abs(model.jnt_actfrcrange[joint]).max())
    return limits[ids]


def _actuator_limit(model: mujoco.MjModel, actuator: int) -> float:
    """Return an actuator's largest force before its gear: forcerange, or a motor's ctrlrange."""
    control = int(model.actuator_ctrladr[actuator])
    if model.actuator_forcelimited[actuator]:
        return float(np.abs(model.actuator_forcerange[actuator]).max())
    motor = (
        model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
    )
    if motor and model.actuator_ctrllimited[control]:
        gain = abs(float(model.actuator_gainprm[actuator, 0]))
        return gain * float(np.abs(model.actuator_ctrlrange[control]).max())
    return float(np.inf)


# ----------------------------------------------------------------------------------- initial state


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
    qpos, qvel = model.key_qpos[key], model.key_qvel[key]
    movable = movable_joints(model)
    free = np.flatnonzero(model.jnt_type == _JOINT.mjJNT_FREE)
    found = Keyframe(
        name=names[key],
        qpos=qpos[model.jnt_qposadr[movable]].copy(),
        qvel=qvel[model.jnt_dofadr[movable]].copy(),
        root=qpos[model.jnt_qposadr[free[0]] :][:7].copy() if len(free) else None,
        root_qvel=qvel[model.jnt_dofadr[free[0]] :][:6].copy() if len(free) else np.zeros(6),
    )
    for joint in np.flatnonzero(model.jnt_type == _JOINT.mjJNT_BALL):
        at, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        pose = qpos[at : at + 4].copy(), qvel[dof : dof + 3].copy()
        found.balls[model.joint(joint).name] = pose
    given = spec.keys[key]
    for i in range(model.nactuator):
        name = model.actuator(i).name
        if len(given.ctrl):
            found.ctrl[name] = model.key_ctrl[key, _controls(model, i)].copy()
        if len(given.act):
            found.act[name] = model.key_act[key, _activations(model, i)].copy()
    return found


def _controls(model: mujoco.MjModel, actuator: int) -> slice:
    start = int(model.actuator_ctrladr[actuator])
    return slice(start, start + int(model.actuator_ctrlnum[actuator]))


def _activations(model: mujoco.MjModel, actuator: int) -> slice:
    start = int(model.actuator_actadr[actuator])
    return slice(start, start + int(model.actuator_actnum[actuator]))  # empty if stateless


def initial_controls(
    model: mujoco.MjModel, servos: Servos, driven: Mask, qpos: F64, keyframe: Keyframe | None
) -> tuple[F64, F64]:
    """Return the initial controls (nu,) and activations (na,) of an articulation.

    They are the keyframe's if it gives any and the config does not move the joint. Else position
    servos and drives hold their joint, filters are in steady state, and the rest is MuJoCo's
    neutral value.

    Args:
        model: The articulation, compiled alone.
        servos: Servos of its joints.
        driven: (D,) which joints have a drive in place of the file's actuators.
        qpos: (D,) initial positions.
        keyframe: The file's, if it has one.
    """
    data = mujoco.MjData(model)
    ctrl, act = data.ctrl.copy(), data.act.copy()
    rows = {
        int(a): row for row, a in enumerate(servos.drive) if a >= 0 and servos.stiffness[row] > 0
    }
    key_ctrl = {} if keyframe is None else keyframe.ctrl
    key_act = {} if keyframe is None else keyframe.act
    for i in range(model.nactuator):
        name, at, states = model.actuator(i).name, _controls(model, i), _activations(model, i)
        row = rows.get(i)
        moved = (
            keyframe is not None
            and row is not None
            and (driven[row] or qpos[row] != keyframe.qpos[row])
        )
        if name in key_ctrl and not moved:
            ctrl[at] = key_ctrl[name]
        elif row is not None:
            ctrl[at] = servos.scale[row] * qpos[row]
            if model.actuator_ctrllimited[at.start]:
                ctrl[at] = np.clip(ctrl[at], *model.actuator_ctrlrange[at.start])
        if name in key_act:
            act[states] = key_act[name]
        elif model.actuator_dyntype[i] in _FILTERS:
            act[states] = ctrl[at]
        elif model.actuator_dyntype[i] == _DYN.mjDYN_INTEGRATOR:
            act[states] = _integrated(model, i, qpos)
    return ctrl, act


def _integrated(model: mujoco.MjModel, i: int, qpos: F64) -> float:
    """Return the setpoint at which a joint's integrating servo has no force; 0 for others."""
    row = np.flatnonzero(movable_joints(model) == model.actuator_trnid[i, 0])
    gain = float(model.actuator_gainprm[i, 0])
    if model.actuator_trntype[i] not in JOINT_TRANSMISSIONS or not len(row) or gain == 0:
        return 0.0
    bias = float(model.actuator_biasprm[i, 1])
    setpoint = -bias / gain * gear_of(model, i) * float(qpos[row[0]])
    if model.actuator_actlimited[i]:
        setpoint = float(np.clip(setpoint, *model.actuator_actrange[i]))
    return setpoint


def resolve_qpos(
    value: Any,
    joints: FileJoints,
    mimics: Mimics,
    keyframe: Keyframe | None,
    equalities: Mimics | None = None,
) -> tuple[F64, list[Problem]]:
    """Return initial joint positions (D,) in rad or m, and every mistake in the config.

    Joints that the config does not name take the keyframe's value, else `FileJoints.home`; mimic
    joints follow their leader. Of two joints that an equality of an MJCF couples, the one that the
    config does not name follows the one that it names.

    Args:
        value: `ArticulationCfg.init_qpos`: None, D values, or a map by joint regex.
        joints: The file's joints.
        mimics: Which of them follow others.
        keyframe: The file's keyframe, if it has one.
        equalities: Joint equalities of MJCF files.
    """
    low, high = joints.qpos_limits.T
    qpos = (joints.home if keyframe is None else keyframe.qpos).copy()
    named, problems = _take_qpos(value, joints.names, qpos)
    for i, parent, slope, offset in zip(
        mimics.ids, mimics.parents, mimics.multipliers, mimics.offsets, strict=True
    ):
        if not named[i] and (keyframe is None or named[parent]):
            qpos[i] = slope * qpos[parent] + offset
    _follow(equalities or Mimics(), named, qpos)
    within = (qpos >= low - _TOLERANCE) & (qpos <= high + _TOLERANCE)  # NaN is not
    problems += [
        Problem(
            "init_qpos",
            f"joint {joints.names[i]!r} starts at {qpos[i]:g}, outside its limits "
            f"[{low[i]:g}, {high[i]:g}]",
        )
        for i in np.flatnonzero(named & ~within)
    ]
    # Only given values are checked against limits; rounding beyond limits is clamped.
    return np.where(named, np.clip(qpos, low, high), qpos), problems


def _follow(equalities: Mimics, named: Mask, qpos: F64) -> None:
    """Write the positions of joints that are coupled to named ones into `qpos`."""
    known = named.copy()
    rows = [
        *zip(
            equalities.ids,
            equalities.parents,
            equalities.multipliers,
            equalities.offsets,
            strict=True,
        )
    ]
    for _ in rows:  # a chain may be given from any of its joints
        for i, other, slope, offset in rows:
            if known[other] and not known[i]:
                qpos[i], known[i] = slope * qpos[other] + offset, True
            elif known[i] and not known[other] and slope != 0:
                qpos[other], known[other] = (qpos[i] - offset) / slope, True


def _take_qpos(value: Any, names: tuple[str, ...], qpos: F64) -> tuple[Mask, list[Problem]]:
    """Write a config's values into `qpos`; return a mask of the joints, and mistakes."""
    named = np.zeros(len(names), np.bool_)
    problems: list[Problem] = []
    if isinstance(value, Mapping):
        for pattern, entry in value.items():
            path = f"init_qpos.{pattern}"
            ids, wrong = match(str(pattern), names, "joint", path)
            problems += wrong
            try:
                qpos[list(ids)] = float(entry)
            except (TypeError, ValueError):
                problems.append(Problem(path, f"must be a number in rad or m, got {entry!r}"))
                continue
            named[list(ids)] = True
    elif value is not None:
        message = f"must be {len(names)} numbers or a map by joint, got {value!r}"
        try:
            array = np.asarray(value, np.float64).reshape(-1)
            if len(array) == len(names):
                qpos[:], named[:] = array, True
                return named, []
            each = f"one for each joint ({listing(names)})"
            message = f"must be {len(names)} values, {each}, got {len(array)}"
        except (TypeError, ValueError):
            pass  # not an array of numbers: reported below
        problems.append(Problem("init_qpos", message))
    return named, problems

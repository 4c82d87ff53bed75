"""PD drives: the gains of each joint, their actuators, and chatter.

Spring and damper are both in the actuator, so that the effort limit bounds the whole drive, as in
PhysX, Isaac Lab and mjlab. Joints keep the damping and friction of their file.

A drive's force is ``clip(kp (target - q) - kd v, -limit, limit)``. MuJoCo integrates its damper
implicitly, but not where the force is clipped: there a step changes the velocity by ``h M^-1 f``.
A clipped force that reverses it in one step is clipped in the next as well: the joint chatters.

For one joint the condition follows from the cycle of two steps, q = target -+ h v / 2 at +-v with
v = h limit / 2 M: its force is clipped, so that the cycle persists, exactly if
M < h kd / 2 + h^2 kp / 4. Several joints chatter together where the matrix
M(q) - diag(h kd / 2 + h^2 kp / 4) is not positive semidefinite. Passive damping and dry friction
only reduce chatter.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import SimulationManagerCfg
from embodichain.lab.sim.compiler.index import F64, Ids, Mask
from embodichain.lab.sim.compiler.names import match
from embodichain.lab.sim.compiler.robot.files.robot_joints import JOINT_TRANSMISSIONS, FileJoints
from embodichain.lab.sim.configs.drive_cfg import NO_LIMIT, JointDrivePropertiesCfg
from embodichain.utils.errors import Problem
from embodichain.utils.fields.defaults import is_given
from embodichain.utils.random import RandomStreams
from embodichain.utils.suggest import did_you_mean, listing

__all__ = [
    "DriveChange",
    "DriveGains",
    "DriveOperation",
    "PhysicsStep",
    "apply_drives",
    "drawn_joints",
    "inertia_matrix",
    "physics_step",
    "quiet_armature",
    "resolve_drives",
    "round_up",
]

Parts = Mapping[str, Sequence[int]]  # control part -> joint indices
DriveOperation = Literal["abs", "scale", "add"]


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Drive parameters of D joints for the model, each (D,). An effort of inf is no limit.

    Where `driven` is False, `drive_pros` adds no drive: gains are those of the file's servo, if
    there is one, with the effort limit `max_effort` where `relimited`. `armature_given` marks the
    joints for which the config gives the armature.
    """

    stiffness: F64
    damping: F64
    max_effort: F64
    max_velocity: F64
    friction: F64
    armature: F64
    driven: Mask
    armature_given: Mask
    relimited: Mask


def resolve_drives(
    cfg: JointDrivePropertiesCfg, joints: FileJoints, parts: Parts, mimic: Sequence[int]
) -> tuple[DriveGains, list[Problem]]:
    """Return one value of each property per joint, and every mistake in the config.

    A map's keys are joint regexes or control-part names; parts are applied last. Mimic joints have
    no drive. A `friction` that is not given keeps the file's.
    ``acceleration`` multiplies both gains by the joint's inertia at qpos0.

    In a URDF every other joint has a drive, with the fields' defaults where no key names it. In an
    MJCF, joints that `stiffness` or `damping` names have one (a number names the joints that the
    file's actuators act on, or all if it has none); values that are not given are those of the
    file's servo, else the fields' defaults. Numbers do not concern joints of attached MJCF files.
    Without a drive (`drive_type: none` included) joints keep the file's damping and actuators.
    """
    problems: list[Problem] = []
    count, servos, urdf = len(joints.names), joints.servos, joints.from_urdf
    no_joint = np.zeros(count, np.bool_)

    def value(name: str, default: F64) -> tuple[F64, Mask]:
        """Values, and a mask of the joints that were given one."""
        wanted = getattr(cfg, name)
        if wanted == "file":
            return default.copy(), no_joint
        found = _per_joint(name, wanted, joints.names, parts, problems)
        given = ~np.isnan(found)
        if not is_given(wanted):
            given &= urdf
        elif not isinstance(wanted, Mapping):
            given &= ~joints.by_name
        return np.where(given, found, default), given

    def servo(name: str, default: float) -> F64:
        """Values of the file's position servos, or a default."""
        return np.where(servos.stiffness > 0, getattr(servos, name), default)

    stiffness, stiff = value("stiffness", servo("stiffness", 1e4))
    damping, damped = value("damping", servo("damping", 1e3))
    velocity = np.full(count, 1e10)
    if cfg.max_velocity == "file":
        velocity = np.minimum(joints.qvel_limits, 1e10)
    elif cfg.max_velocity is not None:
        velocity, _ = value("max_velocity", velocity)
    still = joints.limits.zero_velocity if cfg.max_velocity == "file" else {}
    for name in (name for name in joints.names if name in still):
        message = (
            f'{still[name]}: joint {name!r} has velocity="0": it could never move. Write its speed '
            "into the file, or a map (joint: rad/s or m/s) or null (no limit) here"
        )
        problems.append(Problem("max_velocity", message))
    if not (velocity > 0).all() and not still:
        problems.append(Problem("max_velocity", "must be positive; null is no limit"))
    files = ~urdf | (cfg.max_effort == "file")
    effort, limited = value("max_effort", np.where(files, joints.qf_limits, 1e10))
    friction = joints.friction.copy()
    if is_given(cfg.friction):
        friction, _ = value("friction", friction)
    armature, armed = joints.armature.copy(), no_joint
    if cfg.armature is not None:
        armature, armed = value("armature", armature)
    if not (effort > 0).all():
        message = "must be positive; a joint that shall not push needs stiffness 0 instead"
        problems.append(Problem("max_effort", message))
    effort = np.where((effort > 0) & (effort < NO_LIMIT), effort, np.inf)
    if urdf.any():
        problems += [
            Problem(name, "a URDF has no gains: give numbers")
            for name in ("stiffness", "damping")
            if getattr(cfg, name) == "file"
        ]
    served = servos.drive >= 0
    driven, wrong = _named(cfg, joints, stiff, damped)
    problems += wrong
    driven |= urdf
    relimited = limited & ~driven & served
    idle = limited & ~driven & ~relimited
    if isinstance(cfg.max_effort, Mapping) and idle.any():
        names = ", ".join(joints.names[i] for i in np.flatnonzero(idle))
        message = f"joints without a drive or servo: {names}; give stiffness or damping"
        problems.append(Problem("max_effort", message))
    driven[list(mimic)] = False
    if cfg.drive_type == "none":
        driven[:] = relimited[:] = False
    if cfg.drive_type == "acceleration":
        stiffness = np.where(stiff | urdf, stiffness * joints.inertia, stiffness)
        damping = np.where(damped | urdf, damping * joints.inertia, damping)
    own_damping = np.where(served, servos.damping, joints.damping)
    own_effort = np.where(served, servos.max_effort, joints.qf_limits)
    gains = DriveGains(
        stiffness=np.where(driven, stiffness, servos.stiffness),
        damping=np.where(driven, damping, own_damping),
        max_effort=np.where(driven | relimited, effort, own_effort),
        max_velocity=velocity,
        friction=friction,
        armature=armature,
        driven=driven,
        armature_given=armed,
        relimited=relimited,
    )
    return gains, problems


def _named(
    cfg: JointDrivePropertiesCfg, joints: FileJoints, stiff: Mask, damped: Mask
) -> tuple[Mask, list[Problem]]:
    """Return which joints of MJCF files the gains name."""
    own = ~(joints.from_urdf | joints.by_name)
    driven = np.zeros(len(stiff), np.bool_)
    problems: list[Problem] = []
    for name, given in (("stiffness", stiff), ("damping", damped)):
        if isinstance(getattr(cfg, name), Mapping):
            driven |= given
        elif (given & own).any():
            driven |= own & (joints.servos.actuated | (joints.own_actuators == 0))
            if not driven.any() and cfg.drive_type != "none":
                message = (
                    "one number is for the joints that the file's actuators act on, and these act "
                    f"on tendons or sites only: name joints, as in {{'.*': {getattr(cfg, name):g}}}"
                )
                problems.append(Problem(name, message))
    return driven, problems


def _per_joint(
    key: str, value: Any, names: Sequence[str], parts: Parts, problems: list[Problem]
) -> F64:
    """Return (D,) values of a number or a map, NaN if not given; appends to `problems`."""
    if not isinstance(value, Mapping):
        return np.full(len(names), _number(value, key, problems))
    out = np.full(len(names), np.nan)
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
        if not math.isnan(number):
            out[list(ids)] = number
    return out


def _number(value: Any, path: str, problems: list[Problem]) -> float:
    """Return a non-negative number; else NaN, and append a problem."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        problems.append(Problem(path, f"must be a number, got {value!r}"))
        return math.nan
    if number >= 0.0:
        return number
    problems.append(Problem(path, f"must not be negative, got {number}"))
    return math.nan


def apply_drives(
    spec: mujoco.MjSpec, gains: DriveGains, joints: FileJoints
) -> tuple[tuple[str, ...], list[str]]:
    """Write gains into a spec: joint fields, and an actuator per drive, named like its joint.

    The file's actuators on these joints are removed, with the sensors that read them.

    Returns:
        The name of each joint's drive, empty where it has none, and messages for the user.
    """
    names, servos = joints.names, joints.servos
    for i, name in enumerate(names):
        joint = spec.joint(name)
        joint.armature = float(gains.armature[i])
        joint.frictionloss = float(gains.friction[i])
    notes, limited = [], []
    driven = [name for i, name in enumerate(names) if gains.driven[i]]
    own = list(spec.actuators)
    for i in np.flatnonzero(gains.relimited).tolist():
        servo = own[servos.drive[i]]
        _limit(servo, float(gains.max_effort[i] / abs(servos.gear[i])))
        limited.append(repr(servo.name))
    if limited:
        notes.append(f"max_effort (drive_pros) replaces the force limits of {', '.join(limited)}")
    notes += _remove_actuators(spec, driven)
    taken = {actuator.name for actuator in spec.actuators}
    drives = [""] * len(names)
    for i in np.flatnonzero(gains.driven).tolist():
        name = names[i]
        joint = spec.joint(name)
        # The drive limits efforts, so that set_joint_drive can change limits per environment.
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.actfrcrange = [0.0, 0.0]
        drives[i] = name if name not in taken else f"{name}_drive"
        # Without stiffness the force is damping x (ctrl - v): MuJoCo's velocity actuator.
        stiffness, damping = float(gains.stiffness[i]), float(gains.damping[i])
        drive = spec.add_actuator(name=drives[i], target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        drive.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        drive.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        drive.gainprm[0] = stiffness if stiffness > 0 else damping
        drive.biasprm[1:3] = -stiffness, -damping
        drive.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
        _limit(drive, float(gains.max_effort[i]))
    return tuple(drives), notes


def _limit(actuator: mujoco.MjsActuator, effort: float) -> None:
    """Clamp an actuator's force to +-effort; inf is no limit."""
    actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
    if math.isfinite(effort):
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = [-effort, effort]


def _remove_actuators(spec: mujoco.MjSpec, joints: Sequence[str]) -> list[str]:
    """Remove actuators on joints and the sensors that read them; return messages."""
    gone = {
        actuator.name: actuator
        for actuator in spec.actuators
        if int(actuator.trntype) in JOINT_TRANSMISSIONS and actuator.target in joints
    }
    if not gone:
        return []
    pairs = ", ".join(f"{name!r} on {actuator.target!r}" for name, actuator in gone.items())
    notes = [f"drives (drive_pros) replace its actuators: {pairs}"]
    deaf = [
        sensor
        for sensor in spec.sensors
        if sensor.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR and sensor.objname in gone
    ]
    lost = ", ".join(repr(sensor.name) for sensor in deaf)
    if lost:
        notes.append(f"sensors of replaced actuators left out: {lost}")
    for element in (*deaf, *gone.values()):
        spec.delete(element)
    return notes


# ----------------------------------------------------------------------------------------- chatter

_POSTURES = 256
_TOLERANCE = 1e-3  # relative; smaller needs are ignored
_ROUNDS = 64  # arms take three to five, a humanoid of 32 limited joints nine


@dataclass(frozen=True)
class PhysicsStep:
    """Time step in seconds and integrator, on which chatter depends."""

    dt: float = 0.01
    integrator: str = "implicitfast"


def physics_step(cfg: SimulationManagerCfg) -> PhysicsStep:
    """Return the time step and integrator of a simulation."""
    return PhysicsStep(float(cfg.physics_dt), cfg.physics_config.integrator)


@dataclass(frozen=True)
class DriveChange:
    """Values that an event may draw for the drives or links of one articulation.

    Attributes:
        quantity: The drawn quantity; ``strength`` multiplies gains and limit, ``com`` moves the
            centre of mass.
        names: Regexes or control parts that pick joints (links for ``mass`` and ``com``); None
            picks all.
        ranges: (low, high) for all picked ones, or by regex; without a meaning for ``com``.
        operation: ``abs`` replaces the compiled value, ``scale`` and ``add`` change it.
    """

    quantity: Literal["stiffness", "damping", "max_effort", "strength", "armature", "mass", "com"]
    names: tuple[str, ...] | None
    ranges: tuple[float, float] | Mapping[str, tuple[float, float]]
    operation: DriveOperation = "abs"

    def bounds(
        self, quantity: str, names: Sequence[str], parts: Parts
    ) -> dict[int, tuple[float, float]]:
        """Picked index in `names` -> (low, high); empty for another quantity."""
        if quantity != self.quantity:
            return {}
        picked: list[int] = list(range(len(names))) if self.names is None else []
        for pattern in self.names or ():
            hits = [i for i, name in enumerate(names) if re.fullmatch(pattern, name)]
            picked += parts.get(pattern, hits)
        if not isinstance(self.ranges, Mapping):
            return dict.fromkeys(picked, self.ranges)
        return {
            i: bounds
            for pattern, bounds in self.ranges.items()
            for i in picked
            if re.fullmatch(pattern, names[i])
        }

    def apply(self, default: float, value: float) -> float:
        """Return the result of drawing `value` for a compiled value."""
        return {"abs": value, "scale": default * value, "add": default + value}[self.operation]


def quiet_armature(
    model: mujoco.MjModel,
    names: Sequence[str],
    gains: DriveGains,
    home: F64,
    parts: Parts,
    step: PhysicsStep,
    changes: Sequence[DriveChange] = (),
    rigid: Mask | None = None,
) -> F64:
    """Return the armature (D,) that each joint lacks to avoid chatter, rounded up to two digits.

    The joint-space inertia is computed at `home`, at qpos0 and at 256 fixed postures within the
    limits (within [-pi, pi] without limits). The floating base and undriven joints move freely.

    Args:
        model: The articulation alone, with its current armature.
        names: Its D hinges and slides.
        gains: Their drives.
        home: (D,) initial positions.
        parts: See `DriveChange.names`.
        step: Time step and integrator. With Euler and RK4, which take the damper explicitly, drives
            without a limit count too.
        changes: Values that events may draw; the largest gains and the smallest mass count.
        rigid: (D,) drives that count without a limit too, see `couplings`.
    """
    dofs = np.array([model.joint(name).dofadr[0] for name in names], np.int64)
    links = [model.body(i).name for i in range(1, model.nbody)]

    def extreme(quantity: str, default: F64, pick: Callable[..., float]) -> F64:
        """The largest or smallest of the values that events may draw and the default."""
        found, of = default.copy(), (links, {}) if quantity == "mass" else (names, parts)
        for change in changes:
            for i, bounds in change.bounds(quantity, *of).items():
                values = [change.apply(float(default[i]), bound) for bound in bounds]
                found[i] = pick(float(found[i]), *values)
        return found

    strength = extreme("strength", np.ones(len(dofs)), max)
    kp = extreme("stiffness", np.where(gains.driven, gains.stiffness, 0.0), max) * strength
    kd = extreme("damping", np.where(gains.driven, gains.damping, 0.0), max) * strength
    explicit = step.integrator not in ("implicitfast", "implicit")
    limited = explicit | np.isfinite(extreme("max_effort", gains.max_effort, min))
    limited = limited if rigid is None else limited | rigid
    need = np.where(limited, 0.5 * step.dt * kd + 0.25 * step.dt**2 * kp, 0.0)
    lacking = np.zeros(len(dofs))
    joints = np.flatnonzero(need > 0)
    if not len(joints):
        return lacking
    armature = model.dof_armature
    least = armature.copy()
    least[dofs] = extreme("armature", armature[dofs], min)
    # The matrix is a sum over links: scaling it by the smallest mass factor gives a lower bound.
    mass = model.body_mass[1:]
    heavy = mass > 0
    factors = extreme("mass", mass, min)[heavy] / mass[heavy]
    inertia = _inertias(model, dofs, home) - np.diag(armature)
    inertia = inertia * float(np.clip(factors, 0.0, 1.0).min(initial=1.0)) + np.diag(least)
    # Effective inertia of driven joints while the others move freely: the Schur complement.
    picked = np.ix_(np.arange(len(inertia)), dofs[joints], dofs[joints])
    felt = np.linalg.inv(np.linalg.inv(inertia)[picked])
    added = _added(felt, need[joints])
    added[added < _TOLERANCE * need[joints]] = 0.0
    lacking[joints] = [round_up(x) if x > 0 else 0.0 for x in added]
    return lacking


def drawn_joints(
    quantity: str, names: Sequence[str], parts: Parts, changes: Sequence[DriveChange]
) -> Mask:
    """(D,) mask of joints for which events draw a quantity."""
    found = np.zeros(len(names), np.bool_)
    for change in changes:
        found[list(change.bounds(quantity, names, parts))] = True
    return found


def _added(inertia: F64, need: F64) -> F64:
    """Return a >= 0 (D,) with inertia (P, D, D) + diag(a - need) positive semidefinite everywhere.

    Each diagonal element is raised first. Then the coupling of joints is compensated along the
    worst eigenvector, in shares that cancel the negative eigenvalue, until none is left (within a
    thousandth of `need`).
    """
    own = inertia[:, range(len(need)), range(len(need))].min(axis=0)
    added: F64 = np.maximum(0.0, need - own)
    tolerance = _TOLERANCE * float(need.max())
    wrong = inertia
    for _ in range(_ROUNDS):
        values, vectors = np.linalg.eigh(wrong + np.diag(added - need))
        worst = int(values[:, 0].argmin())
        if values[worst, 0] >= -tolerance:
            if wrong is inertia:
                return added
            wrong = inertia  # check the postures that passed again
            continue
        share = np.abs(vectors[worst, :, 0])
        added += -values[worst, 0] * share * share.sum()
        wrong = wrong[values[:, 0] < -tolerance]
    return np.maximum(added, need)


def _inertias(model: mujoco.MjModel, dofs: Ids, home: F64) -> F64:
    """(P, nv, nv) joint-space inertia matrices at the postures."""
    joints = model.dof_jntid[dofs]
    columns = model.jnt_qposadr[joints]
    limited = model.jnt_limited[joints].astype(np.bool_)
    low, high = np.where(limited, model.jnt_range[joints].T, [[-math.pi], [math.pi]])
    random = RandomStreams(0, _POSTURES).uniform("postures", (len(dofs),), low, high)
    postures = np.tile(model.qpos0, (_POSTURES + 2, 1))
    postures[1, columns], postures[2:, columns] = home, random
    found = np.zeros((len(postures), model.nv, model.nv))
    data = mujoco.MjData(model)
    for qpos, matrix in zip(postures, found, strict=True):
        data.qpos[:] = qpos
        matrix[:] = inertia_matrix(model, data)
    return found


def inertia_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> F64:
    """(nv, nv) joint-space inertia matrix at `data.qpos`, armature included."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_makeM(model, data)
    found = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, found)
    return found


def round_up(value: float) -> float:
    """Round a positive number up to two significant digits."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / digit - 1e-9) * digit:.2g}")

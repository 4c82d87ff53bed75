"""Joints of a compiled robot file, and the servos that its actuators are.

An actuator's force is ``gain * ctrl + b0 + b1 * length + b2 * velocity`` (MuJoCo's affine force
generation); on a joint, length is ``gear * q`` and the joint's force is ``gear * force``.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64, Ids
from embodichain.lab.sim.compiler.robot.files.urdf_reading import UrdfLimits

__all__ = [
    "FILTER_DYNAMICS",
    "JOINT_TRANSMISSIONS",
    "FileJoint",
    "FileJoints",
    "JointServos",
    "Servo",
    "ServoColumns",
    "control_names",
    "gear_of",
    "hint_at_degrees",
    "movable_joints",
    "read_joints",
    "read_servos",
]

_JOINT = mujoco.mjtJoint
_TRANSMISSION = mujoco.mjtTrn
_DYNAMICS = mujoco.mjtDyn
_MOVABLE = (int(_JOINT.mjJNT_HINGE), int(_JOINT.mjJNT_SLIDE))
JOINT_TRANSMISSIONS = (
    int(_TRANSMISSION.mjTRN_JOINT),
    int(_TRANSMISSION.mjTRN_JOINTINPARENT),
)
FILTER_DYNAMICS = (int(_DYNAMICS.mjDYN_FILTER), int(_DYNAMICS.mjDYN_FILTEREXACT))


# ------------------------------------------------------------------------------------------ servos


@dataclass(frozen=True)
class Servo:
    """An actuator of the file that takes the position or velocity targets of a joint.

    Its force is ``gain * ctrl - kp * length - kv * velocity``, without activation state; kp is 0
    for a velocity servo. Its control is ``scale * target``. All numbers are in units of the joint.

    Attributes:
        actuator: Id in the model.
        gear: First number of its gear.
        scale: Control per unit of target.
        stiffness: ``gear**2 * kp``.
        damping: ``gear**2 * kv``.
        max_effort: The larger end of its force range; inf if it has none.
        shares: Fractions of `max_effort` that the force range allows down and up.
    """

    actuator: int
    gear: float
    scale: float
    stiffness: float
    damping: float
    max_effort: float = np.inf
    shares: tuple[float, float] = (1.0, 1.0)


@dataclass(frozen=True)
class JointServos:
    """What the file's actuators do to one joint itself, not through a tendon.

    Attributes:
        main: The joint's only position servo, else its only velocity servo without a position
            servo, else None: two of a kind have no common target.
        velocity: The only velocity servo beside a position servo, or None.
        is_actuated: Whether any actuator acts on the joint, a servo or not.
    """

    main: Servo | None
    velocity: Servo | None
    is_actuated: bool


@dataclass(frozen=True, eq=False)
class ServoColumns:
    """The servos of D joints as arrays, for the step; see `Servo`.

    Attributes:
        drive: (D,) id of the main servo, or -1.
        velocity: (D,) id of the velocity servo beside a position servo, or -1.
        gear: (D,); 1 without a servo.
        scale: (D,); 1 without a servo.
        velocity_scale: (D,) as `scale`, for `velocity`.
        stiffness: (D,); 0 without a servo.
        damping: (D,); 0 without a servo.
        max_effort: (D,); inf without a limit.
        shares: (D, 2); 1 without a limit.
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

    @staticmethod
    def from_rows(rows: Sequence[JointServos]) -> ServoColumns:
        """Return the columns of D joints."""
        absent = Servo(actuator=-1, gear=1.0, scale=1.0, stiffness=0.0, damping=0.0)
        mains = [row.main or absent for row in rows]
        velocities = [row.velocity or absent for row in rows]
        return ServoColumns(
            drive=np.array([servo.actuator for servo in mains], np.int64),
            velocity=np.array([servo.actuator for servo in velocities], np.int64),
            gear=np.array([servo.gear for servo in mains], np.float64),
            scale=np.array([servo.scale for servo in mains], np.float64),
            velocity_scale=np.array([servo.scale for servo in velocities], np.float64),
            stiffness=np.array([servo.stiffness for servo in mains], np.float64),
            damping=np.array([servo.damping for servo in mains], np.float64),
            max_effort=np.array([servo.max_effort for servo in mains], np.float64),
            shares=np.array([servo.shares for servo in mains], np.float64).reshape(-1, 2),
        )


def read_servos(model: mujoco.MjModel, joints: Ids) -> list[JointServos]:
    """Return the servos of each joint: (D,) ids of hinges and slides."""
    acts_on_joint = np.isin(model.actuator_trntype, JOINT_TRANSMISSIONS)
    rows: list[JointServos] = []
    for joint in joints:
        acting = np.flatnonzero(acts_on_joint & (model.actuator_trnid[:, 0] == joint)).tolist()
        rows.append(_read_joint_servos(model, acting))
    return rows


def _read_joint_servos(model: mujoco.MjModel, actuators: Sequence[int]) -> JointServos:
    """Pick the servos among the actuators that act on one joint."""
    positions = [i for i in actuators if _servo_kind(model, i) == "position"]
    velocities = [i for i in actuators if _servo_kind(model, i) == "velocity"]
    main: Servo | None = None
    velocity: Servo | None = None
    if len(positions) == 1:
        main = _read_servo(model, positions[0], feedback=1)
        if len(velocities) == 1:
            velocity = _read_servo(model, velocities[0], feedback=2)
    elif not positions and len(velocities) == 1:
        main = _read_servo(model, velocities[0], feedback=2)
    return JointServos(main, velocity, is_actuated=len(actuators) > 0)


def _read_servo(model: mujoco.MjModel, actuator: int, feedback: int) -> Servo:
    """Return a servo; `feedback` is the column of `biasprm` that its targets are compared with."""
    gear = gear_of(model, actuator)
    bias = model.actuator_biasprm[actuator]
    gain = float(model.actuator_gainprm[actuator, 0])
    max_effort = np.inf
    shares = (1.0, 1.0)
    if model.actuator_forcelimited[actuator]:
        down, up = np.abs(model.actuator_forcerange[actuator]).tolist()
        largest = max(down, up)
        max_effort = abs(gear) * largest
        shares = (down / largest, up / largest)
    return Servo(
        actuator=actuator,
        gear=gear,
        scale=-gear * float(bias[feedback]) / gain,
        # Adding 0.0 makes 0.0 of the -0.0 of a gain that is not there.
        stiffness=gear**2 * (-float(bias[1]) + 0.0),
        damping=gear**2 * (-float(bias[2]) + 0.0),
        max_effort=max_effort,
        shares=shares,
    )


def gear_of(model: mujoco.MjModel, actuator: int) -> float:
    """First number of an actuator's gear."""
    return float(model.actuator_gear[model.actuator_outadr[actuator], 0])


def _servo_kind(model: mujoco.MjModel, actuator: int) -> str:
    """Return ``position`` or ``velocity`` for a stateless servo, else an empty string."""
    is_affine = (
        model.actuator_dyntype[actuator] == _DYNAMICS.mjDYN_NONE
        and model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
        and gear_of(model, actuator) != 0
        and not model.actuator_delay[actuator]
    )
    low, high = model.actuator_forcerange[actuator]
    pushes_one_way = model.actuator_forcelimited[actuator] and not low < 0 < high
    if not is_affine or pushes_one_way:
        return ""
    gain = model.actuator_gainprm[actuator, 0]
    offset, position_gain, velocity_gain = model.actuator_biasprm[actuator, :3]
    if gain <= 0 or offset != 0 or velocity_gain > 0:
        return ""
    if position_gain < 0:
        return "position"
    if position_gain == 0 and velocity_gain < 0:
        return "velocity"
    return ""


def control_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the name of every control (nu,): its actuator's, with ``.INPUT`` if it has several."""
    names: list[str] = []
    for i in range(model.nactuator):
        actuator = model.actuator(i).name
        count = int(model.actuator_ctrlnum[i])
        if count == 1:
            names.append(actuator)
            continue
        for k in range(count):
            control = mujoco.mj_actuatorInputName(model, i, k) or str(k)
            names.append(f"{actuator}.{control}")
    return tuple(names)


# ------------------------------------------------------------------------------------------ joints


@dataclass(frozen=True)
class FileJoint:
    """One hinge or slide of a robot, as its file has it. SI units; inf means no limit.

    Attributes:
        name: Its name.
        is_hinge: Whether it turns; a slide moves along its axis.
        lower: Lower limit of its position, rad or m.
        upper: Upper limit of its position, rad or m.
        max_velocity: rad/s or m/s.
        max_effort: N m or N: the joint's own limit, else that of an actuator on it.
        damping: Passive damping.
        friction: Dry friction loss.
        armature: Reflected inertia of its motor.
        inertia: Joint-space inertia at qpos0 (`dof_M0`), kg m^2 or kg.
        home: Where it starts without a keyframe, rad or m: an MJCF's `qpos0` (`ref` of a joint);
            for a URDF, the value nearest zero within the limits.
        servos: The file's servos on it.
        is_urdf: Whether it is from a URDF, which has no actuators.
        is_attached_mjcf: Whether it is from an attached MJCF: only its name in `drive_pros` changes
            it, a single number for all joints does not.
    """

    name: str
    is_hinge: bool
    lower: float
    upper: float
    max_velocity: float
    max_effort: float
    damping: float
    friction: float
    armature: float
    inertia: float
    home: float
    servos: JointServos
    is_urdf: bool
    is_attached_mjcf: bool

    @property
    def servo(self) -> Servo | None:
        """The actuator that takes its targets, if the file has one."""
        return self.servos.main


@dataclass(frozen=True, eq=False)
class FileJoints:
    """The D movable joints of a robot's files, in qpos order.

    Attributes:
        rows: The joints.
        limits: Limits of URDF files beyond those that the model has.
        own_actuators: Number of actuators of the robot's own file, without attached ones.
        actuators: Number of all actuators.
    """

    rows: tuple[FileJoint, ...]
    limits: UrdfLimits
    own_actuators: int
    actuators: int

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(joint.name for joint in self.rows)

    @property
    def qpos_limits(self) -> F64:
        """(D, 2) limits of positions, rad or m."""
        limits = [(joint.lower, joint.upper) for joint in self.rows]
        return np.array(limits, np.float64).reshape(-1, 2)

    @property
    def qvel_limits(self) -> F64:
        """(D,) limits of speeds, rad/s or m/s."""
        return np.array([joint.max_velocity for joint in self.rows], np.float64)

    @property
    def qf_limits(self) -> F64:
        """(D,) limits of efforts, N m or N."""
        return np.array([joint.max_effort for joint in self.rows], np.float64)


def hint_at_degrees(position: float, lower: float, upper: float) -> str:
    """Return what a hinge's position outside its limits is in radians, or ``""``.

    Args:
        position: The position, which is read as rad.
        lower: Lower limit, rad.
        upper: Upper limit, rad.
    """
    is_in_turn = abs(position) <= 2 * math.pi
    if is_in_turn or not lower <= math.radians(position) <= upper:
        return ""
    return f"In degrees? {position:g} degrees are {math.radians(position):.5g} rad."


def movable_joints(model: mujoco.MjModel) -> Ids:
    """Return the ids of hinge and slide joints, in qpos order, without ball and free joints."""
    return np.flatnonzero(np.isin(model.jnt_type, _MOVABLE)).astype(np.int64)


def read_joints(
    model: mujoco.MjModel,
    limits: UrdfLimits,
    urdf: Collection[str],
    attached: tuple[str, ...] = (),
) -> FileJoints:
    """Return a robot's movable joints, as its files have them.

    Args:
        model: The model of the file, attached ones included.
        limits: Of URDF files, what an `MjModel` does not have.
        urdf: Names of joints from URDF files, which have no actuators.
        attached: Prefixes of the names of attached files.
    """
    ids = movable_joints(model)
    all_servos = read_servos(model, ids)
    rows: list[FileJoint] = []
    for joint, servos in zip(ids.tolist(), all_servos, strict=True):
        name = model.joint(joint).name
        dof = int(model.jnt_dofadr[joint])
        lower = -np.inf
        upper = np.inf
        if model.jnt_limited[joint]:
            lower, upper = model.jnt_range[joint].tolist()
        is_urdf = name in urdf
        home = float(model.qpos0[model.jnt_qposadr[joint]])
        if is_urdf:
            home = min(max(0.0, lower), upper)
        rows.append(
            FileJoint(
                name=name,
                is_hinge=bool(model.jnt_type[joint] == int(_JOINT.mjJNT_HINGE)),
                lower=lower,
                upper=upper,
                max_velocity=limits.velocity.get(name, np.inf),
                max_effort=_effort_limit(model, joint),
                damping=float(model.dof_damping[dof]),
                friction=float(model.dof_frictionloss[dof]),
                armature=float(model.dof_armature[dof]),
                inertia=float(model.dof_M0[dof]),
                home=home,
                servos=servos,
                is_urdf=is_urdf,
                is_attached_mjcf=name.startswith(attached) and not is_urdf,
            )
        )
    actuators = [model.actuator(i).name for i in range(model.nactuator)]
    return FileJoints(
        rows=tuple(rows),
        limits=limits,
        own_actuators=sum(not name.startswith(attached) for name in actuators),
        actuators=len(actuators),
    )


def _effort_limit(model: mujoco.MjModel, joint: int) -> float:
    """Return a joint's limit: its own, else that of an actuator on it, else inf."""
    if model.jnt_actfrclimited[joint]:
        return float(np.abs(model.jnt_actfrcrange[joint]).max())
    limit = np.inf
    for actuator in range(model.nactuator):
        acts_on_joint = model.actuator_trntype[actuator] in JOINT_TRANSMISSIONS
        if acts_on_joint and int(model.actuator_trnid[actuator, 0]) == joint:
            effort = abs(gear_of(model, actuator)) * _actuator_limit(model, actuator)
            limit = min(limit, effort)
    return limit


def _actuator_limit(model: mujoco.MjModel, actuator: int) -> float:
    """Return an actuator's largest force before its gear: forcerange, or a motor's ctrlrange."""
    if model.actuator_forcelimited[actuator]:
        return float(np.abs(model.actuator_forcerange[actuator]).max())
    is_motor = (
        model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
    )
    control = int(model.actuator_ctrladr[actuator])
    if is_motor and model.actuator_ctrllimited[control]:
        gain = abs(float(model.actuator_gainprm[actuator, 0]))
        return gain * float(np.abs(model.actuator_ctrlrange[control]).max())
    return float(np.inf)

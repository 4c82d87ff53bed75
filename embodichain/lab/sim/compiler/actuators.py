"""What the actuators of a compiled model are: servos of joints, names of controls, kinds in words.

An actuator's force is ``gain * ctrl + b0 + b1 * length + b2 * velocity`` (MuJoCo's affine force
generation); on a joint, length is ``gear * q`` and the joint feels ``gear * force``.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.index import F64, Ids

__all__ = ["ActuatorDescription", "Servos", "control_names", "describe_actuators", "read_servos"]

JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_FIXED, _NO_BIAS, _AFFINE = (
    int(mujoco.mjtGain.mjGAIN_FIXED),
    int(mujoco.mjtBias.mjBIAS_NONE),
    int(mujoco.mjtBias.mjBIAS_AFFINE),
)
_STATELESS = int(mujoco.mjtDyn.mjDYN_NONE)


@dataclass(frozen=True, eq=False)
class Servos:
    """Which actuators take position and velocity targets of D joints; arrays are (D,).

    A joint has a position servo where exactly one actuator without activation state acts on it with
    the force ``gain * ctrl - kp * length - kv * velocity``; a velocity servo is one with kp = 0.
    `drive` is the position servo, else the velocity servo: its control is ``scale * target``, and
    the other numbers are its too, as the joint feels them (``gear**2 * kp``).

    Attributes:
        drive: Actuator id, or -1.
        velocity: Actuator id of a velocity servo beside a position servo, or -1.
        gear: 1 without a drive.
        scale: Control a unit of target; 1 without a drive.
        velocity_scale: The same of `velocity`.
        stiffness: 0 without a position servo.
        damping: 0 without a drive.
        max_effort: inf where there is no limit.
        shares: (D, 2) shares of it that the force range grants downwards and upwards.
        actuated: Whether any actuator acts on the joint itself (not through a tendon).
        count: How many actuators the model has.
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
    actuated: NDArray[np.bool_]
    count: int


def read_servos(model: mujoco.MjModel, joints: Ids) -> Servos:
    """Find the servos of joints.

    Args:
        model: Any compiled model.
        joints: (D,) ids of hinges and slides.
    """
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
        acting = np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == joint))
        found.actuated[row] = len(acting) > 0
        kinds = [_servo_kind(model, int(i)) for i in acting]
        position = [int(i) for i, kind in zip(acting, kinds, strict=True) if kind == "position"]
        velocity = [int(i) for i, kind in zip(acting, kinds, strict=True) if kind == "velocity"]
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
    gear = _gear(model, actuator)
    found.drive[row] = actuator
    found.gear[row], found.scale[row] = gear, _scale(model, actuator, 1 if kp > 0 else 2)
    found.stiffness[row], found.damping[row] = gear**2 * kp, gear**2 * kv
    if model.actuator_forcelimited[actuator]:
        reach = np.abs(model.actuator_forcerange[actuator])
        found.max_effort[row] = abs(gear) * float(reach.max())
        found.shares[row] = reach / reach.max()


def _gear(model: mujoco.MjModel, actuator: int) -> float:
    return float(model.actuator_gear[model.actuator_outadr[actuator], 0])


def _scale(model: mujoco.MjModel, actuator: int, bias: int) -> float:
    """Return the control a unit of target; `bias` is the column of its feedback gain."""
    gain = float(model.actuator_gainprm[actuator, 0])
    return -_gear(model, actuator) * float(model.actuator_biasprm[actuator, bias]) / gain


def _servo_kind(model: mujoco.MjModel, actuator: int) -> str:
    """Return ``position`` or ``velocity`` for a stateless servo, else an empty string."""
    gain, (b0, b1, b2) = model.actuator_gainprm[actuator, 0], model.actuator_biasprm[actuator, :3]
    linear = (
        model.actuator_dyntype[actuator] == _STATELESS
        and model.actuator_gaintype[actuator] == _FIXED
        and model.actuator_biastype[actuator] == _AFFINE
        and _gear(model, actuator) != 0
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
        if inputs == 1:
            names.append(name)
        else:
            names += [f"{name}.{_input_name(model, i, k)}" for k in range(inputs)]
    return tuple(names)


def _input_name(model: mujoco.MjModel, actuator: int, k: int) -> str:
    return mujoco.mj_actuatorInputName(model, actuator, k) or str(k)


@dataclass(frozen=True)
class ActuatorDescription:
    """One actuator, in words and numbers.

    Attributes:
        name: In the model.
        kind: ``position``, ``velocity``, ``motor``, ``damper``, ``muscle``, ``general``...; with
            ``filter`` or the like before it where the control passes an activation state.
        target: What it acts on: ``joint arm/elbow``, ``tendon hand/split``...
        gear: First number of its gear.
        gain: Force per unit of control (or of activation).
        stiffness: kp, its force per unit of length.
        damping: kv, its force per unit of velocity.
        ctrlrange: Of every control; None where it is not limited.
        forcerange: None where it is not limited.
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
    """Put every actuator of a model into words and numbers."""
    return tuple(_describe(model, i) for i in range(model.nactuator))


def _describe(model: mujoco.MjModel, i: int) -> ActuatorDescription:
    controls = range(
        model.actuator_ctrladr[i], model.actuator_ctrladr[i] + model.actuator_ctrlnum[i]
    )
    affine = int(model.actuator_biastype[i]) == _AFFINE
    low, high = model.actuator_forcerange[i]
    return ActuatorDescription(
        name=model.actuator(i).name,
        kind=_kind(model, i),
        target=_target(model, i),
        gear=_gear(model, i),
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
    if gaintype == _FIXED and biastype in (_NO_BIAS, _AFFINE):
        _, kp, kv = -model.actuator_biasprm[i, :3] if biastype == _AFFINE else np.zeros(3)
        kind = "position" if kp > 0 else "velocity" if kv > 0 else "motor"
        if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_BODY:
            kind = "adhesion"
    else:
        kind = _word(mujoco.mjtGain, gaintype, "mjGAIN_")
        kind = "damper" if kind == "affine" and biastype == _NO_BIAS else kind
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

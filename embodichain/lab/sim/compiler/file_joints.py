"""What a compiled file says of its joints: names, limits, mimics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.actuators import JOINT_TRANSMISSIONS, read_servos
from embodichain.lab.sim.compiler.drives import FileJoints
from embodichain.lab.sim.compiler.index import F64, Ids

__all__ = ["Mimics", "movable_joints", "read_joints", "read_mimics"]

_JOINT_TYPES = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


@dataclass(frozen=True)
class Mimics:
    """Joints that follow another one: ``q[ids] = multipliers * q[parents] + offsets``."""

    ids: tuple[int, ...] = ()
    parents: tuple[int, ...] = ()
    multipliers: tuple[float, ...] = ()
    offsets: tuple[float, ...] = ()


def movable_joints(model: mujoco.MjModel) -> Ids:
    """Return the ids of hinge and slide joints, in qpos order, without ball and free joints."""
    return np.flatnonzero(np.isin(model.jnt_type, _JOINT_TYPES)).astype(np.int64)


def read_joints(
    model: mujoco.MjModel, velocity_limits: Mapping[str, float], *, is_urdf: bool
) -> FileJoints:
    """Return what a file says of its movable joints.

    Args:
        model: The file, compiled as it is.
        velocity_limits: Joint name -> limit, where the file has one (MuJoCo keeps none).
        is_urdf: Whether it is a URDF, which holds no actuators.
    """
    ids = movable_joints(model)
    names = tuple(model.joint(i).name for i in ids)
    dofs = model.jnt_dofadr[ids]
    limited = model.jnt_limited[ids].astype(np.bool_)[:, None]
    limits = np.where(limited, model.jnt_range[ids], [[-np.inf, np.inf]])
    velocity = np.array([velocity_limits.get(name, np.inf) for name in names], np.float64)
    return FileJoints(
        names=names,
        qpos_limits=limits,
        qvel_limits=velocity,
        qf_limits=_effort_limits(model, ids),
        damping=model.dof_damping[dofs].copy(),
        friction=model.dof_frictionloss[dofs].copy(),
        armature=model.dof_armature[dofs].copy(),
        inertia=model.dof_M0[dofs].copy(),
        servos=None if is_urdf else read_servos(model, ids),
    )


def _effort_limits(model: mujoco.MjModel, ids: Ids) -> F64:
    """Return each joint's limit: its own, else that of an actuator on it, else inf."""
    limits: F64 = np.full(model.njnt, np.inf)
    for actuator in range(model.nactuator):
        joint = int(model.actuator_trnid[actuator, 0])
        if model.actuator_trntype[actuator] in JOINT_TRANSMISSIONS:
            gear = abs(float(model.actuator_gear[model.actuator_outadr[actuator], 0]))
            limits[joint] = min(limits[joint], gear * _actuator_limit(model, actuator))
    for joint in ids:
        if model.jnt_actfrclimited[joint]:
            limits[joint] = float(np.abs(model.jnt_actfrcrange[joint]).max())
    return limits[ids]


def _actuator_limit(model: mujoco.MjModel, actuator: int) -> float:
    """Return an actuator's largest force before its gear: forcerange, or a motor's ctrlrange."""
    if model.actuator_forcelimited[actuator]:
        return float(np.abs(model.actuator_forcerange[actuator]).max())
    motor = (
        model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
        and model.actuator_ctrllimited[model.actuator_ctrladr[actuator]]
    )
    if motor:
        gain = abs(float(model.actuator_gainprm[actuator, 0]))
        control = int(model.actuator_ctrladr[actuator])
        return gain * float(np.abs(model.actuator_ctrlrange[control]).max())
    return float(np.inf)


def read_mimics(model: mujoco.MjModel) -> Mimics:
    """Return linear joint equalities as mimics (URDF's ``mimic`` becomes one).

    MuJoCo's equality is ``y - y0 = a0 + a1 (x - x0)`` about the joints' reference positions.
    """
    number = {int(joint): i for i, joint in enumerate(movable_joints(model))}
    rows: dict[int, tuple[int, float, float]] = {}
    for eq in range(model.neq):
        if model.eq_type[eq] != mujoco.mjtEq.mjEQ_JOINT or not model.eq_active0[eq]:
            continue
        follower, leader = int(model.eq_obj1id[eq]), int(model.eq_obj2id[eq])
        a = model.eq_data[eq, :5]
        if follower in number and leader in number and not a[2:].any():
            y0 = float(model.qpos0[model.jnt_qposadr[follower]])
            x0 = float(model.qpos0[model.jnt_qposadr[leader]])
            offset = y0 + float(a[0]) - float(a[1]) * x0
            rows[number[follower]] = (number[leader], float(a[1]), offset)
    ids = tuple(sorted(rows))
    return Mimics(
        ids,
        tuple(rows[i][0] for i in ids),
        tuple(rows[i][1] for i in ids),
        tuple(rows[i][2] for i in ids),
    )

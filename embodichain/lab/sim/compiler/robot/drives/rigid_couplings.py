"""Rigid couplings: a joint that mimics another follows it, however its leader is driven.

MuJoCo makes a joint equality of a URDF's ``mimic``, with a soft default: a follower sags by
degrees. Here it gets the stiffest reference that the time step allows, ``2 dt``, and the largest
impedance.

MuJoCo's constraint solver assumes the inertia M of both joints, but a step also integrates dampers
implicitly: velocities change by ``(M + h D)^-1 h f``. Where ``h D`` of the leader's drive is not
small against M, the leader moves less than the solver expects, and the follower overshoots or
diverges. Two things keep the coupling rigid:

* the leader has at least the armature at which a clipped drive would not chatter, see `chatter`,
  and the follower a share of it;
* the follower carries its part of the damping, so that D is proportional to M along the coupled
  motion. The drive's own damper is reduced by as much: the total is the configured one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64, Ids, Mask
from embodichain.lab.sim.compiler.robot.drives.chatter import PhysicsStep, inertia_matrix, round_up
from embodichain.lab.sim.compiler.robot.drives.pd_drives import DriveGains
from embodichain.lab.sim.compiler.robot.files.joint_couplings import JointCoupling

__all__ = ["Rigidity", "make_couplings_rigid", "moving_mimics", "rigid_armature"]

_NEED_TOLERANCE = 1e-2
"""Armature that lacks less than this fraction of what is needed is not added."""
_LARGEST_IMPEDANCE = 0.9999
"""MuJoCo's mjMAXIMP."""
_FOLLOWER_SHARE = 0.03
"""Armature of a follower, seen at its leader, as a fraction of the leader's."""
_LARGEST_CARRIED_SHARE = 0.9
"""Fraction of a drive's damping that followers may carry."""
_LARGEST_DRAG = 0.02
"""Fraction of a limited drive's effort that the followers' damping may take at full speed."""
_ASSUMED_SPEED = 10.0
"""rad/s or m/s, the full speed of a joint whose file has no velocity limit."""


@dataclass(frozen=True, eq=False)
class Rigidity:
    """What makes couplings rigid, each (D,).

    Attributes:
        carried: Damping of a drive that its followers carry, seen at the drive's joint.
        damping: Damping added to followers.
    """

    carried: F64
    damping: F64

    @staticmethod
    def none(count: int) -> Rigidity:
        """Return that of `count` joints without couplings."""
        return Rigidity(carried=np.zeros(count), damping=np.zeros(count))


@dataclass(frozen=True)
class _Follower:
    """A joint that follows the head of its chain: ``dq[joint] = slope * dq[head]``."""

    joint: int
    head: int
    slope: float


def _followers(mimics: Sequence[JointCoupling]) -> list[_Follower]:
    """Return each mimic with the joint at the head of its chain; circles and idle ones left out."""
    coupling_of = {mimic.joint: mimic for mimic in mimics}
    followers: list[_Follower] = []
    for joint in coupling_of:
        head = joint
        slope = 1.0
        passed: set[int] = set()
        while head in coupling_of and head not in passed:
            passed.add(head)
            slope *= coupling_of[head].slope
            head = coupling_of[head].leader
        is_circle = head in coupling_of
        if not is_circle and slope != 0:
            followers.append(_Follower(joint, head, slope))
    return followers


def moving_mimics(
    model: mujoco.MjModel, names: Sequence[str], mimics: Sequence[JointCoupling]
) -> Mask:
    """(D,) mimic joints, their leaders, and joints between them and the root, which move them.

    Args:
        model: The articulation.
        names: Its D hinges and slides.
        mimics: Of URDF files.
    """
    joints = [model.joint(name).id for name in names]
    moving_bodies: set[int] = set()
    for mimic in mimics:
        for joint in (mimic.joint, mimic.leader):
            body = int(model.jnt_bodyid[joints[joint]])
            while body > 0:
                moving_bodies.add(body)
                body = int(model.body_parentid[body])
    return np.array([int(model.jnt_bodyid[joint]) in moving_bodies for joint in joints], np.bool_)


def rigid_armature(
    model: mujoco.MjModel,
    names: Sequence[str],
    gains: DriveGains,
    mimics: Sequence[JointCoupling],
    home: F64,
    step: PhysicsStep,
    lacking: F64,
) -> F64:
    """Return the armature (D,) that each joint lacks for a rigid coupling.

    Args:
        model: The articulation alone, with its current armature.
        names: Its D hinges and slides.
        gains: Their drives.
        mimics: Of URDF files.
        home: (D,) initial positions.
        step: Time step and integrator.
        lacking: (D,) armature that joints lack anyway.
    """
    followers = _followers(mimics)
    if not followers:
        return lacking
    dofs, inertia = _inertia_at(model, names, home)
    own_inertia = np.diag(inertia)[dofs]
    armature = model.dof_armature[dofs]
    damping = model.dof_damping[dofs] + np.where(gains.driven, gains.damping, 0.0)
    stiffness = np.where(gains.driven, gains.stiffness, 0.0)
    need = 0.5 * step.dt * damping + 0.25 * step.dt**2 * stiffness
    raised = lacking.copy()

    def raise_to(joint: int, value: float) -> None:
        if value > max(raised[joint], _NEED_TOLERANCE * need[joint]):
            raised[joint] = round_up(value)

    for head in {follower.head for follower in followers}:
        raise_to(head, need[head] - own_inertia[head])
    for follower in followers:
        joint = follower.joint
        head_armature = armature[follower.head] + raised[follower.head]
        share = _FOLLOWER_SHARE * head_armature / follower.slope**2
        raise_to(joint, need[joint] - own_inertia[joint])
        if armature[joint] < share * (1.0 - _NEED_TOLERANCE):
            raise_to(joint, share - armature[joint])
    return raised


def make_couplings_rigid(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    names: Sequence[str],
    gains: DriveGains,
    mimics: Sequence[JointCoupling],
    home: F64,
    speeds: F64,
    step: PhysicsStep,
) -> Rigidity:
    """Make couplings rigid, in a spec and its model.

    Args:
        spec: The articulation, with its drives and armature.
        model: The same, compiled.
        names: Its D hinges and slides.
        gains: Their drives.
        mimics: Of URDF files.
        home: (D,) initial positions.
        speeds: (D,) velocity limits of the file.
        step: Time step and integrator.
    """
    _stiffen_equalities(spec, model, {names[mimic.joint] for mimic in mimics}, step)
    rigidity = _distribute_damping(model, names, gains, mimics, home, speeds)
    for i in np.flatnonzero(rigidity.damping > 0).tolist():
        joint = spec.joint(names[i])
        dof = model.joint(names[i]).dofadr[0]
        joint.damping[0] += rigidity.damping[i]
        model.dof_damping[dof] += rigidity.damping[i]
    for i in np.flatnonzero(rigidity.carried > 0).tolist():
        for actuator in spec.actuators:
            if actuator.target == names[i] and gains.driven[i]:
                actuator.biasprm[2] += rigidity.carried[i]
                model.actuator_biasprm[model.actuator(actuator.name).id, 2] += rigidity.carried[i]
    return rigidity


def _stiffen_equalities(
    spec: mujoco.MjSpec, model: mujoco.MjModel, followers: set[str], step: PhysicsStep
) -> None:
    """Give the equalities of followers the stiffest reference and the largest impedance."""
    reference = [2.0 * step.dt, 1.0]
    impedance = [_LARGEST_IMPEDANCE, _LARGEST_IMPEDANCE, 0.001, 0.5, 2.0]
    for equality in spec.equalities:
        if equality.type == mujoco.mjtEq.mjEQ_JOINT and equality.name1 in followers:
            equality.solref = reference
            equality.solimp = impedance
    for i in range(model.neq):
        is_joint = model.eq_type[i] == mujoco.mjtEq.mjEQ_JOINT
        if is_joint and model.joint(model.eq_obj1id[i]).name in followers:
            model.eq_solref[i] = reference
            model.eq_solimp[i] = impedance


def _distribute_damping(
    model: mujoco.MjModel,
    names: Sequence[str],
    gains: DriveGains,
    mimics: Sequence[JointCoupling],
    home: F64,
    speeds: F64,
) -> Rigidity:
    """Distribute the damping of drives with a stiffness over the joints that they move."""
    rigidity = Rigidity.none(len(home))
    all_followers = _followers(mimics)
    if not all_followers:
        return rigidity
    dofs, inertia = _inertia_at(model, names, home)
    passive = model.dof_damping[dofs]
    for head in sorted({follower.head for follower in all_followers}):
        drive_damping = float(gains.damping[head])
        if not gains.driven[head] or not gains.stiffness[head] > 0 or not drive_damping > 0:
            continue
        followers = [follower for follower in all_followers if follower.head == head]
        tangent = np.zeros(model.nv)
        tangent[dofs[head]] = 1.0
        for follower in followers:
            tangent[dofs[follower.joint]] = follower.slope
        # Momentum of each joint along the coupled motion, seen at the leader.
        momentum = (tangent * (inertia @ tangent))[dofs]
        all_momentum = max(float(momentum[head]), 0.0)
        all_momentum += sum(max(float(momentum[f.joint]), 0.0) for f in followers)
        if not all_momentum > 0:
            continue
        all_damping = drive_damping + passive[head]
        all_damping += sum(passive[f.joint] * f.slope**2 for f in followers)
        # Damping that each follower lacks to have its part, seen at the leader.
        lacking = {
            f: max(
                0.0,
                all_damping * float(momentum[f.joint]) / all_momentum
                - passive[f.joint] * f.slope**2,
            )
            for f in followers
        }
        speed = float(speeds[head])
        if not 0 < speed < np.inf:
            speed = _ASSUMED_SPEED
        largest = min(
            _LARGEST_CARRIED_SHARE * drive_damping,
            _LARGEST_DRAG * float(gains.max_effort[head]) / speed,
        )
        all_lacking = sum(lacking.values())
        scale = min(1.0, largest / all_lacking) if all_lacking > 0 else 0.0
        for f, damping in lacking.items():
            rigidity.damping[f.joint] = float(f"{scale * damping / f.slope**2:.6g}")
            rigidity.carried[head] += rigidity.damping[f.joint] * f.slope**2
    return rigidity


def _inertia_at(model: mujoco.MjModel, names: Sequence[str], qpos: F64) -> tuple[Ids, F64]:
    """(D,) degrees of freedom of the joints, and the (nv, nv) inertia at their positions."""
    joints = [model.joint(name).id for name in names]
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[joints]] = qpos
    return model.jnt_dofadr[joints].astype(np.int64), inertia_matrix(model, data)

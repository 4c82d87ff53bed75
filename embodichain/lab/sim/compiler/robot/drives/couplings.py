"""Couplings of joints: a URDF's ``mimic``, and joint equalities of an MJCF.

MuJoCo makes a joint equality of ``mimic``, with a soft default: a follower sags by degrees. Here it
gets the stiffest reference that the time step allows, ``2 dt``, and the largest impedance.

MuJoCo's constraint solver assumes the inertia M of both joints, but a step also integrates dampers
implicitly: velocities change by ``(M + h D)^-1 h f``. Where ``h D`` of the leader's drive is not
small against M, the leader moves less than the solver expects, and the follower overshoots or
diverges. Two things keep the coupling rigid:

* the leader has at least the armature at which a clipped drive would not chatter, see `drives`, and
  the follower a share of it;
* the follower carries its part of the damping, so that D is proportional to M along the coupled
  motion. The drive's own damper is reduced by as much: the total is the configured one.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64, Mask
from embodichain.lab.sim.compiler.robot.drives.pd_drives import (
    DriveGains,
    PhysicsStep,
    inertia_matrix,
    round_up,
)
from embodichain.lab.sim.compiler.robot.files.robot_joints import Mimics, movable_joints

__all__ = [
    "Rigidity",
    "couple",
    "moving_mimics",
    "read_couplings",
    "rigid_armature",
    "shown_mimics",
]

_TOLERANCE = 1e-2  # relative; smaller needs are ignored
_IMPEDANCE = 0.9999  # MuJoCo's largest, mjMAXIMP
_SHARE = 0.03
"""Armature of a follower, seen at its leader, as a fraction of the leader's."""
_MOST_CARRIED = 0.9
"""Fraction of a drive's damping that followers may carry."""
_DRAG = 0.02
"""Fraction of a limited drive's effort that the followers' damping may take at full speed."""
_SPEED = 10.0
"""rad/s or m/s, the full speed of a joint whose file has no velocity limit."""


# ---------------------------------------------------------------------------------- which joints


def read_couplings(
    model: mujoco.MjModel, names: Collection[str], urdf: Collection[str]
) -> tuple[Mimics, Mimics]:
    """Return the mimics of URDF files, and the linear joint equalities of MJCF files.

    Both are sorted so that a leader that follows another one comes before its followers.

    MuJoCo's equality is ``y - y0 = a0 + a1 (x - x0)`` about the joints' reference positions.

    Args:
        model: The model of the files.
        names: Its movable joints, in order.
        urdf: Names of the joints from URDF files.
    """
    number = {int(joint): i for i, joint in enumerate(movable_joints(model))}
    order = tuple(names)
    mimics: dict[int, tuple[int, int, float, float]] = {}
    equalities: dict[int, tuple[int, int, float, float]] = {}
    for eq in range(model.neq):
        if model.eq_type[eq] != mujoco.mjtEq.mjEQ_JOINT or not model.eq_active0[eq]:
            continue
        follower, leader = int(model.eq_obj1id[eq]), int(model.eq_obj2id[eq])
        a = model.eq_data[eq, :5]
        if follower not in number or leader not in number or a[2:].any():
            continue
        y0 = float(model.qpos0[model.jnt_qposadr[follower]])
        x0 = float(model.qpos0[model.jnt_qposadr[leader]])
        row = number[follower], number[leader], float(a[1]), y0 + float(a[0]) - float(a[1]) * x0
        found = mimics if order[row[0]] in urdf else equalities
        found[row[0]] = row
    return _sorted(mimics), _sorted(equalities)


def _sorted(rows: dict[int, tuple[int, int, float, float]]) -> Mimics:
    """Leaders before their followers, else by joint."""
    done: list[int] = []
    for first in sorted(rows):
        chain: list[int] = []
        joint = first
        while joint in rows and joint not in done and joint not in chain:
            chain.append(joint)
            joint = rows[joint][1]
        done += reversed(chain)
    columns = zip(*(rows[joint] for joint in done), strict=True)
    return Mimics(*columns) if rows else Mimics()


def shown_mimics(mimics: Mimics, equalities: Mimics, moved: Mask) -> Mimics:
    """Return the joints that handles show as following another one.

    They are the mimics of URDF files, and of each pair that an MJCF's equality couples the joint
    that no drive and no servo moves: the equality itself has no leader.

    Args:
        mimics: Of URDF files.
        equalities: Of MJCF files.
        moved: (D,) joints with a drive or a servo.
    """
    rows = [*zip(mimics.ids, mimics.parents, mimics.multipliers, mimics.offsets, strict=True)]
    pairs = zip(
        equalities.ids,
        equalities.parents,
        equalities.multipliers,
        equalities.offsets,
        strict=True,
    )
    for joint, other, slope, offset in pairs:
        if not moved[joint]:
            rows.append((joint, other, slope, offset))
        elif not moved[other] and slope != 0:
            rows.append((other, joint, 1.0 / slope, -offset / slope))
    columns = zip(*sorted({row[0]: row for row in rows}.values()), strict=True)
    return Mimics(*columns) if rows else Mimics()


# -------------------------------------------------------------------------------------- rigidity


@dataclass(frozen=True, eq=False)
class Rigidity:
    """What makes couplings rigid, each (D,).

    Attributes:
        carried: Damping of a drive that its followers carry, seen at the drive's joint.
        damping: Damping added to followers.
    """

    carried: F64
    damping: F64


def _leaders(mimics: Mimics) -> dict[int, tuple[int, float]]:
    """Follower -> the joint at the head of its chain, and the slope with which it follows that."""
    direct = {
        i: (parent, slope)
        for i, parent, slope in zip(mimics.ids, mimics.parents, mimics.multipliers, strict=True)
    }
    found: dict[int, tuple[int, float]] = {}
    for joint in direct:
        head, slope, passed = joint, 1.0, set[int]()
        while head in direct and head not in passed:
            passed.add(head)
            head, factor = direct[head]
            slope *= factor
        if head not in direct and slope != 0:  # no circle, and it moves
            found[joint] = head, slope
    return found


def moving_mimics(model: mujoco.MjModel, names: Collection[str], mimics: Mimics) -> Mask:
    """(D,) mimic joints, their leaders, and joints between them and the root, which move them.

    Args:
        model: The articulation.
        names: Its D hinges and slides.
        mimics: Of URDF files.
    """
    joints = [model.joint(name).id for name in names]
    bodies = set[int]()
    for joint in (*mimics.ids, *mimics.parents):
        body = int(model.jnt_bodyid[joints[joint]])
        while body > 0:
            bodies.add(body)
            body = int(model.body_parentid[body])
    return np.array([int(model.jnt_bodyid[joint]) in bodies for joint in joints], np.bool_)


def rigid_armature(
    model: mujoco.MjModel,
    names: Collection[str],
    gains: DriveGains,
    mimics: Mimics,
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
    heads = _leaders(mimics)
    if not heads:
        return lacking
    dofs, inertia = _at_home(model, names, home)
    own = np.diag(inertia)[dofs]
    damping = model.dof_damping[dofs] + np.where(gains.driven, gains.damping, 0.0)
    stiffness = np.where(gains.driven, gains.stiffness, 0.0)
    need = 0.5 * step.dt * damping + 0.25 * step.dt**2 * stiffness
    found = lacking.copy()

    def raise_to(joint: int, value: float) -> None:
        if value > max(found[joint], _TOLERANCE * need[joint]):
            found[joint] = round_up(value)

    armature = model.dof_armature[dofs]
    for joint in {head for head, _ in heads.values()}:
        raise_to(joint, need[joint] - own[joint])
    for joint, (head, slope) in heads.items():
        share = _SHARE * (armature[head] + found[head]) / slope**2
        raise_to(joint, need[joint] - own[joint])
        if armature[joint] < share * (1.0 - _TOLERANCE):
            raise_to(joint, share - armature[joint])
    return found


def couple(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    names: Collection[str],
    gains: DriveGains,
    mimics: Mimics,
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
    order = tuple(names)
    followers = {order[i] for i in mimics.ids}
    reference, impedance = [2.0 * step.dt, 1.0], [_IMPEDANCE, _IMPEDANCE, 0.001, 0.5, 2.0]
    for equality in spec.equalities:
        if equality.type == mujoco.mjtEq.mjEQ_JOINT and equality.name1 in followers:
            equality.solref, equality.solimp = reference, impedance
    for eq in range(model.neq):
        joint = model.eq_obj1id[eq]
        if model.eq_type[eq] == mujoco.mjtEq.mjEQ_JOINT and model.joint(joint).name in followers:
            model.eq_solref[eq], model.eq_solimp[eq] = reference, impedance
    rigidity = _carried(model, order, gains, mimics, home, speeds)
    for i in np.flatnonzero(rigidity.damping > 0).tolist():
        joint = spec.joint(order[i])
        dof = model.joint(order[i]).dofadr[0]
        joint.damping[0] += rigidity.damping[i]
        model.dof_damping[dof] += rigidity.damping[i]
    for i in np.flatnonzero(rigidity.carried > 0).tolist():
        for actuator in spec.actuators:
            if actuator.target == order[i] and gains.driven[i]:
                actuator.biasprm[2] += rigidity.carried[i]
                model.actuator_biasprm[model.actuator(actuator.name).id, 2] += rigidity.carried[i]
    return rigidity


def _carried(
    model: mujoco.MjModel,
    names: Collection[str],
    gains: DriveGains,
    mimics: Mimics,
    home: F64,
    speeds: F64,
) -> Rigidity:
    """Distribute the damping of drives with a stiffness over the joints that they move."""
    count = len(home)
    carried, added = np.zeros(count), np.zeros(count)
    heads = _leaders(mimics)
    if not heads:
        return Rigidity(carried, added)
    dofs, inertia = _at_home(model, names, home)
    passive = model.dof_damping[dofs]
    for head in sorted({head for head, _ in heads.values()}):
        drive = float(gains.damping[head])
        if not gains.driven[head] or not gains.stiffness[head] > 0 or not drive > 0:
            continue
        own = {joint: slope for joint, (first, slope) in heads.items() if first == head}
        tangent = np.zeros(model.nv)
        tangent[dofs[head]] = 1.0
        for joint, slope in own.items():
            tangent[dofs[joint]] = slope
        # Momentum of each joint along the coupled motion, seen at the leader.
        parts = (tangent * (inertia @ tangent))[dofs]
        total = drive + passive[head] + sum(passive[j] * slope**2 for j, slope in own.items())
        everything = max(float(parts[head]), 0.0) + sum(max(float(parts[j]), 0.0) for j in own)
        if not everything > 0:
            continue
        wanted = {
            j: max(0.0, total * float(parts[j]) / everything - passive[j] * own[j] ** 2)
            for j in own
        }
        effort = float(gains.max_effort[head])
        speed = float(speeds[head])
        speed = speed if 0 < speed < np.inf else _SPEED
        most = min(_MOST_CARRIED * drive, _DRAG * effort / speed)
        scale = min(1.0, most / sum(wanted.values())) if sum(wanted.values()) > 0 else 0.0
        for joint, value in wanted.items():
            added[joint] = float(f"{scale * value / own[joint] ** 2:.6g}")
            carried[head] += added[joint] * own[joint] ** 2
    return Rigidity(carried, added)


def _at_home(
    model: mujoco.MjModel, names: Collection[str], home: F64
) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], F64]:
    """(D,) degrees of freedom of the joints, and the (nv, nv) inertia at the home pose."""
    joints = [model.joint(name).id for name in names]
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[joints]] = home
    return model.jnt_dofadr[joints].astype(np.int64), inertia_matrix(model, data)

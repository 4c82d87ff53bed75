"""Joints that follow others: a URDF's ``mimic``, and joint equalities of an MJCF.

MuJoCo makes a joint equality of ``mimic``. An equality has no leader: either joint moves the other.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import mujoco

from embodichain.lab.sim.compiler.index import Mask
from embodichain.lab.sim.compiler.robot.files.robot_joints import movable_joints

__all__ = ["JointCoupling", "read_couplings", "shown_mimics"]


@dataclass(frozen=True)
class JointCoupling:
    """One joint follows another: ``q[joint] = slope * q[leader] + offset``.

    Attributes:
        joint: Index of the follower among the robot's movable joints.
        leader: Index of the joint that it follows.
        slope: Ratio of their motions.
        offset: rad or m.
    """

    joint: int
    leader: int
    slope: float
    offset: float

    def reversed(self) -> JointCoupling:
        """Return the same coupling seen from the leader; the slope must not be 0."""
        return JointCoupling(
            joint=self.leader,
            leader=self.joint,
            slope=1.0 / self.slope,
            offset=-self.offset / self.slope,
        )


def read_couplings(
    model: mujoco.MjModel, names: Sequence[str], urdf: Collection[str]
) -> tuple[tuple[JointCoupling, ...], tuple[JointCoupling, ...]]:
    """Return the mimics of URDF files, and the linear joint equalities of MJCF files.

    Both are sorted so that a leader that follows another one comes before its followers.

    Args:
        model: The model of the files.
        names: Its movable joints, in order.
        urdf: Names of the joints from URDF files.
    """
    index_of = {int(joint): i for i, joint in enumerate(movable_joints(model))}
    mimics: dict[int, JointCoupling] = {}
    equalities: dict[int, JointCoupling] = {}
    for equality in range(model.neq):
        is_joint = model.eq_type[equality] == mujoco.mjtEq.mjEQ_JOINT
        if not is_joint or not model.eq_active0[equality]:
            continue
        follower = int(model.eq_obj1id[equality])
        leader = int(model.eq_obj2id[equality])
        if follower not in index_of or leader not in index_of:
            continue
        coefficients = model.eq_data[equality, :5]
        if coefficients[2:].any():  # not linear
            continue
        # MuJoCo's equality is y - y0 = a0 + a1 (x - x0) about the joints' reference positions.
        a0, a1 = coefficients[:2].tolist()
        y0 = float(model.qpos0[model.jnt_qposadr[follower]])
        x0 = float(model.qpos0[model.jnt_qposadr[leader]])
        joint = index_of[follower]
        couplings = mimics if names[joint] in urdf else equalities
        couplings[joint] = JointCoupling(
            joint=joint, leader=index_of[leader], slope=a1, offset=y0 + a0 - a1 * x0
        )
    return _leaders_first(mimics), _leaders_first(equalities)


def _leaders_first(couplings: dict[int, JointCoupling]) -> tuple[JointCoupling, ...]:
    """Sort couplings, by the joint that follows: leaders before their followers, else by joint."""
    order: list[int] = []
    for first in sorted(couplings):
        chain: list[int] = []
        joint = first
        while joint in couplings and joint not in order and joint not in chain:
            chain.append(joint)
            joint = couplings[joint].leader
        order += reversed(chain)
    return tuple(couplings[joint] for joint in order)


def shown_mimics(
    mimics: Sequence[JointCoupling], equalities: Sequence[JointCoupling], is_moved: Mask
) -> tuple[JointCoupling, ...]:
    """Return the joints that handles show as following another one, sorted by joint.

    They are the mimics of URDF files, and of each pair that an MJCF's equality couples the joint
    that no drive and no servo moves: the equality itself has no leader.

    Args:
        mimics: Of URDF files.
        equalities: Of MJCF files.
        is_moved: (D,) joints with a drive or a servo.
    """
    shown = {mimic.joint: mimic for mimic in mimics}
    for equality in equalities:
        if not is_moved[equality.joint]:
            shown[equality.joint] = equality
        elif not is_moved[equality.leader] and equality.slope != 0:
            shown[equality.leader] = equality.reversed()
    return tuple(shown[joint] for joint in sorted(shown))

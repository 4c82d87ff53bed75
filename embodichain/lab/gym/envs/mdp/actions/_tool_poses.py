"""Poses that an action asks of a tool: `AbsolutePose`, `RelativePose` and its `MotionColumns`.

Poses are in the environment's frame, unless a name says otherwise; quaternions are wxyz.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from embodichain.lab.gym.envs.managers.term import ActionMeaning
from embodichain.lab.gym.envs.managers.terms.per_name import JointClip, PerJoint
from embodichain.lab.gym.envs.mdp.actions.joint_action import Affine
from embodichain.utils.arrays import contiguous, may_be_set
from embodichain.utils.math import (
    euler_xyz_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_rotate,
    quat_to_rotvec,
    quat_to_rpy,
    rotvec_to_quat,
)

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.gym.envs.managers.param_types import Box3
    from embodichain.lab.sim.objects.arms.arm_solver import ArmSolver
    from embodichain.utils.array_types import Floats

__all__ = [
    "AbsolutePose",
    "MotionColumns",
    "RelativePose",
    "in_axes",
    "meaning_of_motions",
    "meaning_of_poses",
    "motion_between",
]

_PLACE = ("x", "y", "z")
_QUATS, _ANGLES = ("qw", "qx", "qy", "qz"), ("roll", "pitch", "yaw")


def meaning_of_poses(names: Sequence[str], frame: str) -> ActionMeaning:
    """What the columns of poses command: metres, and a quaternion or angles about fixed axes."""
    quantities = tuple("tool position" if name in _PLACE else "tool orientation" for name in names)
    units = {**dict.fromkeys(_PLACE, "m"), **dict.fromkeys(_ANGLES, "rad")}
    return ActionMeaning(
        quantity=quantities,
        mode="absolute",
        frame=frame,
        units=tuple(units.get(name, "") for name in names),
    )


def meaning_of_motions(names: Sequence[str], frame: str, reference: str) -> ActionMeaning:
    """What the columns of motions command: metres, and a rotation vector in rad."""
    return ActionMeaning(
        quantity=tuple("tool position" if name in _PLACE else "tool rotation" for name in names),
        mode="delta",
        reference=reference,
        frame=frame,
        units=tuple("m" if name in _PLACE else "rad" for name in names),
    )


class AbsolutePose:
    """Actions that are poses of a tool.

    Args:
        asset: The robot.
        solver: The kinematics of its tool.
        env: The environment.
        frame: Of the pose: ``base``, the robot's root, or ``world``, the environment.
        rotation: ``quat``, ``rpy``, ``keep`` or ``free``, as of `eef_pose`.
        position_range: Low and high of the position, or None: a box around all that the links
            could reach.

    Attributes:
        names: Names of the A columns.
        low, high: (A,) float32 bounds of the action.
        home: (A,) the action that asks for the initial pose.
    """

    def __init__(
        self,
        asset: Any,
        solver: ArmSolver,
        env: TermContext,
        frame: Literal["base", "world"],
        rotation: Literal["quat", "rpy", "keep", "free"],
        position_range: Box3 | None,
    ) -> None:
        self._solver, self._world, self._rotation = solver, frame == "world", rotation
        index = asset.entity
        root = np.zeros(3) if not self._world else np.asarray(index.pos0, np.float64)
        reach = solver.chain.reach
        box = [root - reach, root + reach] if position_range is None else position_range
        extra = {"quat": 1.0, "rpy": np.pi}.get(rotation, 0.0)
        self.names = ("x", "y", "z", *{"quat": _QUATS, "rpy": _ANGLES}.get(rotation, ()))
        ends = np.full(len(self.names) - 3, extra)
        self.low: NDArray[np.float32] = np.concatenate([box[0], -ends]).astype(np.float32)
        self.high: NDArray[np.float32] = np.concatenate([box[1], ends]).astype(np.float32)
        initial = np.asarray(asset.parsed.init_qpos, np.float64)[None]
        pos, quat = solver.forward_in_root(initial, np.zeros(1, np.int64))
        if self._world:
            turn = np.asarray(index.quat0, np.float64)[None]
            pos, quat = root + quat_rotate(turn, pos), quat_multiply(turn, quat)
        self.home: Floats = self.action_at(pos, quat)[0]
        self._of = env.arrays.of
        self._kept: Floats = env.arrays.put(np.tile(quat, (env.num_envs, 1)))

    def action_at(self, pos: Floats, quat: Floats) -> Floats:
        """(n, A) the action for a pose (n, 3), (n, 4) in `frame`."""
        turned = {"quat": quat, "rpy": quat_to_rpy(quat)}.get(self._rotation, quat[:, :0])
        action = np.concatenate([pos, turned], axis=1)
        return np.minimum(np.maximum(action, self.low), self.high)

    def asked(
        self, action: torch.Tensor, orientation: Callable[[], Floats]
    ) -> tuple[Floats, Floats | None]:
        """The poses in `frame` that actions (N, A) ask for.

        Args:
            action: The action.
            orientation: Returns the orientation (N, 4) in `frame` that a quaternion 0 keeps.

        Returns:
            Position (N, 3) and orientation (N, 4) or None, if that is free.
        """
        given = np.minimum(np.maximum(self._of(action), self.low), self.high).astype(np.float64)
        pos, turned = contiguous(given[:, :3]), contiguous(given[:, 3:])
        quat: Floats | None = None
        if self._rotation == "keep":
            quat = self._kept
        elif self._rotation == "rpy":
            quat = quat_conjugate(euler_xyz_to_quat(-turned))
        elif self._rotation == "quat":
            quat = _normalized(turned, orientation)
        return pos, quat

    def action_for(self, pos: Floats, quat: Floats, shift: Floats, turn: Floats) -> Floats:
        """(n, A) the actions for poses of the environment's frame after motions in its axes.

        Args:
            pos, quat: (n, 3), (n, 4) poses.
            shift, turn: (n, 3) metres and (n, 3) rotation vectors.
        """
        moved = self.in_frame(pos + shift, quat_multiply(rotvec_to_quat(turn), quat))
        return self.action_at(*moved)

    def in_world(self, pos: Floats, quat: Floats | None) -> tuple[Floats, Floats | None]:
        """Poses (N, 3), (N, 4) of `frame` in the environment's frame."""
        if self._world:
            return pos, quat
        root_pos, root_quat = self._solver.root_pose()
        turned = None if quat is None else quat_multiply(root_quat, quat)
        return root_pos + quat_rotate(root_quat, pos), turned

    def in_frame(self, pos: Floats, quat: Floats) -> tuple[Floats, Floats]:
        """Poses (N, 3), (N, 4) of the environment's frame in `frame`."""
        if self._world:
            return pos, quat
        root_pos, root_quat = self._solver.root_pose()
        back = quat_conjugate(root_quat)
        return quat_rotate(back, pos - root_pos), quat_multiply(back, quat)


def _normalized(quat: Floats, orientation: Callable[[], Floats]) -> Floats:
    """(N, 4) unit quaternions; those of `orientation` where one is 0."""
    squares = quat * quat
    norm = np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2] + squares[:, 3])
    void = norm < 1e-6
    unit: Floats = quat / np.where(void, 1.0, norm)[:, None]
    if may_be_set(void):
        unit = np.where(void[:, None], orientation(), unit)
    return unit


def in_axes(
    solver: ArmSolver,
    frame: Literal["base", "world", "tool"],
    quat: Floats,
    shift: Floats,
    turn: Floats,
) -> tuple[Floats, Floats]:
    """Motions (n, 3), (n, 3) along the environment's axes in those of a frame.

    Args:
        solver: The kinematics of the tool.
        frame: As of `eef_delta_pose`.
        quat: (n, 4) orientation of the tool.
        shift, turn: The motions.
    """
    if frame == "world":
        return shift, turn
    back = quat_conjugate(solver.root_pose()[1] if frame == "base" else quat)
    return quat_rotate(back, shift), quat_rotate(back, turn)


def motion_between(
    start: tuple[Floats, Floats], pos: Floats, quat: Floats
) -> tuple[Floats, Floats]:
    """Translation (n, 3) and rotation vector (n, 3) from a pose to another, in their frame."""
    return pos - start[0], quat_to_rotvec(quat_multiply(quat, quat_conjugate(start[1])))


class MotionColumns:
    """Columns of actions that are motions of a tool: scale x clamp(action, clip).

    Args:
        env: The environment.
        rotation: ``command``, ``keep`` or ``free``, as of `eef_delta_pose`.
        scale: m and rad per unit of action; None is 0.02 m and 0.1 rad.
        clip: Bounds of the action; None is [-1, 1].

    Attributes:
        names: Names of the A columns.
        low, high: (A,) float32 bounds of the action.
        scale: (A,) m and rad per unit of action.
    """

    def __init__(
        self,
        env: TermContext,
        rotation: Literal["command", "keep", "free"],
        scale: PerJoint | None,
        clip: JointClip | None,
    ) -> None:
        turns = rotation == "command"
        self.names = ("x", "y", "z", *(("rx", "ry", "rz") if turns else ()))
        if scale is None:
            scale = [0.02] * 3 + [0.1] * (len(self.names) - 3)
        affine = Affine(self.names, env, scale, 0.0, clip or [-1.0, 1.0], what="column")
        self.low, self.high = affine.low, affine.high
        self.value, self.scale = affine.value, affine.scale
        self._action_for = affine.action_for
        ends = np.abs([affine.value_of(self.low), affine.value_of(self.high)]).min(axis=0)
        self._largest = ends[:3].min(), ends[3:].min(initial=np.inf)

    def largest(self, rate: float) -> tuple[float, float]:
        """The longest translation and rotation along each column, m and rad, times a rate."""
        return float(self._largest[0]) * rate, float(self._largest[1]) * rate

    def action_for(self, shift: Floats, turn: Floats) -> Floats:
        """(n, A) the actions nearest to motions, (n, 3) metres and (n, 3) rotation vectors."""
        return self._action_for(np.concatenate([shift, turn], axis=1)[:, : len(self.names)])


class RelativePose(MotionColumns):
    """Actions that are motions of a tool from a pose.

    Args:
        solver: The kinematics of the tool.
        env: The environment.
        frame: Of the motion: ``base``, ``world`` or ``tool``, as of `eef_delta_pose`.
        rotation: As of `MotionColumns`.
        scale: Likewise.
        clip: Likewise.
    """

    def __init__(
        self,
        solver: ArmSolver,
        env: TermContext,
        frame: Literal["base", "world", "tool"],
        rotation: Literal["command", "keep", "free"],
        scale: PerJoint | None,
        clip: JointClip | None,
    ) -> None:
        super().__init__(env, rotation, scale, clip)
        self._solver, self._frame, self._rotation = solver, frame, rotation

    def motion_for(self, quat: Floats, shift: Floats, turn: Floats) -> Floats:
        """(n, A) the actions nearest to motions in the environment's axes.

        Args:
            quat: (n, 4) orientation of the tool.
            shift, turn: (n, 3) metres and (n, 3) rotation vectors.
        """
        shift, turn = in_axes(self._solver, self._frame, quat, shift, turn)
        return self.action_for(shift, turn)

    def asked(
        self, action: torch.Tensor, pos: Floats, quat: Floats
    ) -> tuple[Floats, Floats | None]:
        """The poses that actions (N, A) ask for, from poses (N, 3), (N, 4).

        Returns:
            Position (N, 3) and orientation (N, 4) or None, if that is free.
        """
        value = self.value(action).astype(np.float64)
        shift = contiguous(value[:, :3])
        turn = None
        if self._rotation == "command":
            turn = rotvec_to_quat(value[:, 3:])
        if self._frame == "tool":
            moved = pos + quat_rotate(quat, shift)
            turned = quat if turn is None else quat_multiply(quat, turn)
        else:
            if self._frame == "base":
                root = self._solver.root_pose()[1]
                shift = quat_rotate(root, shift)
                if turn is not None:
                    turn = quat_multiply(quat_multiply(root, turn), quat_conjugate(root))
            moved = pos + shift
            turned = quat if turn is None else quat_multiply(turn, quat)
        return moved, None if self._rotation == "free" else turned

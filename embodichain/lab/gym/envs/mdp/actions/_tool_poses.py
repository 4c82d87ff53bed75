"""Poses that an action asks of a tool: `AbsolutePose`, `RelativePose` and its `MotionColumns`.

Poses are in the environment's frame, unless a name says otherwise; quaternions are wxyz.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal

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
    from embodichain.lab.sim.objects.articulation import Articulation
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
_QUATERNION = ("qw", "qx", "qy", "qz")
_ANGLES = ("roll", "pitch", "yaw")
_ROTATION_VECTOR = ("rx", "ry", "rz")
_USUAL_SHIFT = 0.02
"""Metres per unit of action where no scale is set."""
_USUAL_TURN = 0.1
"""Rad, likewise."""


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
        asset: Articulation,
        solver: ArmSolver,
        env: TermContext,
        frame: Literal["base", "world"],
        rotation: Literal["quat", "rpy", "keep", "free"],
        position_range: Box3 | None,
    ) -> None:
        self._solver = solver
        self._is_world = frame == "world"
        self._rotation = rotation
        self._of = env.arrays.of

        root_pos = np.zeros(3)
        if self._is_world:
            root_pos = np.asarray(asset.index.pos0, np.float64)
        if position_range is None:
            low = root_pos - solver.chain.reach
            high = root_pos + solver.chain.reach
        else:
            low, high = np.asarray(position_range, np.float64)
        rotation_names: tuple[str, ...] = ()
        rotation_bound = 0.0
        if rotation == "quat":
            rotation_names = _QUATERNION
            rotation_bound = 1.0
        elif rotation == "rpy":
            rotation_names = _ANGLES
            rotation_bound = np.pi
        self.names = (*_PLACE, *rotation_names)
        bounds = np.full(len(rotation_names), rotation_bound)
        self.low: NDArray[np.float32] = np.concatenate([low, -bounds]).astype(np.float32)
        self.high: NDArray[np.float32] = np.concatenate([high, bounds]).astype(np.float32)

        initial_qpos = np.asarray(asset.parsed.init_qpos, np.float64)[None]
        pos, quat = solver.forward_in_root(initial_qpos, np.zeros(1, np.int64))
        if self._is_world:
            root_quat = np.asarray(asset.index.quat0, np.float64)[None]
            pos = root_pos + quat_rotate(root_quat, pos)
            quat = quat_multiply(root_quat, quat)
        self.home: Floats = self.action_at(pos, quat)[0]
        self._initial_quat: Floats = env.arrays.put(np.tile(quat, (env.num_envs, 1)))

    def action_at(self, pos: Floats, quat: Floats) -> Floats:
        """(n, A) the action for a pose (n, 3), (n, 4) in `frame`."""
        rotation = quat[:, :0]  # no columns
        if self._rotation == "quat":
            rotation = quat
        elif self._rotation == "rpy":
            rotation = quat_to_rpy(quat)
        action = np.concatenate([pos, rotation], axis=1)
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
        value = np.minimum(np.maximum(self._of(action), self.low), self.high).astype(np.float64)
        pos = contiguous(value[:, :3])
        rotation = contiguous(value[:, 3:])
        quat: Floats | None = None
        if self._rotation == "keep":
            quat = self._initial_quat
        elif self._rotation == "rpy":
            # About fixed axes, roll first: the inverse of the intrinsic rotations by -rpy.
            quat = quat_conjugate(euler_xyz_to_quat(-rotation))
        elif self._rotation == "quat":
            quat = _normalize(rotation, orientation)
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
        if self._is_world:
            return pos, quat
        root_pos, root_quat = self._solver.root_pose()
        if quat is not None:
            quat = quat_multiply(root_quat, quat)
        return root_pos + quat_rotate(root_quat, pos), quat

    def in_frame(self, pos: Floats, quat: Floats) -> tuple[Floats, Floats]:
        """Poses (N, 3), (N, 4) of the environment's frame in `frame`."""
        if self._is_world:
            return pos, quat
        root_pos, root_quat = self._solver.root_pose()
        to_root = quat_conjugate(root_quat)
        return quat_rotate(to_root, pos - root_pos), quat_multiply(to_root, quat)


def _normalize(quat: Floats, orientation: Callable[[], Floats]) -> Floats:
    """(N, 4) unit quaternions; those of `orientation` where one is 0."""
    squares = quat * quat
    norm = np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2] + squares[:, 3])
    is_zero = norm < 1e-6
    unit: Floats = quat / np.where(is_zero, 1.0, norm)[:, None]
    if may_be_set(is_zero):
        unit = np.where(is_zero[:, None], orientation(), unit)
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
    axes = quat
    if frame == "base":
        _, axes = solver.root_pose()
    to_frame = quat_conjugate(axes)
    return quat_rotate(to_frame, shift), quat_rotate(to_frame, turn)


def motion_between(
    start: tuple[Floats, Floats], pos: Floats, quat: Floats
) -> tuple[Floats, Floats]:
    """Translation (n, 3) and rotation vector (n, 3) from a pose to another, in their frame."""
    start_pos, start_quat = start
    return pos - start_pos, quat_to_rotvec(quat_multiply(quat, quat_conjugate(start_quat)))


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
        self.names: tuple[str, ...] = _PLACE
        if rotation == "command":
            self.names = (*_PLACE, *_ROTATION_VECTOR)
        if scale is None:
            scale = [_USUAL_SHIFT] * 3 + [_USUAL_TURN] * (len(self.names) - 3)
        affine = Affine(
            names=self.names,
            env=env,
            scale=scale,
            offset=0.0,
            clip=clip or [-1.0, 1.0],
            what="column",
        )
        self.low = affine.low
        self.high = affine.high
        self.value = affine.value
        self.scale = affine.scale
        self._action_for = affine.action_for
        # In both directions, so the smaller of the two bounds.
        lengths = np.abs([affine.value_of(self.low), affine.value_of(self.high)]).min(axis=0)
        self._longest_shift = float(lengths[:3].min())
        self._longest_turn = float(lengths[3:].min(initial=np.inf))

    def largest(self, rate: float) -> tuple[float, float]:
        """The longest translation and rotation along each column, m and rad, times a rate."""
        return self._longest_shift * rate, self._longest_turn * rate

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
        self._solver = solver
        self._frame = frame
        self._rotation = rotation

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
        turn: Floats | None = None
        if self._rotation == "command":
            turn = rotvec_to_quat(value[:, 3:])
        if self._frame == "tool":
            pos = pos + quat_rotate(quat, shift)
            if turn is not None:
                quat = quat_multiply(quat, turn)
        else:
            if self._frame == "base":
                _, root_quat = self._solver.root_pose()
                shift = quat_rotate(root_quat, shift)
                if turn is not None:
                    # The same rotation, about axes of the environment.
                    turn = quat_multiply(quat_multiply(root_quat, turn), quat_conjugate(root_quat))
            pos = pos + shift
            if turn is not None:
                quat = quat_multiply(turn, quat)
        return pos, None if self._rotation == "free" else quat

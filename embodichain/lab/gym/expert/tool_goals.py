"""`ToolGoals`: the pose of the tool that a `Goal` asks for, from what is measured now."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.expert.arms import ControlledArm, DeclaredArm, find_arm
from embodichain.lab.gym.expert.instructions import Facing, Goal, Move, Oriented, Target
from embodichain.lab.gym.expert.targets import WORLD, TargetPoses
from embodichain.lab.gym.expert.trajectories import ToolPath, length
from embodichain.utils.errors import Problem
from embodichain.utils.math import (
    euler_xyz_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_rotate,
    quat_to_matrix,
    rotvec_to_quat,
)

if TYPE_CHECKING:
    from embodichain.lab.gym.expert.fingers import Fingers
    from embodichain.lab.gym.expert.grasps import Grasp
    from embodichain.lab.gym.expert.reading import ParsedStep
    from embodichain.lab.sim.engine.api import F64
    from embodichain.utils.array_types import EnvIds

__all__ = ["ToolGoals", "check_orientations"]

_NO_TURN = (1.0, 0.0, 0.0, 0.0)
_VERTICAL = 0.7
"""The z component of an axis that counts as vertical."""


class ToolGoals:
    """Computes where one arm's tool has to be.

    Args:
        arm: The arm.
        path: Its tool, measured, and where its path has led.
        fingers: Those of its gripper.
        grasp: What its gripper holds.
        targets: Poses of the targets.
    """

    def __init__(
        self,
        arm: ControlledArm,
        path: ToolPath,
        fingers: Fingers,
        grasp: Grasp,
        targets: TargetPoses,
    ) -> None:
        self._arm = arm
        self._path = path
        self._fingers = fingers
        self._grasp = grasp
        self._targets = targets

    def pose(self, goal: Goal, env_ids: EnvIds, turns: int = 0) -> tuple[F64, F64]:
        """Position (n, 3) and orientation (n, 4) of the tool for a goal, in n environments.

        Of the directions of a `Facing` that are as good, `turns` picks one: 0 is the nearest.
        """
        tool_pos = self._path.path_pos[env_ids]
        tool_quat = self._path.path_quat[env_ids]
        pos = tool_pos
        axes = tool_quat
        if goal.target is not None:
            target_pos, target_quat = self._targets(goal.target)
            pos = target_pos[env_ids]
            axes = target_quat[env_ids]
        if goal.beyond is not None:
            direction = self._direction(goal.target or WORLD, goal.beyond.start, env_ids)
            pos = pos + goal.beyond.distance * direction
        if goal.axes == "world":
            axes = np.tile(_NO_TURN, (len(env_ids), 1))
        elif goal.axes == "tool":
            axes = tool_quat
        pos = pos + quat_rotate(axes, np.tile(goal.offset, (len(env_ids), 1)))
        pos = pos + np.array([0.0, 0.0, goal.above])

        held_pos, held_quat = self._held_pose(goal, env_ids)
        quat = tool_quat
        if isinstance(goal.turn, Oriented):
            # About fixed axes, roll first: the inverse of the intrinsic rotations by -rpy.
            rotation = quat_conjugate(euler_xyz_to_quat(-np.asarray(goal.turn.rpy, np.float64)))
            quat = quat_multiply(axes, np.tile(rotation, (len(env_ids), 1)))
        elif goal.turn is not None and self._arm.term.orientation == "any":
            facing = quat_multiply(tool_quat, held_quat)
            if not goal.held:
                facing = self._fingers_along_x(facing)
            rotation = self._rotation_to(goal.turn, facing, tool_quat, env_ids, turns)
            quat = quat_multiply(rotation, tool_quat)
        # What is held, or the point ahead of the tool, is at the place: the tool is behind it.
        back = goal.back + (self._fingers.length if goal.tips else 0.0)
        held_offset = held_pos + np.tile([0.0, 0.0, back], (len(env_ids), 1))
        return pos - quat_rotate(quat, held_offset), quat

    def _fingers_along_x(self, quat: F64) -> F64:
        """(n, 4) orientations whose x axis is the line along which the tool's fingers move."""
        if not self._fingers.angle:
            return quat
        turn = rotvec_to_quat(np.array([0.0, 0.0, self._fingers.angle]))
        return quat_multiply(quat, np.tile(turn, (len(quat), 1)))

    def _direction(self, target: Target, start: Target, env_ids: EnvIds) -> F64:
        """(n, 3) horizontal unit vectors, away from another target through a target."""
        end_pos, _ = self._targets(target)
        start_pos, _ = self._targets(start)
        way = (end_pos - start_pos)[env_ids]
        way[:, 2] = 0.0
        return way / np.maximum(length(way), 1e-9)[:, None]

    def _held_pose(self, goal: Goal, env_ids: EnvIds) -> tuple[F64, F64]:
        """Pose of what is held in the tool's frame, (n, 3), (n, 4); none without `goal.held`."""
        pos = np.zeros((len(env_ids), 3))
        quat = np.tile(_NO_TURN, (len(env_ids), 1))
        if not goal.held:
            return pos, quat
        to_tool = quat_conjugate(self._path.quat[env_ids])
        held = self._grasp.object[env_ids]
        for number in np.unique(held):
            holds_this = held == number
            target_pos, target_quat = self._targets(self._grasp.objects[number])
            way = target_pos[env_ids][holds_this] - self._path.pos[env_ids][holds_this]
            pos[holds_this] = quat_rotate(to_tool[holds_this], way)
            quat[holds_this] = quat_multiply(to_tool[holds_this], target_quat[env_ids][holds_this])
        return pos, quat

    def _rotation_to(
        self, turn: Facing, facing: F64, tool_quat: F64, env_ids: EnvIds, turns: int
    ) -> F64:
        """(n, 4) rotation about the vertical that makes axes parallel to the target's.

        With 0 `turns` the smallest one; each adds the angle between two directions as good.
        """
        _, align_quat = self._targets(turn.target)
        period = 2.0 * np.pi / turn.symmetry
        angle = _heading(align_quat[env_ids]) - _heading(facing) + 0.5 * period
        angle = angle - period * np.floor(angle / period) - 0.5 * period
        if turns:
            angle = angle + period * turns
            angle = angle - 2.0 * np.pi * (angle > np.pi)
        if not turn.level:
            is_upright = np.abs(quat_to_matrix(tool_quat)[:, 2, 2]) > _VERTICAL
            angle = np.where(is_upright, angle, 0.0)
        zero = np.zeros_like(angle)
        return rotvec_to_quat(np.stack([zero, zero, angle], axis=1))


def _heading(quat: F64) -> F64:
    """(n,) rad: direction in the plane of the x axis; if that is steep, of the y axis less 90°."""
    matrix = quat_to_matrix(quat)
    of_x = np.arctan2(matrix[:, 1, 0], matrix[:, 0, 0])
    of_y = np.arctan2(matrix[:, 1, 1], matrix[:, 0, 1]) - 0.5 * np.pi
    return np.where(np.abs(matrix[:, 2, 0]) < _VERTICAL, of_x, of_y)


def check_orientations(
    steps: Sequence[ParsedStep], arms: Sequence[ControlledArm], declared: Sequence[DeclaredArm]
) -> list[Problem]:
    """Return steps that ask for an orientation of an arm whose action does not choose it."""
    problems: list[Problem] = []
    orientation_of = {arm.name: arm.term.orientation for arm in arms}
    for step in steps:
        for part in step.flat():
            if part.inner_steps:  # a step inside another is checked as a part of it
                continue
            for phase in part.phases:
                for arm, instructions in phase.items():
                    name = find_arm(arm, declared, part.path).name
                    goals = [item.goal for item in instructions if isinstance(item, Move)]
                    if orientation_of[name] != "any" and any(map(_is_oriented, goals)):
                        message = f"the action {name!r} does not choose the tool's orientation"
                        problems.append(Problem(part.path, message))
    return problems


def _is_oriented(goal: Goal) -> bool:
    """Whether a goal needs an arm that can turn its tool."""
    return isinstance(goal.turn, Oriented) or (isinstance(goal.turn, Facing) and goal.turn.level)

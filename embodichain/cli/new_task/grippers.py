"""`gripper_ends`: where a gripper's joints are when it is open, and when it is closed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from embodichain.cli.new_task.embodied_robot import EmbodiedRobot

__all__ = ["GripperEnds", "finger_gap", "gripper_ends"]

_DEPTHS = (0.0, 0.01, 0.02, -0.01)
"""Distances in metres before the tool at which the gap between the fingers is measured."""


@dataclass(frozen=True)
class GripperEnds:
    """Joint -> position of a gripper, rad or m.

    Attributes:
        open: When it is open.
        close: When it is closed.
    """

    open: dict[str, float]
    close: dict[str, float]


def gripper_ends(robot: EmbodiedRobot) -> GripperEnds | None:
    """The ends of a robot's only gripper; None without one that moves joints by their positions.

    A gripper that actuators of a file move is where the ends of its joints are.
    """
    grippers = getattr(robot.parsed.cfg, "grippers", None) or {}
    if len(grippers) != 1:
        return None
    part, cfg = next(iter(grippers.items()))
    joints = robot.joints_of(part)
    if not joints:
        return None
    if cfg.actuators:
        opened, closed = _ends_of_ranges(robot, joints)
    else:
        opened = _positions(joints, cfg.open)
        closed = _positions(joints, cfg.close)
    return GripperEnds(_clipped(robot, opened), _clipped(robot, closed))


def finger_gap(robot: EmbodiedRobot, ends: GripperEnds) -> float:
    """Distance in metres between the open fingers at the tool; 0 if it cannot be measured."""
    import mujoco

    from embodichain.cli.new_task.tool_point import gap_between_fingers

    fingers = [*robot.frames_of("left_finger")[:1], *robot.frames_of("right_finger")[:1]]
    link_names = set(robot.parsed.link_names)
    if len(fingers) < 2 or not link_names.issuperset(fingers):
        return 0.0
    middles = []
    for positions in (ends.open, ends.close):
        data = mujoco.MjData(robot.model)
        data.qpos[:] = robot.data.qpos
        for name, value in positions.items():
            data.joint(name).qpos = value
        mujoco.mj_kinematics(robot.model, data)
        middles.append(data.body(fingers[1]).xipos - data.body(fingers[0]).xipos)
        if positions is ends.open:
            opened = data
    line = middles[0] - middles[1]
    tool = robot.tool()
    element = opened.site(tool.name) if tool.kind == "site" else opened.body(tool.name)
    axis = element.xmat.reshape(3, 3)[:, 2]
    line = line - axis * (line @ axis)
    length = float(np.linalg.norm(line))
    if length < 1e-6:
        return 0.0
    for depth in _DEPTHS:
        gap = gap_between_fingers(
            robot.model,
            opened,
            point=element.xpos - depth * axis,
            line=line / length,
            fingers=fingers,
        )
        if gap:
            return gap
    return 0.0


def _positions(joints: list[str], value: Any) -> dict[str, float]:
    """Joint -> position of a command: one number, one for each joint, or a map."""
    if isinstance(value, Mapping):
        return {name: float(value[name]) for name in joints if name in value}
    if isinstance(value, (list, tuple)):
        return {name: float(v) for name, v in zip(joints, value, strict=False)}
    return dict.fromkeys(joints, float(value))


def _ends_of_ranges(
    robot: EmbodiedRobot, joints: list[str]
) -> tuple[dict[str, float], dict[str, float]]:
    """The ends of the joints' ranges: open is where the first pose of the file is not closed."""
    import mujoco

    fingers = [*robot.frames_of("left_finger")[:1], *robot.frames_of("right_finger")[:1]]
    ends = []
    for side in (0, 1):
        pose = {name: float(robot.model.joint(name).range[side]) for name in joints}
        data = mujoco.MjData(robot.model)
        data.qpos[:] = robot.data.qpos
        for name, value in pose.items():
            data.joint(name).qpos = value
        mujoco.mj_kinematics(robot.model, data)
        width = 0.0
        if len(fingers) == 2:
            width = float(np.linalg.norm(data.body(fingers[0]).xipos - data.body(fingers[1]).xipos))
        ends.append((width, pose))
    (low_width, low), (high_width, high) = ends
    return (low, high) if low_width > high_width else (high, low)


def _clipped(robot: EmbodiedRobot, positions: Mapping[str, float]) -> dict[str, float]:
    """Positions within the joints' limits."""
    clipped = {}
    for name, value in positions.items():
        joint = robot.model.joint(name)
        low, high = (float(end) for end in joint.range)
        clipped[name] = min(max(value, low), high) if joint.limited[0] else value
    return clipped

"""`draft_reach`: bring the tool to a target."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from embodichain.cli.new_task.guesses import Guess
from embodichain.cli.new_task.new_reach import ToolReach
from embodichain.cli.new_task.task_draft import (
    TaskDraft,
    camera_words,
    joint_map,
    list_of,
    number,
)

if TYPE_CHECKING:
    from embodichain.cli.new_task.embodied_robot import EmbodiedRobot

__all__ = ["draft_reach"]

_HINGE_SCALE = 0.6
"""Angle in rad by which an action of 1 moves a hinge from home."""
_LARGEST_RADIUS = 0.2
"""Largest distance in metres of the target from the tool, along each axis."""
_RADIUS_OF_REACH = 0.25
"""The same as a share of the distance of the tool from the root."""
_NEAR = 0.05
"""Distance in metres of the target that counts as reached, of a large robot."""


def draft_reach(robot: EmbodiedRobot) -> Iterator[TaskDraft]:
    """Yield the task of reaching."""
    joints = robot.joints_of("arm")
    scales = joint_scales(robot, joints, _HINGE_SCALE)
    tool = robot.tool()
    pos = tool.pos(robot.data).copy()
    root = robot.data.body(robot.parsed.root_link_name).xpos
    largest = float(np.clip(_RADIUS_OF_REACH * np.linalg.norm(pos - root), 0.04, _LARGEST_RADIUS))
    axes = np.ones(3)
    reach = ToolReach(robot.model, robot.data, tool, joints, scale=np.array(list(scales.values())))
    radius = reach.radius(robot.qpos_of(joints), largest) or largest
    if reach.axes.any():
        axes = reach.axes.astype(float)
    radius = np.floor(100 * radius + 1e-6) / 100
    near = max(0.005, round(min(_NEAR, 0.5 * radius), 3))
    sensors, guesses = camera_words(robot)
    place = pos + robot.shift
    half = radius * axes
    words = {
        "target": number(min(0.02, 0.4 * near)),
        "place": list_of(np.round(place, 2)),
        "sensors": f"sensors:\n{sensors}" if sensors else "",
        "actions": _ACTIONS.format(scale=joint_map(scales)),
        "joints": "{uid: robot, control_parts: arm}",
        "range": f"[{list_of(0.0 - half)}, {list_of(half)}]",
        "near": number(near),
    }
    why_scale = (
        "an action of 1 turns a hinge by so many rad, and moves a slide by a quarter of its way"
    )
    why_near = f"half of the {radius:g} m by which a target is away, and 5 cm at most"
    guesses += [
        Guess("actions.arm.scale", f"{_HINGE_SCALE:g}", why_scale),
        Guess(
            "target", f"within {radius:g} m of the tool", "the actions reach all of these places"
        ),
        Guess("success", f"within {near:g} m of the target", why_near),
    ]
    yield TaskDraft(words, guesses)


_ACTIONS = """\
actions:                           # joint targets around the initial pose, rad or m
  arm:
    func: joint_action
    params:
      of: {{uid: robot, control_parts: arm}}
      centre: home
      scale: {scale}
      clip: [-1, 1]
"""


def joint_scales(robot: EmbodiedRobot, joints: list[str], hinge: float) -> dict[str, float]:
    """Joint -> displacement for an action of 1, rad; of slides a quarter of their way, m."""
    import mujoco

    scales: dict[str, float] = {}
    for name in joints:
        joint = robot.model.joint(name)
        scales[name] = hinge
        if joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE:
            low, high = (float(value) for value in joint.range)
            span = high - low if joint.limited[0] else 0.4
            scales[name] = float(f"{min(0.1 * hinge / 0.6, 0.25 * span):.1g}")
    return scales

"""`draft_push`: push a cube along the floor onto a disc."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from embodichain.cli.new_task.grippers import gripper_ends
from embodichain.cli.new_task.guesses import Guess
from embodichain.cli.new_task.task_draft import (
    TaskDraft,
    camera_words,
    cube_words,
    list_of,
    number,
    reach_beyond_tool,
    rounded,
)
from embodichain.cli.new_task.work_area import Layout, WorkArea, find_work_areas
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.cli.new_task.embodied_robot import EmbodiedRobot
    from embodichain.cli.new_task.task_draft import ToolShape

__all__ = ["draft_push"]

_CUBE = 0.1
"""Side of the cube in metres, for a size of 1. All other lengths are those of `push_cube`."""
_DENSITY = 2000.0
"""kg/m^3: 2 kg for a cube of 10 cm."""
_WAY = 0.2
"""Distance from the cube to the disc, m."""
_NEAR = 0.08
"""Distance in metres of the cube's middle from that of the disc that counts as success."""
_DISC_HEIGHT = 0.001
"""Height in metres of the disc's middle."""
_STEP = 0.02
"""The largest motion of the tool in a control step, m."""
_ABOVE_FLOOR = 0.01
"""Height in metres of the hand's lowest point."""
_ENOUGH_JOINTS = 5
"""Joints with which a tool can keep pointing down."""


def draft_push(robot: EmbodiedRobot) -> Iterator[TaskDraft]:
    """Yield tasks of pushing, the largest work area first.

    Raises:
        ConfigError: If the hand has no shape that touches the cube.
    """
    joints = robot.joints_of("arm")
    tool = robot.tool()
    ends = gripper_ends(robot)
    closed = ends.close if ends else {}
    shape = reach_beyond_tool(robot, closed)
    if not shape.touches:
        message = f"push needs a hand that touches the cube, and nothing of {tool.name} collides"
        hint = "fix a stick on it with `attachments` of the embodiment"
        raise ConfigError(f"{message}: {hint}, docs/robots.md#attachments")
    sensors, camera_guesses = camera_words(robot)

    def layout(size: float) -> Layout:
        return _layout(size, shape)

    areas = find_work_areas(
        robot,
        joints,
        tool,
        layout,
        range_of=lambda names: np.full(len(names), np.inf),
        down_only=False,
    )
    for area in areas:
        words, guesses = _words(robot, area, shape, closed)
        words["sensors"] = f"sensors:\n{sensors}" if sensors else ""
        yield TaskDraft(words, [*guesses, *camera_guesses])


def _beside(size: float, shape: ToolShape) -> float:
    """Distance in metres of the tool from the middle of the cube at first: it touches at no yaw."""
    return 0.5 * np.sqrt(2.0) * _CUBE * size + shape.aside + 0.05 * size


def _layout(size: float, shape: ToolShape) -> Layout:
    """Where the tool begins, and the corners of where it gets."""
    cube_y = -0.03 * size
    tool_y = cube_y - _beside(size, shape)
    aside = 0.06 * size + 0.4 * shape.aside
    ends_y = (tool_y - 0.02 * size, cube_y + (_WAY + 0.05) * size - 0.5 * _CUBE * size)
    places = tuple((x, y, 0.0) for x in (-aside, 0.0, aside) for y in ends_y)
    return Layout((0.0, tool_y, 0.0), places, shape.beyond + _ABOVE_FLOOR + 0.01 * size)


def _words(
    robot: EmbodiedRobot, area: WorkArea, shape: ToolShape, closed: dict[str, float]
) -> tuple[dict[str, str], list[Guess]]:
    """The template's variables for a work area."""
    size = area.size
    cube = rounded(_CUBE * size)
    near = rounded(_NEAR * size)
    disc = round(near + 0.5 * cube, 3)
    x = round(area.x, 2)
    cube_y = round(-0.03 * size, 3)
    goal_y = round(cube_y + _WAY * size, 3)
    tool_height = float(area.tool[2])
    keeps = area.points_down and len(area.qpos) >= _ENOUGH_JOINTS
    bounds = [
        [x - 0.4 * size, cube_y - 0.4 * size, -0.1],
        [x + 0.4 * size, goal_y + 0.4 * size, 0.5],
    ]
    words = {
        **cube_words(robot, area, closed, cube=cube, density=_DENSITY),
        "cube_place": list_of([x, cube_y, 0.5 * cube]),
        "goal_place": list_of([x, goal_y, _DISC_HEIGHT]),
        "cube_range": _box(0.03 * size, 0.02 * size),
        "goal_range": _box(0.05 * size, 0.05 * size),
        "near": number(near),
        "above_goal": number(0.5 * cube - _DISC_HEIGHT),
        "disc": number(disc),
        "rotation": "keep" if keeps else "free",
        "step": number(rounded(_STEP * size)),
        "step_z": number(rounded(0.25 * _STEP * size)),
        "touching": number(rounded(0.15 * size)),
        "nearing": number(rounded(0.15 * size)),
        "bounds": f"[{list_of(bounds[0])}, {list_of(bounds[1])}]",
        "behind": number(round(0.5 * cube + 0.6 * shape.aside, 3)),
        "clearance": number(round(0.7 * shape.aside + 0.04 * size, 3)),
        "height": number(round(tool_height - 0.5 * cube, 3)),
    }
    down = "points down" if area.points_down else "cannot point down"
    why_cube = "as in push_cube: this robot works in as large an area"
    if size != 1:
        why_cube = f"{size:g} times that of push_cube, and so is the area in which the robot works"
    guesses = [
        Guess("cube", f"{cube:g} m", why_cube),
        Guess("place", f"x = {x:g} m", "the middle of what the tool reaches on the floor"),
        Guess(
            "tool", f"{100 * tool_height:.1f} cm high", f"its end is above the floor, and it {down}"
        ),
        Guess("success", f"within {100 * near:g} cm", "middle to middle: the cube is on the disc"),
    ]
    return words, guesses


def _box(x: float, y: float) -> str:
    return f"[{list_of([-x, -y, 0])}, {list_of([x, y, 0])}]"

"""`draft_pick`: grasp a cube and carry it to a point in the air."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from embodichain.cli.new_task.grippers import finger_gap, gripper_ends
from embodichain.cli.new_task.guesses import Guess
from embodichain.cli.new_task.kind_reach import joint_scales
from embodichain.cli.new_task.task_draft import (
    TaskDraft,
    camera_words,
    cube_words,
    joint_map,
    list_of,
    number,
    reach_beyond_tool,
    rounded,
)
from embodichain.cli.new_task.work_area import Layout, find_work_areas

if TYPE_CHECKING:
    from embodichain.cli.new_task.embodied_robot import EmbodiedRobot

__all__ = ["draft_pick"]

_HINGE_SCALE = 0.5
"""Angle in rad by which an action of 1 moves a hinge; the action goes up to 2."""
_LARGEST_CUBE = 0.05
"""m."""
_SMALLEST_CUBE = 0.012
"""m."""
_SHARE_OF_GAP = 0.6
"""Side of the cube as a share of the gap between the fingers: it may be turned by 10 degrees."""
_DENSITY = 800.0
"""kg/m^3: 0.1 kg for a cube of 5 cm, as in `lift_cube`."""
_ABOVE_FLOOR = 0.004
"""Distance in metres of the fingers' ends from the floor, at least."""


def draft_pick(robot: EmbodiedRobot) -> Iterator[TaskDraft]:
    """Yield tasks of picking, the largest work area first."""
    joints = robot.joints_of("arm")
    ends = gripper_ends(robot)
    gap = finger_gap(robot, ends) if ends else 0.0
    beyond = max(0.0, reach_beyond_tool(robot, ends.close if ends else {}).beyond)
    cube = rounded(float(np.clip(_SHARE_OF_GAP * gap, _SMALLEST_CUBE, _LARGEST_CUBE)))
    if not gap:
        cube = 0.03
    why_cube = f"0.6 of the {100 * gap:.1f} cm between the open fingers, and 5 cm at most"
    if not gap:
        why_cube = "the gap between the fingers could not be measured"
    grasp_height = max(0.0, beyond + _ABOVE_FLOOR - 0.5 * cube)
    sensors, camera_guesses = camera_words(robot)

    scales = joint_scales(robot, joints, _HINGE_SCALE)
    opened = ends.open if ends else {}

    def layout(size: float) -> Layout:
        above = 0.5 * cube + grasp_height
        corners = [
            (x * size, y * size, z)
            for x in (-0.1, 0.1)
            for y in (-0.15, 0.15)
            for z in (above, above + 0.2 * size + 0.05)
        ]
        return Layout((0.0, 0.0, above + 0.15 * size + 0.03), tuple(corners), 0.0)

    areas = find_work_areas(
        robot,
        joints,
        robot.tool(),
        layout,
        range_of=lambda names: np.array([2.0 * scales[name] for name in names]),
        down_only=True,
    )
    for area in areas:
        size = area.size
        x = round(area.x, 2)
        near = rounded(min(0.05, max(0.02, 0.05 * size)))
        half = [0.1 * size, 0.15 * size]
        goal_z = 0.5 * cube + 0.1 * size + 0.05
        words = {
            **cube_words(robot, area, opened, cube=cube, density=_DENSITY),
            "target": number(rounded(0.4 * near)),
            "cube_place": list_of([x, 0, 0.5 * cube]),
            "goal_place": list_of([x, 0, round(goal_z, 3)]),
            "cube_range": f"[{list_of([-half[0], -half[1], 0])}, {list_of([*half, 0])}]",
            "goal_range": f"[{list_of([-half[0], -half[1], -0.08 * size])}, "
            f"{list_of([*half, 0.08 * size])}]",
            "turn": "45" if len(joints) > 4 else "0",
            "scale": joint_map(scales),
            "near": number(near),
            "grasp_height": number(round(grasp_height, 4)),
            "approach": number(rounded(max(0.04, 0.1 * size))),
            "sensors": sensors,
        }
        guesses = [
            Guess("cube", f"{cube:g} m", why_cube),
            Guess("place", f"x = {x:g} m", "the middle of what the tool reaches pointing down"),
            Guess(
                "places",
                f"{2 * half[0]:g} x {2 * half[1]:g} m",
                "the cube and its goal are drawn there, and the tool reaches all of it",
            ),
        ]
        yield TaskDraft(words, [*guesses, *camera_guesses])

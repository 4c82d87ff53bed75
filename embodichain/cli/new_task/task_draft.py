"""`TaskDraft`: the words of a new task's template, and the parts that several kinds share."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from embodichain.cli.new_task.guesses import Guess
from embodichain.cli.new_task.tool_point import body_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.cli.new_task.embodied_robot import EmbodiedRobot
    from embodichain.cli.new_task.work_area import WorkArea

    F64 = NDArray[np.float64]

__all__ = [
    "TaskDraft",
    "ToolShape",
    "camera_words",
    "cube_words",
    "joint_map",
    "list_of",
    "number",
    "reach_beyond_tool",
    "rounded",
]


@dataclass(frozen=True)
class TaskDraft:
    """A task of a kind for a robot, before its time step is known.

    Attributes:
        words: The template's variables.
        guesses: What was guessed of the task, for people.
    """

    words: Mapping[str, str]
    guesses: Sequence[Guess]


def rounded(value: float, digits: int = 2) -> float:
    """A number with so many significant digits, for people to read and change."""
    if value == 0 or not math.isfinite(value):
        return value
    return float(f"{value:.{digits}g}")


def number(value: float) -> str:
    """A number as YAML, without trailing zeros."""
    return f"{round(float(value), 4) + 0.0:g}"


def list_of(values: Iterable[float]) -> str:
    """Numbers as a list in YAML."""
    return f"[{', '.join(map(number, values))}]"


def joint_map(values: Mapping[str, float]) -> str:
    """Joint -> number as YAML, one key for each joint."""
    items = [f"{json.dumps(re.escape(name))}: {number(value)}" for name, value in values.items()]
    return f"{{{', '.join(items)}}}"


def _first_positions(robot: EmbodiedRobot, changes: Mapping[str, float]) -> str:
    """`init_qpos` as YAML with some joints elsewhere, in the form that the embodiment has.

    A list cannot be merged with a map.
    """
    parsed = robot.parsed
    if isinstance(parsed.cfg.init_qpos, Mapping):
        items = [
            f"{json.dumps(re.escape(name))}: {round(value, 6) + 0.0:.7g}"
            for name, value in changes.items()
        ]
        return f"{{{', '.join(items)}}}"
    values = [
        changes.get(name, float(value))
        for name, value in zip(parsed.joint_names, parsed.init_qpos, strict=True)
    ]
    return f"[{', '.join(f'{round(value, 6) + 0.0:.7g}' for value in values)}]"


def _tool_keys(robot: EmbodiedRobot) -> str:
    """The key by which a reference names the tool."""
    return "site: tool" if robot.tool().kind == "site" else "link: tool"


def camera_words(robot: EmbodiedRobot) -> tuple[str, list[Guess]]:
    """The sensors of the cameras on a robot's wrist, as YAML, and the guesses."""
    lines = []
    guesses = []
    for name in robot.cameras:
        word = re.sub(r"\W+", "_", name).strip("_") or "camera"
        lines += [
            f"  {word}:  # costs nothing until a term reads it: {{func: camera_image, params: "
            f"{{sensor: {word}}}}}",
            "    sensor_type: camera",
            f"    camera: robot/{name}",
            "    width: 64",
            "    height: 64",
        ]
        guesses.append(Guess(f"sensors.{word}", name, "a camera of the file, on the wrist"))
    return "".join(f"{line}\n" for line in lines), guesses


def cube_words(
    robot: EmbodiedRobot,
    area: WorkArea,
    gripper: Mapping[str, float],
    *,
    cube: float,
    density: float,
) -> dict[str, str]:
    """The template's variables of tasks in which a tool begins near a cube.

    Args:
        robot: The robot.
        area: Where the tool works.
        gripper: First positions of the gripper's joints, rad or m.
        cube: Side of the cube, m.
        density: Its density, kg/m^3.
    """
    return {
        "init_qpos": _first_positions(robot, {**area.qpos, **gripper}),
        "tool_place": list_of(np.round(area.tool, 3)),
        "tool_keys": _tool_keys(robot),
        "cube": number(cube),
        "mass": number(rounded(density * cube**3)),
    }


@dataclass(frozen=True)
class ToolShape:
    """How far the shapes of a hand reach from its tool.

    Attributes:
        beyond: Metres along the tool's z axis, negative where they end before the tool.
        aside: Metres across it, of what is within 3 cm of the end.
        touches: Whether a shape collides at all.
    """

    beyond: float
    aside: float
    touches: bool


_END = 0.03
"""Length of the end of a hand that touches what it pushes, m."""


def reach_beyond_tool(robot: EmbodiedRobot, joints: Mapping[str, float]) -> ToolShape:
    """Measure the shapes that the hand and what it carries collide with.

    Args:
        robot: The robot.
        joints: Positions of the gripper's joints, rad or m.
    """
    import mujoco

    from embodichain.cli.new_task.tool_point import corners_of, subtree_of

    model = robot.model
    data = mujoco.MjData(model)
    data.qpos[:] = robot.data.qpos
    for name, value in joints.items():
        data.joint(name).qpos = value
    mujoco.mj_kinematics(model, data)
    tool = robot.tool()
    element = data.site(tool.name) if tool.kind == "site" else data.body(tool.name)
    body = body_of(model, tool)
    while body and not model.body_jntnum[body]:
        body = int(model.body_parentid[body])
    bodies = subtree_of(model, body)
    points = corners_of(model, data, bodies)
    is_of_hand = np.isin(model.geom_bodyid, bodies)
    is_solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    local = (points - element.xpos) @ element.xmat.reshape(3, 3)
    beyond = float(local[:, 2].max())
    at_end = local[local[:, 2] > beyond - _END]
    aside = float(np.median(np.hypot(at_end[:, 0], at_end[:, 1])))
    return ToolShape(beyond, min(aside, 0.1), bool((is_of_hand & is_solid).any()))

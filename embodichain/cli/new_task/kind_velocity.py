"""`draft_velocity`: walk as a velocity command says."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from embodichain.cli.new_task.guesses import Guess
from embodichain.cli.new_task.legs import (
    Leg,
    feet_above_trunk,
    foot_origin,
    foot_position,
    legs_with_feet,
    trot_phases,
)
from embodichain.cli.new_task.new_home import lowest_point
from embodichain.cli.new_task.task_draft import (
    TaskDraft,
    camera_words,
    joint_map,
    list_of,
    number,
    rounded,
)
from embodichain.cli.new_task.tool_point import corners_of
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.cli.new_task.embodied_robot import EmbodiedRobot

    F64 = NDArray[np.float64]

__all__ = ["draft_velocity"]

_GO2_HEIGHT = 0.34
"""Height of the trunk of a Unitree Go2, m, for which the numbers of `quadruped_velocity` are."""
_GO2_WEIGHT = 147.0
"""Its weight, N."""
_SCALE = 0.25
"""Angle in rad by which an action of 1 moves a joint from home."""
_ROLLS = 0.7
"""Least x component of the axis of a joint that moves a leg sideways."""
_SPARE = 0.011
"""Height in metres up to which a robot may begin above the ground or in it: that of rounding."""
_EYE = 2.4
"""Least distance of the camera from a robot, by half of the robot's diagonal."""
_MIRRORED = 0.02
"""Error in metres, and of axes, up to which a left leg is the mirror image of a right one."""


def draft_velocity(robot: EmbodiedRobot) -> Iterator[TaskDraft]:
    """Yield the task of walking.

    Raises:
        ConfigError: If the feet are not below the trunk in the first pose, so that the robot lies.
    """
    legs = legs_with_feet(robot.model, robot.data, robot.frames_of("feet"))
    _check_that_it_stands(robot, legs)
    joints = robot.joints_of("legs")
    model = robot.model
    data = robot.data
    feet = np.array([foot_origin(data, leg) for leg in legs])
    ground = lowest_point(model, data)
    height = float(data.body(robot.parsed.root_link_name).xpos[2]) - ground
    pace = float(np.sqrt(height / _GO2_HEIGHT))
    rolls = any(abs(float(data.xaxis[model.joint(name).id, 0])) > _ROLLS for name in joints)
    ahead = rounded(pace, 1)
    turning = 1.0 if rolls else 0.5
    period = rounded(0.5 * pace)
    phases = trot_phases(data, legs)
    swing = rounded(0.06 * height / _GO2_HEIGHT)
    weight = 9.81 * float(model.body_subtreemass[0])
    effort = (_GO2_WEIGHT * _GO2_HEIGHT / (weight * height)) ** 2
    mirror = _mirror(robot, legs, joints)
    body = ["base", *(name for name in ("thighs",) if name in robot.names)]
    sensors, camera_guesses = camera_words(robot)
    gait = _gait_of(legs)
    eye = _eye(robot, height)
    placement, placement_guesses = _placement(robot, ground)
    words = {
        "placement": placement,
        "far": number(rounded(eye[0])),
        "aside": number(rounded(eye[1])),
        "above": number(rounded(eye[2])),
        "body": ", ".join(body),
        "sensors": sensors,
        "scale": joint_map(dict.fromkeys(joints, _SCALE)),
        "ahead": list_of([-ahead, ahead]),
        "sideways": list_of([-ahead, ahead] if rolls else [0, 0]),
        "pushed": list_of([-0.5 * ahead, 0.5 * ahead]),
        "turning": list_of([-turning, turning]),
        "period": number(period),
        "effort_weight": f"{-4e-6 * effort:.1e}",
        "gait": gait,
        "swing": number(swing),
        "width": number(rounded(0.6 * swing)),
        "rest": number(round(max(0.0, float(feet[:, 2].mean()) - ground), 3)),
        "phases": joint_map({leg.foot: p for leg, p in zip(legs, phases, strict=True)}),
        "lying": number(rounded(0.45 * height)),
        "within": number(rounded(max(0.1, 0.3 * ahead))),
        "symmetry": mirror,
        "symmetric": "true" if mirror else "false",
    }
    guesses = [
        Guess(
            "commands",
            f"{ahead:g} m/s",
            f"the pace of a Go2 for a trunk {height:.2f} m above the ground",
        ),
        Guess("rewards.gait", f"{period:g} s", f"the period of {gait}"),
        Guess(
            "terminations.lying",
            f"{0.45 * height:.2g} m",
            "lower, the robot lies: 0.45 of the first height of its trunk",
        ),
    ]
    if mirror:
        guesses.append(Guess("symmetry", "left and right", "each leg has a mirror image"))
    else:
        guesses.append(Guess("symmetry", "none", "not every leg has a mirror image"))
    if not rolls:
        why = "no joint moves a leg sideways: lin_vel_y is 0, and it turns slowly"
        guesses.append(Guess("commands.sideways", "0", why))
    yield TaskDraft(words, [*placement_guesses, *guesses, *camera_guesses])


def _check_that_it_stands(robot: EmbodiedRobot, legs: list[Leg]) -> None:
    """Refuse a robot whose trunk lies on the ground in its first pose."""
    lying = feet_above_trunk(robot.model, robot.data, legs, robot.parsed.root_link_name)
    if not lying:
        return
    name = robot.embodiment.name
    feet = ", ".join(leg.foot for leg in lying)
    joints = ", ".join(dict.fromkeys(joint for leg in lying for joint in leg.joints))
    path = f"conf/embodiment/{name}.yaml"
    message = f"velocity needs a pose in which {name} stands, and in the first one these feet are "
    message += f"not below its trunk: {feet}. Give init_qpos for {joints} in {path}"
    if robot.embodiment.is_new:
        message += f", which `embodichain new embodiment {name} --robot FILE` writes"
    raise ConfigError(f"{message}; the height above the ground follows from it")


def _gait_of(legs: list[Leg]) -> str:
    """The gait that `trot_phases` gives, for people."""
    if len(legs) == 2:
        return "steps: left and right in turn"
    if len(legs) == 4:
        return "a trot: diagonal feet together"
    if len(legs) == 6:
        return "a tripod: two outer feet and the middle one across"
    return "steps: neighbours on each side in turn, and opposite feet"


def _eye(robot: EmbodiedRobot, height: float) -> F64:
    """(3,) ahead, aside and above: from where the camera sees the trunk and all of the legs, m."""
    eye = height * np.array([3.5, 2.6, 1.2])
    corners = corners_of(robot.model, robot.data, range(1, robot.model.nbody))
    diagonal = float(np.linalg.norm(np.ptp(corners, axis=0)))
    return eye * max(1.0, _EYE * 0.5 * diagonal / float(np.linalg.norm(eye)))


def _placement(robot: EmbodiedRobot, ground: float) -> tuple[str, list[Guess]]:
    """The robot's place as YAML where its embodiment has a height that is not that of its pose."""
    is_written_here = bool(robot.embodiment.text)
    if not (ground < -_SPARE or (is_written_here and ground > _SPARE)):
        return "", []
    x, y, z = robot.parsed.placement.root_pos
    where = f"{100 * abs(ground):.0f} cm {'in' if ground < 0 else 'above'} the ground"
    place = list_of([x, y, np.ceil(100 * (z - ground) - 1e-6) / 100])
    text = f"robot:\n  init_pos: {place}  # the lowest point of its first pose is on the ground\n"
    why = f"with its init_pos {robot.embodiment.name} would begin {where}"
    return text, [Guess("robot.init_pos", place, why)]


def _mirror(robot: EmbodiedRobot, legs: list[Leg], joints: list[str]) -> str:
    """The section `symmetry`, empty if a leg has no mirror image."""
    model = robot.model
    data = robot.data
    pairs: dict[str, str] = {}
    opposite: list[str] = []
    root = data.body(robot.parsed.root_link_name)
    for leg in legs:
        place = _mirrored(foot_position(data, leg) - root.xpos)
        if place[1] > 0:  # its left counterpart adds the pair
            continue
        others = [
            other
            for other in legs
            if np.abs(foot_position(data, other) - root.xpos - place).max() < _MIRRORED
        ]
        if len(others) != 1 or len(others[0].joints) != len(leg.joints):
            return ""
        for left, right in zip(leg.joints, others[0].joints, strict=True):
            left_axis = data.xaxis[model.joint(left).id]
            right_axis = data.xaxis[model.joint(right).id]
            # A rotation's axis is mirrored like the moment of a force: y stays.
            image = left_axis * [-1.0, 1.0, -1.0]
            if np.abs(image - right_axis).max() < _MIRRORED:
                pass
            elif np.abs(image + right_axis).max() < _MIRRORED:
                opposite += [left, right]
            else:
                return ""
            pairs[left] = right
    if {*pairs, *pairs.values()} != set(joints) or len(pairs) * 2 != len(joints):
        return ""
    swap = ", ".join(
        f"{json.dumps(re.escape(left))}: {json.dumps(right)}" for left, right in pairs.items()
    )
    turned = ", ".join(json.dumps(re.escape(name)) for name in opposite)
    return _SYMMETRY.format(swap=swap, opposite=turned)


def _mirrored(place: F64) -> F64:
    """(3,) the mirror image of a place in the plane between left and right."""
    return place * [1.0, -1.0, 1.0]


_SYMMETRY = """\
symmetry:                          # left and right
  swap: {{{swap}}}
  opposite: [{opposite}]
  observations:
    {{lin_vel: [1, -1, 1], ang_vel: [-1, 1, -1], gravity: [1, -1, 1], command: [1, -1, -1],
     qpos: joints, qvel: joints, action: joints, phase: [-1, -1]}}
  actions: {{legs: joints}}
"""

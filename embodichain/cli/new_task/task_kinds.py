"""`write_kind`: the YAML of a task of a kind, for the robot of an embodiment."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import resources
from string import Template
from typing import TYPE_CHECKING

from embodichain.cli.new_task.guesses import Guess
from embodichain.cli.new_task.kind_pick import draft_pick
from embodichain.cli.new_task.kind_push import draft_push
from embodichain.cli.new_task.kind_reach import draft_reach
from embodichain.cli.new_task.kind_velocity import draft_velocity
from embodichain.cli.new_task.legs import Leg, find_legs, legs_with_feet
from embodichain.cli.new_task.limbs import find_limbs, find_wheels, only_wheels
from embodichain.cli.new_task.new_time_step import TimeStep, time_step
from embodichain.cli.new_task.plausibility import size_notes
from embodichain.cli.new_task.task_trials import Trial, try_expert
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.cli.new_task.embodied_robot import EmbodiedRobot
    from embodichain.cli.new_task.task_draft import TaskDraft

__all__ = ["KINDS", "Kind", "WrittenTask", "write_kind"]

_GOOD_ENOUGH = 0.95
"""Share of episodes in which the expert of a task that is written should succeed."""
_MOST_TRIALS = 5
"""Work areas that are tried, the largest first."""


@dataclass(frozen=True)
class Kind:
    """A kind of task.

    Attributes:
        name: Its name.
        needs: Names of links, `gripper` and control parts that the robot must have.
        walks: Whether its base must float; else it must not.
        has_expert: Whether its expert is tried before the file is written.
        control_period: Seconds of a control step.
        draft: Yields the tasks that may do for a robot, the best first.
    """

    name: str
    needs: Sequence[str]
    walks: bool
    has_expert: bool
    control_period: float
    draft: Callable[[EmbodiedRobot], Iterator[TaskDraft]]


KINDS = {
    kind.name: kind
    for kind in (
        Kind("reach", ("tool", "arm"), False, False, 0.02, draft_reach),
        Kind("push", ("tool", "arm"), False, True, 0.02, draft_push),
        Kind(
            "pick",
            ("tool", "arm", "left_finger", "right_finger", "gripper"),
            False,
            True,
            0.04,
            draft_pick,
        ),
        Kind("velocity", ("feet", "legs"), True, False, 0.02, draft_velocity),
    )
}
"""Name -> kind."""
_PARTS = ("arm", "legs")


@dataclass(frozen=True)
class WrittenTask:
    """A task of a kind.

    Attributes:
        text: Its YAML.
        guesses: What was guessed, in the order of the file.
        time_step: Its time step.
        trial: How its expert did; None without an expert.
    """

    text: str
    guesses: Sequence[Guess]
    time_step: TimeStep
    trial: Trial | None


def write_kind(kind: Kind, robot: EmbodiedRobot) -> WrittenTask:
    """Return the task of a kind for a robot.

    Raises:
        ConfigError: If the robot cannot do it: the message names what is missing.
    """
    _check_robot(kind, robot)
    step: TimeStep | None = None
    best: WrittenTask | None = None
    for number, draft in enumerate(kind.draft(robot)):
        if number == _MOST_TRIALS:
            break
        if step is None:
            step = time_step(
                robot.file_dt,
                partial(_text, kind, robot, draft),
                embodiment=robot.embodiment,
                period=kind.control_period,
            )
        text = _text(kind, robot, draft, step)
        if not kind.has_expert:
            return WrittenTask(text, draft.guesses, step, None)
        trial = try_expert(text, robot.embodiment)
        if best is None or best.trial is None or trial.success > best.trial.success:
            best = WrittenTask(text, draft.guesses, step, trial)
        if trial.success >= _GOOD_ENOUGH:
            break
    if best is None:
        how = " pointing straight down" if kind.name == "pick" else ""
        message = f"{kind.name} needs places near the floor that the tool reaches{how}"
        message += f": that of {robot.embodiment.name} does not"
        if size_notes(robot.parsed):
            message += "; mend its size first"
        raise ConfigError(message)
    return best


def _check_robot(kind: Kind, robot: EmbodiedRobot) -> None:
    """Refuse a robot that cannot do a kind of task, in one mistake."""
    name = robot.embodiment.name
    wheels = find_wheels(robot.model, robot.data)
    if wheels:
        raise ConfigError(f"{kind.name} is not a task for {name}: {only_wheels(wheels)}")
    if not kind.walks and robot.is_floating:
        message = f"{kind.name} needs an arm on a fixed base, and the base of {name} floats"
        raise ConfigError(f"{message} (fix_base: false): a robot with legs can do velocity")
    missing = [need for need in kind.needs if not _has(robot, need)]
    if kind.walks and (missing or not robot.is_floating):
        raise ConfigError(_how_to_walk(kind, robot, missing))
    if missing:
        keys = ", ".join(_key_of(need) for need in missing)
        message = f"{kind.name}: {name} lacks what the task needs: {keys}. {_where_to(robot)}"
        if "gripper" in missing:
            message += "; `attach` fixes a gripper on an arm: docs/robots.md#a-gripper-on-an-arm"
        raise ConfigError(message)
    part = next(need for need in kind.needs if need in _PARTS)
    joints = robot.joints_of(part)
    undriven = robot.without_servo(joints)
    if undriven:
        message = f"{kind.name} moves joints by position targets, and these of {name} have no "
        message += f"drive and no position servo: {', '.join(undriven)}; give them gains in "
        raise ConfigError(f"{message}drive_pros of the embodiment")


def _how_to_walk(kind: Kind, robot: EmbodiedRobot, missing: Sequence[str]) -> str:
    """What a robot lacks to walk, and the lines that give it."""
    name = robot.embodiment.name
    legs = _legs_of(robot)
    lacks = [_key_of(need) for need in missing]
    what = f"the base of {name} is fixed (fix_base)"
    if robot.is_floating:
        what = f"{name} lacks {', '.join(lacks)}"
    message = f"{kind.name} needs a robot that walks, and {what}"
    if not legs:
        message += ": no equal chains of joints begin at its trunk, as legs do. "
        if not robot.is_floating:
            message += "An arm can reach, and perhaps push and pick. "
        if robot.embodiment.is_new:
            return f"{message}If it has legs, --feet LINK,LINK names the links on which it stands"
        message += "If it has legs, its embodiment has fix_base: false, names.feet (the links that "
        message += "touch the ground) and control_parts.legs (the joints that move them). "
        return message + _where_to(robot)
    lines = []
    if not robot.is_floating:
        lines.append("fix_base: false")
    if "feet" in missing:
        lines.append(f"names: {{feet: [{', '.join(json.dumps(leg.foot) for leg in legs)}]}}")
    if "legs" in missing:
        joints = dict.fromkeys(joint for leg in legs for joint in leg.joints)
        listed = ", ".join(json.dumps(re.escape(joint)) for joint in joints)
        lines.append(f"control_parts: {{legs: [{listed}]}}")
    message += f". {_where_to(robot)}, below `robot:`; what looks like its legs would be"
    return "\n  ".join([message, *lines])


def _legs_of(robot: EmbodiedRobot) -> list[Leg]:
    """What looks like the legs of a robot; of one that is fixed, only equal chains."""
    limbs = find_limbs(robot.model, robot.data, robot.parsed.root_link_name)
    if limbs:
        return legs_with_feet(robot.model, robot.data, [limb.end for limb in limbs])
    legs = find_legs(robot.model, robot.data, robot.parsed.link_names)
    return legs if len(legs) > 1 else []


def _where_to(robot: EmbodiedRobot) -> str:
    """Where what an embodiment lacks is to be written."""
    name = robot.embodiment.name
    path = f"conf/embodiment/{name}.yaml"
    if robot.embodiment.is_new:
        message = f"`embodichain new embodiment {name} --robot FILE` writes {path}: add them there"
        return f"{message}, and repeat this command"
    if robot.embodiment.text:
        return f"Write them into {path}"
    return f"{name} ships with embodichain: take another of `embodichain list embodiments`"


def _has(robot: EmbodiedRobot, need: str) -> bool:
    """Whether a robot has a part, a gripper, or a link with a name."""
    if need in _PARTS:
        return bool(robot.joints_of(need))
    if need == "gripper":
        return bool(getattr(robot.parsed.cfg, "grippers", None))
    return need in robot.names


def _key_of(need: str) -> str:
    """The key of an embodiment that gives what a task needs."""
    if need in _PARTS:
        return f"control_parts.{need}"
    if need == "gripper":
        return "grippers.gripper"
    return f"names.{need}"


def _text(kind: Kind, robot: EmbodiedRobot, draft: TaskDraft, step: TimeStep) -> str:
    """The YAML of a task."""
    lines = ["# Guessed, and to be checked:"]
    lines += [f"#   {guess}" for guess in draft.guesses]
    words = {
        **draft.words,
        **step.words,
        "embodiment": robot.embodiment.name,
        "guesses": "\n".join(lines),
    }
    template = resources.files("embodichain.cli") / "templates" / f"kind_{kind.name}.yaml.tmpl"
    return Template(template.read_text(encoding="utf-8")).substitute(words)

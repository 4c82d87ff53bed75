"""`embodiment_text`: the file of an embodiment, guessed from a robot's URDF or MJCF."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from embodichain.cli.new_task.new_robot import FOOT_NAME, RobotFile, read_robot_file

if TYPE_CHECKING:
    import mujoco

__all__ = ["Guess", "embodiment_text", "guess_embodiment"]

_FINGER = re.compile(r"finger|jaw|thumb|knuckle", re.IGNORECASE)
_LEFT = re.compile(r"left|(^|[_/])l([_/]|$)", re.IGNORECASE)


@dataclass(frozen=True)
class Guess:
    """A line of an embodiment that was guessed, or that could not be.

    Attributes:
        key: Its key in `robot`.
        value: Its value as YAML; empty if there is nothing to guess it from.
        why: What it was guessed from, or what to write.
    """

    key: str
    value: str
    why: str

    def __str__(self) -> str:
        """Return it as one line for people."""
        return f"{self.key}: {self.value or '?'} ({self.why})"


def guess_embodiment(fpath: str) -> list[Guess]:
    """Read a robot's file and guess what an embodiment says of it, in the order of its lines.

    Args:
        fpath: A URDF or MJCF, as `get_data_path` takes it.

    Raises:
        ConfigError: If the file does not exist or cannot be read, or if no joint can move.
    """
    robot = read_robot_file(fpath)
    parsed = robot.parsed
    guesses = [Guess("fpath", fpath, "as given")]
    if robot.is_floating:
        guesses.append(Guess("fix_base", "false", "the file has a free joint, or feet"))
        height = f"[0, 0, {robot.height:g}]"
        guesses.append(Guess("init_pos", height, "its lowest point is on the ground"))
    home = ", ".join(f"{value:g}" for value in robot.home)
    guesses.append(Guess("init_qpos", f"[{home}]", "the file's keyframe, or bent for its reach"))
    guesses += _arm_guesses(robot) if not robot.is_floating else _leg_guesses(robot)
    guesses.append(Guess("names.base", parsed.root_link_name, "the root link"))
    if parsed.own_actuators:
        guesses.append(Guess("drive_pros", "{stiffness: file}", "the file has actuators"))
    else:
        effort = ", max_effort: file" if (parsed.qf_limits < 1e9).all() else ""
        drives = f"{{stiffness: 500, damping: 50{effort}}}"
        guesses.append(Guess("drive_pros", drives, "a URDF has no gains: tune them"))
    return guesses


def embodiment_text(name: str, guesses: Sequence[Guess]) -> str:
    """Return the file of an embodiment, with what each line was guessed from beside it."""
    lines = [f"# The embodiment {name}. Check what was guessed: embodichain show task=reach "]
    lines[0] += f"embodiment={name}"
    lines += ["robot:", "  uid: robot"]
    sections: dict[str, list[str]] = {}
    for guess in guesses:
        section, _, key = guess.key.partition(".")
        line = f"{key or section}: {guess.value}  # {guess.why}"
        if not guess.value:
            line = f"# {key or section}:  # {guess.why}"
        if key:
            if section not in sections:
                sections[section] = []
            sections[section].append(f"    {line}")
        else:
            lines.append(f"  {line}")
    for section, entries in sections.items():
        is_empty = all(entry.lstrip().startswith("#") for entry in entries)
        lines.append(f"  # {section}:" if is_empty else f"  {section}:")
        lines += entries
    return "\n".join(lines) + "\n"


def _arm_guesses(robot: RobotFile) -> Iterator[Guess]:
    """Yield the guesses about an arm and its gripper."""
    parsed = robot.parsed
    model = parsed.model
    yield Guess("gravcomp", "1", "most arms have a controller that bears their weight")
    tool_body = _body_of(robot)
    arm = [name for name in _joints_above(model, tool_body) if name in parsed.joint_names]
    if arm:
        yield Guess("control_parts.arm", _listed(arm), "the joints between root and tool")
        yield Guess("control_parts.swivel", f"[{arm[0]}]", "its first joint")
    why = "called as tools are, or the end of the longest chain"
    yield Guess("names.tool", robot.tool.name, why)
    fingers = _fingers(robot, arm)
    if len(fingers) < 2:
        why = "no two links are called fingers or jaws: name the links that grip"
        yield Guess("names.left_finger", "", why)
        yield Guess("names.right_finger", "", why)
        yield Guess("grippers", "", "{gripper: {open: ..., close: ...}} with a part `gripper`")
        return
    left = next((name for name in fingers if _LEFT.search(name)), fingers[0])
    right = next(name for name in fingers if name != left)
    yield Guess("names.left_finger", left, "called a finger or a jaw")
    yield Guess("names.right_finger", right, "the other one")
    joints = [name for name in parsed.joint_names if name not in arm]
    moving = [name for name in joints if _moves(model, name, (left, right))]
    if not moving:
        yield Guess("control_parts.gripper", "", "no joint moves the fingers: name those that do")
        return
    yield Guess("control_parts.gripper", _listed(moving), "the joints that move the fingers")
    index = parsed.joint_names.index(moving[0])
    low, high = (float(value) for value in parsed.qpos_limits[index])
    widths = [_width(robot, moving, value, (left, right)) for value in (low, high)]
    open_value, close_value = (low, high) if widths[0] > widths[1] else (high, low)
    value = f"{{open: {open_value:g}, close: {close_value:g}}}"
    why = f"the limits of {moving[0]}: its fingers are farther apart where it opens"
    if parsed.own_actuators and not parsed.drives[index]:
        why += "; the file's actuators move it: add actuators and their controls"
    yield Guess("grippers.gripper", value, why)


def _leg_guesses(robot: RobotFile) -> Iterator[Guess]:
    """Yield the guesses about a robot that walks."""
    parsed = robot.parsed
    feet = [name for name in parsed.link_names if FOOT_NAME.search(name)]
    if not feet:
        yield Guess("names.feet", "", "no link is called foot or toe: name the feet")
        return
    yield Guess("names.feet", _listed(feet), "called feet")
    legs: dict[str, None] = {}
    for foot in feet:
        above = _joints_above(parsed.model, int(parsed.model.body(foot).id))
        legs |= dict.fromkeys(name for name in above if name in parsed.joint_names)
    yield Guess("control_parts.legs", _listed([*legs]), "the joints between root and feet")


def _listed(names: Sequence[str]) -> str:
    return f"[{', '.join(json.dumps(re.escape(name)) for name in names)}]"


def _body_of(robot: RobotFile) -> int:
    """MuJoCo's id of the body that carries the tool."""
    model = robot.parsed.model
    if robot.tool.kind == "site":
        return int(model.site(robot.tool.name).bodyid[0])
    return int(model.body(robot.tool.name).id)


def _joints_above(model: mujoco.MjModel, body: int) -> list[str]:
    """The joints between the world and a body, from the world on."""
    names: list[str] = []
    while body:
        first = int(model.body_jntadr[body])
        count = int(model.body_jntnum[body])
        names[:0] = [model.joint(first + i).name for i in range(count)]
        body = int(model.body_parentid[body])
    return names


def _fingers(robot: RobotFile, arm: Sequence[str]) -> list[str]:
    """Links called fingers, and the link that carries the only one."""
    model = robot.parsed.model
    links = [name for name in robot.parsed.link_names if _FINGER.search(name)]
    joints_of = {name: _joints_above(model, int(model.body(name).id)) for name in links}
    # A finger is moved by a joint of its own; pads on it are not fingers.
    moved = [n for n in links if joints_of[n] and joints_of[n][-1] not in arm]
    first_link_of_joint: dict[str, str] = {}
    for name in moved:
        first_link_of_joint.setdefault(joints_of[name][-1], name)
    fingers = list(first_link_of_joint.values())
    if len(fingers) == 1:  # a jaw that closes on the hand
        parent = int(model.body_parentid[model.body(fingers[0]).id])
        fingers.insert(0, model.body(parent).name)
    return fingers


def _moves(model: mujoco.MjModel, joint: str, links: Sequence[str]) -> bool:
    """Whether a joint is above one of some links."""
    return any(joint in _joints_above(model, int(model.body(link).id)) for link in links)


def _width(robot: RobotFile, joints: Sequence[str], value: float, links: Sequence[str]) -> float:
    """Distance of the middles of two links with some joints at a position, m."""
    import mujoco
    import numpy as np

    model = robot.parsed.model
    data = mujoco.MjData(model)
    data.qpos[:] = robot.data.qpos
    for name in joints:
        low, high = model.joint(name).range
        data.joint(name).qpos = min(max(value, low), high) if model.joint(name).limited else value
    mujoco.mj_kinematics(model, data)
    first, second = (data.body(link).xipos for link in links)
    return float(np.linalg.norm(first - second))

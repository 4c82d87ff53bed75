"""`embodiment_text`: the file of an embodiment, guessed from a robot's URDF or MJCF."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from embodichain.cli.new_task.effort_limits import guess_effort, guess_effort_limits
from embodichain.cli.new_task.guesses import Guess, some_of
from embodichain.cli.new_task.legs import FOOT_NAME, Leg, leg_gains
from embodichain.cli.new_task.new_robot import JAW_NAME, RobotFile, read_robot_file
from embodichain.cli.new_task.tool_point import (
    Gripping,
    ToolPoint,
    body_of,
    find_tool_point,
)

if TYPE_CHECKING:
    import mujoco

__all__ = ["command_to_check", "embodiment_text", "guess_embodiment"]

_FINGER = re.compile(r"finger|jaw|thumb|knuckle|claw", re.IGNORECASE)
_LEFT = re.compile(r"left|(^|[_/])l([_/]|$)", re.IGNORECASE)
_FOOT_FRICTION = 1.0
"""Sliding friction of a robot that walks: MuJoCo's default, and that of published trainings."""
_ARM_GAINS = (500.0, 50.0)
"""Stiffness and damping of an arm's drives, N m/rad and N m s/rad."""
_WHEEL_DAMPING = 1.0
"""Damping of the drive of a wheel, N m s/rad: its gain for errors of velocity."""


def guess_embodiment(
    fpath: str, feet: Sequence[str] = (), *, shall_walk: bool = False
) -> list[Guess]:
    """Read a robot's file and guess what an embodiment says of it, in the order of its lines.

    Args:
        fpath: A URDF or MJCF, as `get_data_path` takes it.
        feet: The links or geoms on which it stands, see `read_robot_file`.
        shall_walk: Whether it is to walk, see there.

    Raises:
        ConfigError: If the file does not exist or cannot be read, or if no joint can move.
    """
    robot = read_robot_file(fpath, feet, shall_walk=shall_walk)
    guesses = [Guess("fpath", fpath, "as given")]
    if robot.is_floating:
        guesses.append(Guess("fix_base", "false", robot.why_floating))
        height = f"[0, 0, {robot.height:g}]"
        guesses.append(Guess("init_pos", height, "its lowest point is on the ground"))
    elif robot.height:
        height = f"[0, 0, {robot.height:g}]"
        guesses.append(Guess("init_pos", height, "lower, a part would be in the ground"))
    home = ", ".join(f"{value:g}" for value in robot.home)
    guesses.append(Guess("init_qpos", f"[{home}]", robot.why_home))
    if robot.wheels:
        wheels = _listed(robot.wheels)
        guesses.append(Guess("control_parts.wheels", wheels, "each turns a part about its middle"))
    elif robot.is_floating:
        guesses += _leg_guesses(robot)
    else:
        guesses += _arm_guesses(robot)
    guesses.append(Guess("names.base", robot.parsed.root_link_name, "the root link"))
    guesses.append(_drive_guess(robot))
    if robot.legs and robot.is_urdf:
        why = "a URDF has no friction: that of rubber feet"
        guesses.append(Guess("attrs", f"{{dynamic_friction: {_FOOT_FRICTION:g}}}", why))
    return [_with_own_name(robot, guess) for guess in guesses]


def _with_own_name(robot: RobotFile, guess: Guess) -> Guess:
    """A name of a link that the file has itself stands for what it has there."""
    section, _, name = guess.key.partition(".")
    parsed = robot.parsed
    own_names = {*parsed.link_names, *parsed.site_names, *parsed.geom_names}
    if section != "names" or name not in own_names or guess.value in ("", name):
        return guess
    return Guess(guess.key, name, f"the file calls it so; the guess was {guess.value}")


def embodiment_text(name: str, guesses: Sequence[Guess]) -> str:
    """Return the file of an embodiment, with what each line was guessed from beside it."""
    lines = [f"# The embodiment {name}. Check what was guessed: {command_to_check(name, guesses)}"]
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


def command_to_check(name: str, guesses: Sequence[Guess]) -> str:
    """The command in which a new embodiment is seen at work, or where there is a task for it."""
    keys = {guess.key for guess in guesses}
    if "control_parts.legs" in keys:
        return f"embodichain new task {name}_walk --kind velocity --embodiment {name}"
    if "control_parts.wheels" in keys:
        return "docs/robots.md#wheels has a task that drives wheels"
    return f"embodichain show task=reach embodiment={name}"


def _arm_guesses(robot: RobotFile) -> Iterator[Guess]:
    """Yield the guesses about an arm and its gripper."""
    parsed = robot.parsed
    model = parsed.model
    yield Guess("gravcomp", "1", "most arms have a controller that bears their weight")
    tool_body = body_of(model, robot.tool)
    arm = [name for name in _joints_above(model, tool_body) if name in parsed.joint_names]
    if arm:
        yield Guess("control_parts.arm", _listed(arm), "the joints between root and tool")
        yield Guess(
            "control_parts.swivel", _listed(arm[:1]), "the first joint of the arm, which turns it"
        )
    fingers = _fingers(robot, arm)
    gripper = _Gripper.find(robot, arm, fingers) if len(fingers) == 2 else None
    gripping = gripper.gripping if gripper else None
    yield from _tool_guesses(find_tool_point(model, robot.data, robot.tool, gripping), arm)
    if len(fingers) < 2:
        why = "no two links move as fingers do: name the links that grip"
        yield Guess("names.left_finger", "", why)
        yield Guess("names.right_finger", "", why)
        yield Guess(
            "grippers",
            "",
            "write {gripper: {open: ..., close: ...}}, and the part control_parts.gripper",
        )
        return
    left, right = fingers
    why_left, why_right = _why_fingers(model, left, right)
    yield Guess("names.left_finger", left, why_left)
    yield Guess("names.right_finger", right, why_right)
    if gripper is None:
        yield Guess("control_parts.gripper", "", "no joint moves the fingers: name those that do")
        return
    yield Guess("control_parts.gripper", _listed(gripper.joints), "joints that move the fingers")
    yield Guess("grippers.gripper", gripper.value, gripper.why)


def _why_fingers(model: mujoco.MjModel, left: str, right: str) -> tuple[str, str]:
    """What the left and the right finger were guessed from."""
    for jaw, hand in ((left, right), (right, left)):
        if int(model.body(hand).id) in _carriers(model, int(model.body(jaw).id)):
            of_hand = "the link that carries the jaw, which closes on it"
            of_jaw = "the jaw, a link that moves beyond the arm"
            return (of_jaw, of_hand) if jaw == left else (of_hand, of_jaw)
    return "one of two links that move beyond the arm, as fingers do", "the other of the two"


def _tool_guesses(point: ToolPoint, arm: Sequence[str]) -> Iterator[Guess]:
    """Yield the name of the tool, and the tool point of the arm."""
    frame = point.frame
    key = "end_site_name" if frame.kind == "site" else "end_link_name"
    if not arm:
        yield Guess("names.tool", frame.name, point.why)
        return
    if point.matrix is None:
        yield Guess("names.tool", frame.name, point.why)
        yield Guess("solver_cfg.arm", f"{{{key}: {frame.name}}}", "the tool")
        return
    rows = ", ".join(
        f"[{', '.join(f'{round(float(value), 4) + 0.0:g}' for value in row)}]"
        for row in point.matrix
    )
    yield Guess("names.tool", "arm_tcp", point.why)
    yield Guess("solver_cfg.arm", f"{{{key}: {frame.name}, tcp: [{rows}]}}", "the tool's pose")


@dataclass(frozen=True)
class _Gripper:
    """How a gripper is moved.

    Attributes:
        joints: The joints that move the fingers.
        value: How it opens and closes, as YAML.
        why: What that was guessed from.
        gripping: The same for `find_tool_point`.
    """

    joints: list[str]
    value: str
    why: str
    gripping: Gripping

    @classmethod
    def find(cls, robot: RobotFile, arm: Sequence[str], fingers: Sequence[str]) -> _Gripper | None:
        """Return the gripper with two fingers, or None if no joint moves them."""
        parsed = robot.parsed
        model = parsed.model
        moving = [
            name for name in parsed.joint_names if name not in arm and _moves(model, name, fingers)
        ]
        if not moving:
            return None
        index = parsed.joint_names.index(moving[0])
        ends = [float(value) for value in parsed.qpos_limits[index]]
        why = f"the ends of the range of {moving[0]}: open is where the fingers are farther apart"
        actuator = ""
        commands = ends
        if parsed.own_actuators and not parsed.drives[index]:
            actuator, commands, ends = _tendon_ends(robot, moving, ends)
            why = (
                f"the ends of the actuator {actuator}: open is where the fingers are farther apart"
            )
            if not actuator:
                why = f"the ends of the range of {moving[0]}; name the actuators that move it, too"
        poses = [_pose_of(model, moving, end) for end in ends]
        widths = [_width(robot, pose, fingers) for pose in poses]
        opened, closed = (0, 1) if widths[0] > widths[1] else (1, 0)
        value = f"open: {commands[opened]:g}, close: {commands[closed]:g}"
        if actuator:
            value += f", actuators: {json.dumps(re.escape(actuator))}"
        gripping = Gripping(fingers[0], fingers[1], open=poses[opened], close=poses[closed])
        return cls(moving, f"{{{value}}}", why, gripping)


def _tendon_ends(
    robot: RobotFile, joints: Sequence[str], limits: list[float]
) -> tuple[str, list[float], list[float]]:
    """The actuator that moves joints otherwise than by a position servo of each.

    Returns:
        Its name, empty without one; the ends of its control; the joints' positions there.
    """
    import mujoco

    model = robot.parsed.model
    ids = {int(model.joint(name).id) for name in joints}
    for actuator in range(model.nu):
        target = int(model.actuator_trnid[actuator, 0])
        kind = model.actuator_trntype[actuator]
        is_limited = bool(model.actuator_ctrllimited[actuator])
        if kind == mujoco.mjtTrn.mjTRN_TENDON:
            first = int(model.tendon_adr[target])
            wraps = range(first, first + int(model.tendon_num[target]))
            moved = {int(model.wrap_objid[i]) for i in wraps}
            levers = {int(model.wrap_objid[i]): float(model.wrap_prm[i]) for i in wraps}
        elif kind == mujoco.mjtTrn.mjTRN_JOINT:
            moved = {target}
            levers = {target: 1.0}
        else:
            continue
        if not moved & ids or not is_limited:
            continue
        controls = [float(value) for value in model.actuator_ctrlrange[actuator]]
        gain = float(model.actuator_gainprm[actuator, 0])
        bias = -float(model.actuator_biasprm[actuator, 1])
        ends = limits
        lever = levers.get(int(model.joint(joints[0]).id), 0.0)
        if bias > 0 and lever:
            # A servo of a tendon: all its joints move alike until its length is what is asked for.
            total = sum(abs(value) for value in levers.values())
            ends = [gain / bias * value / total * (1 if lever > 0 else -1) for value in controls]
        return model.actuator(actuator).name, controls, ends
    return "", limits, limits


def _pose_of(model: mujoco.MjModel, joints: Sequence[str], value: float) -> dict[str, float]:
    """Joint -> position, where all are at a value, as far as their limits allow."""
    pose: dict[str, float] = {}
    for name in joints:
        joint = model.joint(name)
        low, high = (float(end) for end in joint.range)
        pose[name] = min(max(value, low), high) if joint.limited else value
    return pose


def _leg_guesses(robot: RobotFile) -> Iterator[Guess]:
    """Yield the guesses about a robot that walks."""
    legs = robot.legs
    if not legs:
        yield Guess("names.feet", "", "no two legs were found: name the feet")
        return
    yield Guess("names.feet", _listed([leg.foot for leg in legs]), _why_feet(legs))
    joints: dict[str, None] = {}
    for leg in legs:
        joints |= dict.fromkeys(name for name in leg.joints if name in robot.parsed.joint_names)
    yield Guess("control_parts.legs", _listed([*joints]), "the joints between root and feet")
    thighs = _thighs(robot, legs)
    if thighs:
        yield Guess(
            "names.thighs",
            _listed(thighs),
            "links of the legs above their last joints: they should not hit anything",
        )


def _why_feet(legs: Sequence[Leg]) -> str:
    """What feet were guessed from."""
    if legs[0].kind == "geom":
        return "the lowest shapes of the legs"
    if all(FOOT_NAME.search(leg.foot) for leg in legs):
        return "links that are called feet"
    return "the last links of the legs: none is called a foot"


def _thighs(robot: RobotFile, legs: Sequence[Leg]) -> list[str]:
    """The links that carry the last links of the legs, without the trunk."""
    model = robot.parsed.model
    links: dict[str, None] = {}
    for leg in legs:
        body = int(model.body(leg.body).id)
        while body and not model.body_jntnum[body]:  # a foot that is fixed on the shank
            body = int(model.body_parentid[body])
        name = model.body(int(model.body_parentid[body])).name
        if name != robot.parsed.root_link_name:
            links[name] = None
    return [*links]


def _drive_guess(robot: RobotFile) -> Guess:
    """Guess the gains: the file's actuators, or drives where there are none, or motors."""
    parsed = robot.parsed
    stiffness, damping = _ARM_GAINS
    why = "a URDF has no gains: tune them"
    if not robot.is_urdf:
        why = "the file has no actuators, and so no gains: tune them"
    if robot.legs:
        stiffness, damping = leg_gains(parsed.model, robot.data, robot.legs)
        why = f"by the weight on its legs; {why}"
    if robot.wheels:
        stiffness = 0.0
        damping = _WHEEL_DAMPING
        why = "wheels follow targets of velocity"
    if not parsed.own_actuators:
        effort = ", max_effort: file" if _knows_efforts(robot) else ""
        armature = ", armature: 0.01" if robot.legs else ""
        if robot.legs or robot.wheels:
            if robot.joints_without_effort:
                names = some_of(robot.joints_without_effort)
                why += f"; the file's efforts of 0 ({names}) are taken as no limit: max_effort"
                why += " gives one, in N m or N"
        else:
            limits = guess_effort_limits(parsed, stiffness, robot.joints_without_effort)
            effort = f", max_effort: {limits.value}"
            if limits.why:
                why += f"; {limits.why}"
        if robot.joints_without_velocity:
            names = some_of(robot.joints_without_velocity)
            why += f"; the file's velocities of 0 ({names}) are taken as no limit: max_velocity"
            why += " gives one, in rad/s or m/s"
        value = f"{{stiffness: {stiffness:g}, damping: {damping:g}{effort}{armature}}}"
        return Guess("drive_pros", value, why)
    motors = _motors(robot)
    unlimited = [name for name, effort in motors.items() if not effort]
    if not robot.legs and not robot.wheels:
        motors |= {name: guess_effort(parsed.model, name, stiffness) for name in unlimited}
    if not motors:
        return Guess(
            "drive_pros",
            "{stiffness: file}",
            "its joints are moved by the position servos of the file",
        )
    maps = {
        "stiffness": dict.fromkeys(motors, stiffness),
        "damping": dict.fromkeys(motors, damping),
        "max_effort": {name: effort for name, effort in motors.items() if effort},
    }
    value = ", ".join(
        f"{key}: {{{', '.join(f'{json.dumps(re.escape(n))}: {v:g}' for n, v in values.items())}}}"
        for key, values in maps.items()
        if values
    )
    why = "drives in place of the file's motors, which take torques: tune the gains"
    if unlimited:
        why += f"; the file has no limits of {some_of(unlimited)}"
    return Guess("drive_pros", f"{{{value}}}", why)


def _motors(robot: RobotFile) -> dict[str, float]:
    """Joints that the file moves by a torque or a force -> its largest value, 0 without one."""
    import mujoco

    parsed = robot.parsed
    model = parsed.model
    motors: dict[str, float] = {}
    for actuator in range(model.nu):
        if model.actuator_trntype[actuator] != mujoco.mjtTrn.mjTRN_JOINT:
            continue
        if model.actuator_biastype[actuator] != mujoco.mjtBias.mjBIAS_NONE:
            continue
        name = model.joint(int(model.actuator_trnid[actuator, 0])).name
        if name not in parsed.joint_names or parsed.drives[parsed.joint_names.index(name)]:
            continue
        gear = abs(float(model.actuator_gear[model.actuator_outadr[actuator], 0]))
        gain = abs(float(model.actuator_gainprm[actuator, 0]))
        largest = 0.0
        if model.actuator_ctrllimited[actuator]:
            largest = gear * gain * float(abs(model.actuator_ctrlrange[actuator]).max())
        motors[name] = largest
    return motors


def _knows_efforts(robot: RobotFile) -> bool:
    """Whether a file has limits of efforts, except where it says 0."""
    parsed = robot.parsed
    limits = {
        name: limit
        for i, (name, limit) in enumerate(zip(parsed.joint_names, parsed.qf_limits, strict=True))
        if i not in parsed.mimic_ids
    }
    unlimited = {name for name, limit in limits.items() if limit >= 1e9}
    return len(unlimited) < len(limits) and unlimited <= {*robot.joints_without_effort}


def _listed(names: Sequence[str]) -> str:
    return f"[{', '.join(json.dumps(re.escape(name)) for name in names)}]"


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
    """The left and the right finger, or none.

    They are links called so, else two links beyond the arm that move; the link that carries a
    single jaw is the other finger.
    """
    model = robot.parsed.model
    named = [
        name
        for name in robot.parsed.link_names
        if _FINGER.search(name) or any(map(JAW_NAME.search, _joints_of(model, name)))
    ]
    fingers = _first_movers(model, named, arm)
    if not fingers and arm:
        last = int(model.jnt_bodyid[model.joint(arm[-1]).id])
        beyond = [
            name
            for name in robot.parsed.link_names
            if last in _carriers(model, int(model.body(name).id))
        ]
        fingers = _first_movers(model, beyond, arm)
        if len(fingers) < 2:  # what slides or turns alone may be anything
            return []
    if len(fingers) == 1:  # a jaw that closes on the hand
        parent = int(model.body_parentid[model.body(fingers[0]).id])
        fingers.insert(0, model.body(parent).name)
    if len(fingers) < 2:
        return []
    left = next((name for name in fingers if _LEFT.search(name)), fingers[0])
    right = next(name for name in fingers if name != left)
    return [left, right]


def _joints_of(model: mujoco.MjModel, link: str) -> list[str]:
    """The joints between a link and its parent."""
    body = int(model.body(link).id)
    first = int(model.body_jntadr[body])
    return [model.joint(first + i).name for i in range(int(model.body_jntnum[body]))]


def _first_movers(model: mujoco.MjModel, links: Sequence[str], arm: Sequence[str]) -> list[str]:
    """Of links, those that are moved by a joint beyond the arm that moves none before them.

    Pads on fingers, and the further bars of a linkage, are not fingers.
    """
    first_link_of_joint: dict[str, str] = {}
    for name in links:
        joints = _joints_above(model, int(model.body(name).id))
        beyond = [joint for joint in joints if joint not in arm]
        if beyond:
            first_link_of_joint.setdefault(beyond[0], name)
    return list(first_link_of_joint.values())


def _carriers(model: mujoco.MjModel, body: int) -> set[int]:
    """The bodies that carry one, and it itself."""
    bodies = set()
    while body:
        bodies.add(body)
        body = int(model.body_parentid[body])
    return bodies


def _moves(model: mujoco.MjModel, joint: str, links: Sequence[str]) -> bool:
    """Whether a joint is above one of some links."""
    return any(joint in _joints_above(model, int(model.body(link).id)) for link in links)


def _width(robot: RobotFile, pose: Mapping[str, float], links: Sequence[str]) -> float:
    """Distance of the middles of two links with some joints at positions, m."""
    import mujoco
    import numpy as np

    model = robot.parsed.model
    data = mujoco.MjData(model)
    data.qpos[:] = robot.data.qpos
    for name, value in pose.items():
        data.joint(name).qpos = value
    mujoco.mj_kinematics(model, data)
    first, second = (data.body(link).xipos for link in links)
    return float(np.linalg.norm(first - second))

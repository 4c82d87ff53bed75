"""The robot of a new task: `describe_robot` reads its file and returns template variables."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from embodichain.cli.new_task.effort_limits import EffortLimits, guess_effort_limits
from embodichain.cli.new_task.guesses import Guess, some_of
from embodichain.cli.new_task.legs import (
    FOOT_NAME,
    Leg,
    find_legs,
    legs_aside,
    legs_with_feet,
    spreads,
    stand,
)
from embodichain.cli.new_task.limbs import find_limbs, find_wheels, only_wheels
from embodichain.cli.new_task.new_home import bent_home, lowest_point
from embodichain.cli.new_task.new_reach import ToolFrame, ToolReach
from embodichain.cli.new_task.plausibility import warn_of_size
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean, listing

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation

__all__ = [
    "JAW_NAME",
    "UR10",
    "DescribedRobot",
    "RobotFile",
    "describe_robot",
    "read_robot_file",
]

_RESERVED_UIDS = ("marker", "pedestal", "default_plane")
_PEDESTAL = """\
scene:                             # for pictures only: the base is inside, so it does not collide
  pedestal: {{size: [0.2, 0.2, {height}], pos: [0, 0, 0], collision: false}}
"""
_IMPORTS = "RigidBodyAttributesCfg, RigidObjectCfg, RobotCfg"
_DRIVEN_IMPORTS = """(
    JointDrivePropertiesCfg,
    RigidBodyAttributesCfg,
    RigidObjectCfg,
    RobotCfg,
)"""
_GAINS = """
                drive_pros=JointDrivePropertiesCfg(stiffness=1e4, damping=1e3),"""
_TARGETS = """\
actions:                           # joint targets around the initial pose, rad
  arm:
    func: default_offset_joint_position
    params:
      of: {{uid: {uid}}}
      scale: {scale}
      clip: [-1, 1]
"""
_CONTROLS = """\
actions:                           # controls of its actuators
  ctrl:
    func: actuator_ctrl
    params:
      of: {{uid: {uid}}}
"""
_STIFFNESS = 500.0
"""Stiffness of the drives of a robot without gains, N m/rad or N/m."""
_SUFFICIENT_REACH = 0.6
"""Share of the marker's radius: an arm that reaches less from its zero pose is bent."""
_CLIP = "      clip: [-1, 1]\n"
_TOOL_WORDS = ("tcp", "tool", "end_effector", "eef", "ee", "grasp", "grip", "pinch", "attachment")
"""Words in the names of sites and links at which tools are fixed: the first is preferred."""
_TOOL_NAME = re.compile(
    rf"(?:^|[/_])({'|'.join(_TOOL_WORDS)})(?:per)?0?(?:_site|_frame|_point|_center|_link)*$",
    re.IGNORECASE,
)
JAW_NAME = re.compile(r"grip|finger|jaw|claw|thumb", re.IGNORECASE)
"""How joints are called that move a single jaw of a gripper."""
_WHY_KEYFRAME = "the file's keyframe"
_WHY_ZERO = "zero; the middle of its range where a joint cannot be at zero"
_WHY_BENT = "bent from zero, so that the tool can move in all directions"
_FILE_DRIVES = "drive_pros: {stiffness: file}    # by the actuators of its file, as they are"


@dataclass(frozen=True, kw_only=True)
class _NewRobot:
    """What the templates of a task need to know about its robot.

    Attributes:
        uid: The robot's name in the scene.
        fpath: The robot's file, as `get_data_path` takes it.
        height: Height of its root above the ground, m.
        home: Initial joint positions, rad or m.
        tool: What has to reach the marker.
        marker: (x, y, z) of the tool at the start, m.
        radius: Largest distance of the marker from the tool, m.
        scale: Displacement for an action of 1, rad or m: one number, or joint -> number.
        axes: (3,) 1 for axes of the world along which the marker is moved, else 0.
        is_floating: Whether the base is not fixed to the world.
        max_effort: Effort limits of its drives as YAML; empty for none.
        has_drives: Whether the file has drives; an MJCF without actuators has none.
    """

    uid: str
    fpath: str
    height: float
    home: Sequence[float]
    tool: ToolFrame
    marker: Sequence[float]
    radius: float
    scale: float | Mapping[str, float]
    axes: Sequence[float] = (1.0, 1.0, 1.0)
    is_floating: bool = False
    max_effort: str = "file"
    has_drives: bool = True

    def words(self) -> dict[str, str]:
        """Return the template variables: the first block is for YAML, the second for Python."""
        halves = [self.radius * axis for axis in self.axes]
        scale = _map(self.scale) if isinstance(self.scale, Mapping) else _number(self.scale)
        drives = f"stiffness: {_STIFFNESS:g}, damping: 50"
        if self.max_effort:
            drives += f", max_effort: {self.max_effort}"
        standing = "gravcomp: 1                      # it does not sag"
        if self.is_floating:
            standing = "fix_base: false"
        pedestal = ""
        if self.height > 0 and not self.is_floating:
            pedestal = _PEDESTAL.format(height=_number(self.height))
        tool_keys = f"site: {self.tool.name}"
        if self.tool.kind == "link":
            tool_keys = f"link_names: [{self.tool.name}]"
        return {
            "uid": self.uid,
            "fpath": self.fpath,
            "position": _list((0.0, 0.0, self.height)),
            "home": _list(self.home),
            "standing": standing,
            "drives": f"drive_pros: {{{drives}}}",
            "tool": self.tool.name,
            "kind": self.tool.kind,
            "picked": tool_keys,
            "marker": _list(self.marker),
            "radius": _number(self.radius),
            "halves": _list(halves),
            # 0.0 - half, because -half would be written as -0 along an axis without motion
            "range": f"[{_list([0.0 - half for half in halves])}, {_list(halves)}]",
            "near": _number(round(min(0.05, 0.5 * self.radius), 2)),
            "far": _number(4 * self.radius),
            "actions": _TARGETS.format(uid=self.uid, scale=scale),
            "pedestal": pedestal,
            "tuple": f"(0.0, 0.0, {self.height})",
            "array": f"[{', '.join(map(repr, self.home))}]",
            "fixed": "fix_base=False" if self.is_floating else "gravcomp=1.0",
            "imports": _IMPORTS if self.has_drives else _DRIVEN_IMPORTS,
            "gains": "" if self.has_drives else _GAINS,
        }


@dataclass(frozen=True, eq=False)
class RobotFile:
    """A robot's file, and what was guessed of it.

    Attributes:
        parsed: The file.
        data: Its model in the guessed first pose.
        tool: What looks like its tool.
        home: (D,) joint positions of the first pose, rad or m.
        height: Height of its root above the ground, m.
        is_floating: Whether its base is not fixed to the world.
        is_urdf: Whether it is a URDF; else MJCF.
        legs: Those of a robot that walks.
        wheels: The joints that turn wheels, if they are all that it has.
        joints_without_effort: Joints whose effort limit in the URDF is 0: none is known.
        joints_without_velocity: Joints whose velocity limit in the URDF is 0, likewise.
        why_home: What the first pose was guessed from.
        why_floating: What was guessed from that its base floats; empty if it is fixed.
    """

    parsed: ParsedArticulation
    data: mujoco.MjData
    tool: ToolFrame
    home: tuple[float, ...]
    height: float
    is_floating: bool
    is_urdf: bool
    legs: tuple[Leg, ...] = ()
    wheels: tuple[str, ...] = ()
    joints_without_effort: tuple[str, ...] = ()
    joints_without_velocity: tuple[str, ...] = ()
    why_home: str = ""
    why_floating: str = ""


def read_robot_file(fpath: str, feet: Sequence[str] = (), *, shall_walk: bool = False) -> RobotFile:
    """Read a robot's file, and guess its tool and its first pose.

    Args:
        fpath: A URDF or MJCF, as `get_data_path` takes it.
        feet: The links or geoms on which it stands, of a robot that walks; without any they are
            guessed.
        shall_walk: Whether the robot is to walk, so that unequal chains may be legs too.

    Raises:
        ConfigError: If the file does not exist or cannot be read, if no joint can move, or if feet
            are not in it.
    """
    import mujoco
    import numpy as np

    from embodichain.lab.sim.compiler.robot.files.robot_files import locate, read_model

    file = read_model(locate(fpath))
    is_floating = bool((file.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any())
    parsed = _parse(fpath, is_floating)
    active = [i for i in range(len(parsed.joint_names)) if i not in parsed.mimic_ids]
    if not active:
        raise ConfigError(f"{parsed.path}: no joint moves: there is nothing to act on")
    warn_of_size(parsed)
    why_floating = _why_floating(parsed, is_floating, feet, shall_walk=shall_walk)
    if why_floating and not is_floating:
        is_floating = True
        parsed = _parse(fpath, is_floating)
    data = _first_state(parsed, is_floating)
    tool = _find_tool(parsed)
    why_home = _WHY_KEYFRAME
    legs: list[Leg] = []
    if parsed.keyframe is None:
        why_home = _WHY_ZERO
    wheels = find_wheels(parsed.model, data)
    if is_floating and not wheels:
        mujoco.mj_comPos(parsed.model, data)
        legs = _legs(parsed, data, feet)
        if parsed.keyframe is None:
            bent = stand(parsed.model, data, legs, yields=_yields(parsed))
            if bent:
                why_home = "legs bent until the feet are below the hips"
                if len(legs) > 2:
                    why_home += " under the weight, and spread a little"
                if any(spreads(parsed.model, data, leg) for leg in legs if leg.foot in bent):
                    why_home = "legs spread and bent until the feet are below the trunk"
            aside = legs_aside(parsed.model, data, [leg for leg in legs if leg.foot not in bent])
            if aside:
                why_home += f"; no such pose was found for {', '.join(aside)}: give one in which"
                why_home += " it stands"
    elif parsed.keyframe is None and not wheels and not _unservoed_joints(parsed, active):
        before = data.qpos.copy()
        scales = _scales(parsed, active)
        joints = list(scales)
        reach = ToolReach(parsed.model, data, tool, joints, scale=np.array(list(scales.values())))
        _bend(parsed, data, reach, joints, _SUFFICIENT_REACH * 0.2)
        if (data.qpos != before).any():
            why_home = _WHY_BENT
    lift = _lift(lowest_point(parsed.model, data), is_floating)
    return RobotFile(
        parsed=parsed,
        data=data,
        tool=tool,
        home=tuple(round(float(data.joint(n).qpos[0]), 3) + 0.0 for n in parsed.joint_names),
        height=lift + float(parsed.placement.root_pos[2]) if is_floating else lift,
        is_floating=is_floating,
        is_urdf=file.is_urdf,
        legs=tuple(legs),
        wheels=tuple(wheels),
        joints_without_effort=tuple(
            parsed.joint_names[i]
            for i in active
            if parsed.joint_names[i] in file.limits.zero_effort
        ),
        joints_without_velocity=tuple(
            parsed.joint_names[i] for i in active if parsed.joint_names[i] in parsed.zero_velocity
        ),
        why_home=why_home,
        why_floating=why_floating,
    )


def _why_floating(
    parsed: ParsedArticulation, has_free_joint: bool, feet: Sequence[str], *, shall_walk: bool
) -> str:
    """What says that a robot's base floats, which a URDF does not tell; empty if nothing does.

    Raises:
        ConfigError: If feet are not in the file, or no hinge moves them.
    """
    import mujoco

    if feet:
        _check_feet(parsed, feet)
        return "--feet names what it stands on"
    if has_free_joint:
        return "the file has a free joint"
    named = [name for name in parsed.link_names if FOOT_NAME.search(name)]
    if len(named) > 1:
        return "links are called feet"
    data = _first_state(parsed, is_floating=False)
    mujoco.mj_comPos(parsed.model, data)
    limbs = find_limbs(parsed.model, data, parsed.root_link_name)
    if limbs:
        joints = len(limbs[0].joints)
        root = parsed.root_link_name
        return f"{len(limbs)} equal chains of {joints} joints begin at {root}, as legs do"
    if find_wheels(parsed.model, data):
        return "its joints turn wheels"
    if shall_walk and len(find_legs(parsed.model, data, parsed.link_names)) > 1:
        return "it is to walk, and chains of joints end below its trunk"
    return ""


def _check_feet(parsed: ParsedArticulation, feet: Sequence[str]) -> None:
    """Refuse feet that are not in the file, or that do not move."""
    existing_names = [*parsed.link_names, *parsed.geom_names]
    for name in feet:
        if name not in existing_names:
            hint = did_you_mean(name, existing_names)
            links = listing(parsed.link_names)
            raise ConfigError(f"--feet: {parsed.path} has no link '{name}'{hint}; links: {links}")
    still = [
        leg.foot
        for leg in legs_with_feet(parsed.model, _first_state(parsed, False), feet)
        if not leg.joints
    ]
    if still:
        raise ConfigError(f"--feet: no hinge moves {', '.join(still)}: a foot is the end of a leg")


def _legs(parsed: ParsedArticulation, data: mujoco.MjData, feet: Sequence[str]) -> list[Leg]:
    """The legs with these feet; without any, those that are called so or look like it."""
    if feet:
        return legs_with_feet(parsed.model, data, feet)
    legs = find_legs(parsed.model, data, parsed.link_names)
    limbs = find_limbs(parsed.model, data, parsed.root_link_name)
    if len(legs) < 2 and limbs:
        return legs_with_feet(parsed.model, data, [limb.end for limb in limbs])
    return legs


@dataclass(frozen=True)
class DescribedRobot:
    """A robot as the templates of a task without a kind have it.

    Attributes:
        words: The template variables.
        file_dt: The time step of an MJCF, s; None for a URDF.
        guesses: What was guessed.
    """

    words: dict[str, str]
    file_dt: float | None
    guesses: Sequence[Guess]


def describe_robot(fpath: str, *, python: bool) -> DescribedRobot:
    """Read a robot's file, and guess what a task without a kind needs to know of it.

    Args:
        fpath: A URDF or MJCF, as `get_data_path` takes it.
        python: Whether the task is a class, which sets joint targets.

    Raises:
        ConfigError: If the file does not exist or cannot be read, if no joint can move, or if the
            task is a class and joints have no position targets.
    """
    import mujoco
    import numpy as np

    from embodichain.lab.sim.compiler.robot.files.robot_files import locate, read_model

    file = read_model(locate(fpath))
    is_floating = bool((file.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any())
    parsed = _parse(fpath, is_floating)
    active = [i for i in range(len(parsed.joint_names)) if i not in parsed.mimic_ids]
    if not active:
        raise ConfigError(f"{parsed.path}: no joint moves: there is nothing to act on")
    warn_of_size(parsed)
    unservoed_joints = _unservoed_joints(parsed, active)
    if python and unservoed_joints:
        message = "a Python task sets joint targets, and these joints have no position servo: "
        raise ConfigError(f"--python: {message}{', '.join(unservoed_joints)}; leave --python out")

    data = _first_state(parsed, is_floating)
    wheels = find_wheels(parsed.model, data)
    if wheels:
        raise ConfigError(f"{parsed.path}: {only_wheels(wheels)}")
    tool = _find_tool(parsed)
    why_home = _WHY_KEYFRAME if parsed.keyframe is not None else _WHY_ZERO
    why_radius = "a quarter of the tool's distance from the root, and 0.2 m at most"
    scales = _scales(parsed, active)
    reach_from_root = math.dist(tool.pos(data), data.body(parsed.root_link_name).xpos)
    radius = min(0.2, max(0.04, 0.25 * reach_from_root))
    axes = np.ones(3)
    # The reach of a base that moves, or of joints that drift, is not known from a pose.
    if not is_floating and not unservoed_joints:
        joints = list(scales)
        reach = ToolReach(parsed.model, data, tool, joints, scale=np.array(list(scales.values())))
        if parsed.keyframe is None:
            before = data.qpos.copy()
            _bend(parsed, data, reach, joints, _SUFFICIENT_REACH * radius)
            if (data.qpos != before).any():
                why_home = _WHY_BENT
        pose = np.array([data.joint(name).qpos[0] for name in joints])
        reached = reach.radius(pose, radius)
        if reached:
            radius = reached
            why_radius = "the actions reach all of these places"
        if reach.axes.any():
            axes = reach.axes.astype(float)

    lift = _lift(lowest_point(parsed.model, data), is_floating)
    height = lift
    if is_floating:
        height += float(parsed.placement.root_pos[2])
    x, y, z = tool.pos(data).tolist()
    efforts = parsed.qf_limits[active]
    limits = EffortLimits("file" if bool(((efforts > 0) & (efforts < math.inf)).all()) else "")
    if not is_floating:
        zero_effort = [name for name in parsed.joint_names if name in file.limits.zero_effort]
        limits = guess_effort_limits(parsed, _STIFFNESS, zero_effort)
    scale: float | Mapping[str, float] = scales
    if len(set(scales.values())) == 1:
        scale = next(iter(scales.values()))
    robot = _NewRobot(
        uid=parsed.uid,
        fpath=fpath,
        height=height,
        home=[round(float(data.joint(name).qpos[0]), 4) for name in parsed.joint_names],
        tool=tool,
        marker=[round(value, 2) + 0.0 for value in (x, y, z + lift)],
        radius=math.floor(100 * radius + 1e-6) / 100,
        scale=scale,
        axes=axes.tolist(),
        is_floating=is_floating,
        max_effort=limits.value,
        has_drives=bool(parsed.control_names),
    )
    words = robot.words()
    if parsed.own_actuators:
        words["drives"] = _FILE_DRIVES
    if unservoed_joints:
        words["actions"] = _CONTROLS.format(uid=robot.uid)
        if not np.isfinite(parsed.ctrl_limits).all():
            words["actions"] += _CLIP
    guesses = [Guess("robot.init_qpos", words["home"], why_home)]
    if lift:
        why_lift = "its lowest point is on the ground"
        if not is_floating:
            why_lift = "lower, a part would be in the ground"
        guesses.insert(0, Guess("robot.init_pos", words["position"], why_lift))
    guesses.append(Guess("tool", f"{tool.kind} {tool.name}", _why_tool(tool)))
    if not python:
        guesses.append(_drives_of(words["drives"], limits, parsed))
    place = f"within {words['radius']} m of the tool"
    guesses.append(Guess("marker", place, why_radius))
    return DescribedRobot(
        words=words,
        file_dt=None if file.is_urdf else float(file.spec.option.timestep),
        guesses=guesses,
    )


def _why_tool(tool: ToolFrame) -> str:
    """What a tool was guessed from."""
    if _TOOL_NAME.search(tool.name):
        return f"a {tool.kind} that is called so"
    return "the link at the end of the longest chain of joints, before its fingers"


def _drives_of(words: str, limits: EffortLimits, parsed: ParsedArticulation) -> Guess:
    """The drives of a task without a kind, as its YAML has them."""
    value = words.partition("#")[0].removeprefix("drive_pros:").strip()
    if parsed.own_actuators:
        return Guess("robot.drive_pros", value, "its joints are moved by the actuators of the file")
    why = "the file has no gains: tune them"
    if limits.why:
        why += f"; {limits.why}"
    if parsed.zero_velocity:
        why += f"; the file's velocities of 0 ({some_of(parsed.zero_velocity)}) are taken as no "
        why += "limit"
    return Guess("robot.drive_pros", value, why)


def _parse(fpath: str, is_floating: bool) -> ParsedArticulation:
    """Parse the robot's file, under a name made from the file's.

    Raises:
        ConfigError: If the file has mistakes.
    """
    from embodichain.lab.sim.cfg import RobotCfg
    from embodichain.lab.sim.compiler.robot.articulation import parse_with_problems

    uid = re.sub(r"\W+", "_", Path(fpath).stem).strip("_").lower() or "robot"
    if uid in _RESERVED_UIDS:
        uid = f"{uid}_robot"
    cfg = RobotCfg(uid=uid, fpath=fpath, fix_base=not is_floating)
    parsed, problems = parse_with_problems(uid, cfg)
    if parsed is None:
        raise ConfigError(problems)
    return parsed


def _unservoed_joints(parsed: ParsedArticulation, active: Sequence[int]) -> list[str]:
    """Joints that have no position target, because the file's own actuators give them none."""
    if not parsed.own_actuators:
        return []
    return [parsed.joint_names[i] for i in active if not parsed.drives[i]]


def _yields(parsed: ParsedArticulation) -> bool:
    """Whether a robot has no position servo of its file, so that an embodiment gives it drives."""
    return not (parsed.own_actuators and any(parsed.drives))


def _first_state(parsed: ParsedArticulation, is_floating: bool) -> mujoco.MjData:
    """The robot in its first pose, with a floating base at its height above the origin."""
    import mujoco

    model = parsed.model
    data = mujoco.MjData(model)
    for name, value in zip(parsed.joint_names, _home(parsed), strict=True):
        data.joint(name).qpos = value
    if is_floating:
        root_joint = model.body(parsed.root_link_name).jntadr[0]
        start = int(model.jnt_qposadr[root_joint])
        height = parsed.placement.root_pos[2]
        data.qpos[start : start + 7] = [0.0, 0.0, height, *parsed.placement.root_quat]
    mujoco.mj_kinematics(model, data)
    return data


def _lift(lowest: float, is_floating: bool) -> float:
    """Height in metres, to whole centimetres, by which a robot is lifted out of the ground.

    A floating base is lowered too, if it hangs in the air.
    """
    height = -lowest
    if not is_floating:
        height = max(0.0, height)
    return math.ceil(100 * height - 1e-6) / 100


@dataclass(frozen=True)
class _Mimic:
    """A joint that follows another: its position is `multiplier * leader + offset`.

    Attributes:
        joint: Index of the joint.
        leader: Index of the joint that it follows.
        multiplier: Its motion by the leader's.
        offset: Its position where the leader's is 0, rad or m.
    """

    joint: int
    leader: int
    multiplier: float
    offset: float


def _mimics(parsed: ParsedArticulation) -> list[_Mimic]:
    """The joints that follow others."""
    columns = zip(
        parsed.mimic_ids,
        parsed.mimic_parents,
        parsed.mimic_multipliers,
        parsed.mimic_offsets,
        strict=True,
    )
    return [
        _Mimic(joint=int(joint), leader=int(leader), multiplier=multiplier, offset=offset)
        for joint, leader, multiplier, offset in columns
    ]


def _bend(
    parsed: ParsedArticulation,
    data: mujoco.MjData,
    reach: ToolReach,
    joints: list[str],
    sufficient_reach: float,
) -> None:
    """Set `data` to a pose near the present one from which the tool reaches far enough, in m."""
    import mujoco
    import numpy as np

    types = np.array([parsed.model.joint(name).type[0] for name in joints])
    pose = bent_home(reach, types == mujoco.mjtJoint.mjJNT_HINGE, sufficient_reach)
    for name, value in zip(joints, pose, strict=True):
        data.joint(name).qpos = value
    for mimic in _mimics(parsed):
        leader = data.joint(parsed.joint_names[mimic.leader]).qpos[0]
        follower = data.joint(parsed.joint_names[mimic.joint])
        follower.qpos = mimic.multiplier * leader + mimic.offset
    mujoco.mj_kinematics(parsed.model, data)


def _home(parsed: ParsedArticulation) -> list[float]:
    """The file's keyframe, else zero; the middle of the range if that is not inside the limits.

    The range of a joint that others mimic is the part where they are inside their limits too. If
    there is none, `validate` reports the joints.
    """
    mimics = _mimics(parsed)
    limits = [(float(low), float(high)) for low, high in parsed.qpos_limits]
    for mimic in mimics:
        if mimic.multiplier:
            limits[mimic.leader] = _narrowed(limits[mimic.leader], limits[mimic.joint], mimic)
    home = [float(value) for value in parsed.init_qpos]
    for i, (low, high) in enumerate(limits):
        margin = 0.0
        # A keyframe is meant as it is, at the end of a range too.
        if math.isfinite(high - low) and parsed.keyframe is None:
            margin = 0.05 * (high - low)
        if low + margin <= home[i] <= high - margin:
            continue
        middle = 0.5 * (low + high)
        if math.isfinite(middle):
            home[i] = middle
        else:
            home[i] = min(max(home[i], low), high)
    for mimic in mimics:
        home[mimic.joint] = mimic.multiplier * home[mimic.leader] + mimic.offset
    return home


def _narrowed(
    leader: tuple[float, float], follower: tuple[float, float], mimic: _Mimic
) -> tuple[float, float]:
    """A leader's limits where its follower is inside its own too; unchanged if that is nowhere."""
    ends = sorted((end - mimic.offset) / mimic.multiplier for end in follower)
    low = max(ends[0], leader[0])
    high = min(ends[1], leader[1])
    if low > high:
        return leader
    return low, high


class _ChainRank(NamedTuple):
    """The rank of a chain of links: the tool is at the end of the chain with the largest.

    Attributes:
        joints: Its hinges; its slides if it has no hinge.
        minus_slides: Minus its slides, if it has hinges: fingers slide, and are past the tool.
        depth: Its links.
    """

    joints: int
    minus_slides: int
    depth: int


def _chain_rank(model: mujoco.MjModel, body: int) -> _ChainRank:
    """The rank of the chain from the world to a body."""
    import mujoco

    depth = 0
    types: list[int] = []
    while body > 0:
        types += model.jnt_type[model.jnt_bodyid == body].tolist()
        body = int(model.body_parentid[body])
        depth += 1
    hinges = types.count(mujoco.mjtJoint.mjJNT_HINGE)
    slides = types.count(mujoco.mjtJoint.mjJNT_SLIDE)
    if hinges:
        return _ChainRank(joints=hinges, minus_slides=-slides, depth=depth)
    return _ChainRank(joints=slides, minus_slides=0, depth=depth)


def _find_tool(parsed: ParsedArticulation) -> ToolFrame:
    """Find a site or a link that has a tool's name, in the last half of a chain.

    If there is none, it is the link at the end of the longest chain of hinges, before sliding
    fingers.
    """
    model = parsed.model
    link_ids = {name: model.body(name).id for name in parsed.link_names}
    ranks = {name: _chain_rank(model, body) for name, body in link_ids.items()}
    links = sorted(link_ids, key=lambda name: link_ids[name])
    last_link = max(links, key=lambda name: ranks[name])

    bodies = {ToolFrame("link", name): body for name, body in link_ids.items()}
    for name in parsed.site_names:
        bodies[ToolFrame("site", name)] = int(model.site(name).bodyid[0])
    candidates: list[tuple[int, bool, int, ToolFrame]] = []
    for frame, body in bodies.items():
        word = _TOOL_NAME.search(frame.name)
        if word is None:
            continue
        rank = _chain_rank(model, body)
        if 2 * rank.joints >= ranks[last_link].joints:
            preference = _TOOL_WORDS.index(word[1].lower())
            # Sites before links, then the one that is farthest from the root.
            candidates.append((preference, frame.kind == "link", -rank.depth, frame))
    if not candidates:
        return ToolFrame("link", _hand_below(model, last_link))
    return min(candidates)[-1]


def _hand_below(model: mujoco.MjModel, link: str) -> str:
    """The link that carries several moving ones, if `link` is one of them, else `link` itself.

    A hand carries its fingers; what carries all joints of an arm but two is no hand.
    """
    body = int(model.body(link).id)
    joints = _chain_rank(model, body).joints
    if model.body_jntnum[body] and JAW_NAME.search(model.joint(model.body_jntadr[body]).name):
        return str(model.body(int(model.body_parentid[body])).name)
    while body:
        parent = int(model.body_parentid[body])
        if 2 * _chain_rank(model, parent).joints < joints:
            return link
        branches = [
            child
            for child in range(1, model.nbody)
            if int(model.body_parentid[child]) == parent and _has_joint(model, child)
        ]
        if len(branches) > 1:
            return str(model.body(parent).name)
        body = parent
    return link


def _has_joint(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body, or one that it carries, moves relative to its parent."""
    if model.body_jntnum[body]:
        return True
    children = [i for i in range(body + 1, model.nbody) if int(model.body_parentid[i]) == body]
    return any(_has_joint(model, child) for child in children)


def _scales(parsed: ParsedArticulation, active: list[int]) -> dict[str, float]:
    """Joint -> 0.6 rad for hinges; a quarter of the range, at most 0.1 m, for slides."""
    import mujoco

    scales: dict[str, float] = {}
    for i in active:
        name = parsed.joint_names[i]
        scales[name] = 0.6
        if parsed.model.joint(name).type[0] == mujoco.mjtJoint.mjJNT_SLIDE:
            low, high = parsed.qpos_limits[i]
            scales[name] = float(f"{min(0.1, 0.25 * (high - low)):.1g}")
    return scales


def _number(value: float) -> str:
    """A number without trailing zeros."""
    return f"{round(value, 4):g}"


def _list(values: Sequence[float]) -> str:
    return f"[{', '.join(map(_number, values))}]"


def _map(values: Mapping[str, float]) -> str:
    """Joint -> number as YAML, one key for each joint."""
    items = [f"{json.dumps(re.escape(name))}: {_number(value)}" for name, value in values.items()]
    return f"{{{', '.join(items)}}}"


UR10 = _NewRobot(
    uid="ur10",
    fpath="UniversalRobots/UR10/UR10.urdf",
    height=1.0,
    home=(1.57, -1.57, 1.57, -1.57, -1.57, 0.0),
    tool=ToolFrame("link", "ee_link"),
    marker=(-0.16, 0.69, 1.65),
    radius=0.2,
    scale=0.6,
).words()
"""The robot of a new task by default: the bundled one, at a table's height."""

"""The robot of a new task: `describe_robot` reads its file and returns template variables."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.cli.new_task.new_home import bent_home, lowest_point
from embodichain.cli.new_task.new_reach import ToolReach
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation

__all__ = ["UR10", "describe_robot"]

_TAKEN = ("marker", "pedestal", "default_plane")
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
_ENOUGH = 0.6
"""Of the wanted radius: an arm that reaches less of it from its zero pose is bent."""
_KEY = 1000
"""Characters of a key in a flow mapping; YAML 1.2, section 7.4.2, allows 1024 with its quotes."""
_CLIP = "      clip: [-1, 1]\n"
_TOOLS = ("tcp", "tool", "end_effector", "eef", "ee", "grasp", "grip", "pinch", "attachment")
"""How sites and links are called at which tools are, or are fixed: the first is preferred."""
_TOOL = re.compile(
    rf"(?:^|[/_])({'|'.join(_TOOLS)})(?:per)?0?(?:_site|_frame|_point|_center|_link)*$",
    re.IGNORECASE,
)
_FILE_DRIVES = "drive_pros: {stiffness: file}    # by the actuators of its file, as they are"


def _words(
    uid: str,
    fpath: str,
    height: float,
    home: Sequence[float],
    tool: tuple[str, str],
    marker: Sequence[float],
    radius: float,
    scale: float | Mapping[str, float],
    *,
    axes: Sequence[float] = (1.0, 1.0, 1.0),
    floating: bool = False,
    limited: bool = True,
    bare: bool = False,
) -> dict[str, str]:
    """The template variables.

    Args:
        uid: The robot's name in the scene.
        fpath: The robot's file, as `get_data_path` takes it.
        height: Height of its root above the ground, m.
        home: Initial joint positions, rad or m.
        tool: What has to reach the marker: "link" or "site", and its name.
        marker: (x, y, z) of the tool at the start, m.
        radius: Largest distance of the marker from the tool, m.
        scale: Displacement for an action of 1, rad or m: one number, or joint -> number.
        axes: (3,) 1 for axes of the world along which the marker is moved, else 0.
        floating: Whether the base is not fixed to the world.
        limited: Whether the file has an effort limit for every driven joint.
        bare: Whether the file has no drives: an MJCF without actuators.
    """
    effort = ", max_effort: file" if limited else ""
    pedestal = ""
    if height > 0 and not floating:
        pedestal = _PEDESTAL.format(height=_number(height))
    halves = [radius * axis for axis in axes]
    one = _map(scale) if isinstance(scale, Mapping) else _number(scale)
    return {
        "uid": uid,
        "fpath": fpath,
        "position": _list((0.0, 0.0, height)),
        "home": _list(home),
        "standing": "fix_base: false"
        if floating
        else "gravcomp: 1                      # it does not sag",
        "drives": f"drive_pros: {{stiffness: 500, damping: 50{effort}}}",
        "tool": tool[1],
        "kind": tool[0],
        "picked": f"link_names: [{tool[1]}]" if tool[0] == "link" else f"site: {tool[1]}",
        "marker": _list(marker),
        "radius": _number(radius),
        "halves": _list(halves),
        "range": f"[{_list([0.0 - half for half in halves])}, {_list(halves)}]",
        "near": _number(round(min(0.05, 0.5 * radius), 2)),
        "far": _number(4 * radius),
        "actions": _TARGETS.format(uid=uid, scale=one),
        "pedestal": pedestal,
        "tuple": f"(0.0, 0.0, {height})",
        "array": f"[{', '.join(map(repr, home))}]",
        "fixed": "fix_base=False" if floating else "gravcomp=1.0",
        "imports": _DRIVEN_IMPORTS if bare else _IMPORTS,
        "gains": _GAINS if bare else "",
    }


def describe_robot(fpath: str, *, python: bool) -> tuple[dict[str, str], float | None]:
    """Read a robot's file; returns the template variables, and the time step of an MJCF in s.

    Args:
        fpath: A URDF or MJCF, as `get_data_path` takes it.
        python: Whether the task is a class, which sets joint targets.

    Raises:
        ConfigError: If the file does not exist or cannot be read, if no joint can move, or if the
            task is a class and joints have no position targets.
    """
    import mujoco
    import numpy as np

    from embodichain.lab.sim.cfg import RobotCfg
    from embodichain.lab.sim.compiler.robot.articulation import parse_with_problems
    from embodichain.lab.sim.compiler.robot.files.robot_files import locate, read_model

    file = read_model(locate(fpath))
    types = file.model.jnt_type
    floating = bool((types == mujoco.mjtJoint.mjJNT_FREE).any())
    uid = re.sub(r"\W+", "_", Path(fpath).stem).strip("_").lower() or "robot"
    uid = f"{uid}_robot" if uid in _TAKEN else uid
    cfg = RobotCfg(uid=uid, fpath=fpath, fix_base=not floating)
    parsed, problems = parse_with_problems(uid, cfg)
    if parsed is None:
        raise ConfigError(problems)
    names = parsed.joint_names
    active = [i for i in range(len(names)) if i not in parsed.mimic_ids]
    if not active:
        raise ConfigError(f"{parsed.path}: no joint moves: there is nothing to act on")
    passive = [names[i] for i in active if not parsed.drives[i]] if parsed.own_actuators else []
    if python and passive:
        message = "a Python task sets joint targets, and these joints have no position servo: "
        raise ConfigError(f"--python: {message}{', '.join(passive)}; leave --python out")

    data = mujoco.MjData(parsed.model)
    for name, value in zip(names, _home(parsed), strict=True):
        data.joint(name).qpos = value
    root = parsed.placement.root_pos
    if floating:
        at = int(parsed.model.jnt_qposadr[parsed.model.body(parsed.root_link_name).jntadr[0]])
        data.qpos[at : at + 7] = [0.0, 0.0, root[2], *parsed.placement.root_quat]
    mujoco.mj_kinematics(parsed.model, data)
    kind, tool = _tool(parsed)
    place = data.body(tool).xpos if kind == "link" else data.site(tool).xpos
    length = math.dist(place, data.body(parsed.root_link_name).xpos)
    scale = _scales(parsed, active)
    radius = min(0.2, max(0.04, 0.25 * length))
    axes = np.ones(3)
    if not (floating or passive):
        moves = np.array(list(scale.values()))
        reach = ToolReach(parsed.model, data, (kind, tool), list(scale), moves)
        if parsed.keyframe is None:
            _bend(parsed, data, reach, list(scale), _ENOUGH * radius)
        pose = np.array([data.joint(name).qpos[0] for name in scale])
        radius = reach.radius(pose, radius) or radius
        axes = reach.axes.astype(float) if reach.axes.any() else axes
    lowest = lowest_point(parsed.model, data)
    lift = math.ceil(100 * (-lowest if floating else max(0.0, -lowest)) - 1e-6) / 100
    x, y, z = place.tolist()
    limits = parsed.qf_limits[active]
    words = _words(
        uid=uid,
        fpath=fpath,
        height=lift + float(root[2]) if floating else lift,
        home=[round(float(data.joint(name).qpos[0]), 4) for name in names],
        tool=(kind, tool),
        marker=[round(value, 2) + 0.0 for value in (x, y, z + lift)],
        radius=math.floor(100 * radius + 1e-6) / 100,
        axes=axes.tolist(),
        scale=next(iter(scale.values())) if len(set(scale.values())) == 1 else scale,
        floating=floating,
        limited=bool(((limits > 0) & (limits < math.inf)).all()),
        bare=not parsed.control_names,
    )
    if parsed.own_actuators:
        words["drives"] = _FILE_DRIVES
    if passive:
        bounded = np.isfinite(parsed.ctrl_limits).all()
        words["actions"] = _CONTROLS.format(uid=uid) + ("" if bounded else _CLIP)
    return words, None if file.is_urdf else float(file.spec.option.timestep)


def _bend(
    parsed: ParsedArticulation,
    data: mujoco.MjData,
    reach: ToolReach,
    joints: list[str],
    enough: float,
) -> None:
    """Set `data` to a pose near the present one from which the tool reaches `enough`, m."""
    import mujoco
    import numpy as np

    hinges = np.array([parsed.model.joint(name).type[0] for name in joints])
    pose = bent_home(reach, hinges == mujoco.mjtJoint.mjJNT_HINGE, enough)
    for name, value in zip(joints, pose, strict=True):
        data.joint(name).qpos = value
    linear = zip(parsed.mimic_ids, parsed.mimic_parents, strict=True)
    factors = zip(parsed.mimic_multipliers, parsed.mimic_offsets, strict=True)
    for (i, parent), (multiplier, offset) in zip(linear, factors, strict=True):
        leader = data.joint(parsed.joint_names[parent]).qpos[0]
        data.joint(parsed.joint_names[i]).qpos = multiplier * leader + offset
    mujoco.mj_kinematics(parsed.model, data)


def _home(parsed: ParsedArticulation) -> list[float]:
    """The file's keyframe, else zero; the middle of the range if that is not inside the limits.

    The range of a joint that others mimic is the part where they are inside their limits too. If
    there is none, `validate` reports the joints.
    """
    home = [float(value) for value in parsed.init_qpos]
    limits = [(float(low), float(high)) for low, high in parsed.qpos_limits]
    mimics = parsed.mimic_ids, parsed.mimic_parents
    linear = parsed.mimic_multipliers, parsed.mimic_offsets
    follows = list(zip(*mimics, *linear, strict=True))
    for i, parent, multiplier, offset in follows:
        if multiplier:
            ends = sorted((end - offset) / multiplier for end in limits[i])
            low, high = max(ends[0], limits[parent][0]), min(ends[1], limits[parent][1])
            limits[parent] = (low, high) if low <= high else limits[parent]
    for i, (low, high) in enumerate(limits):
        margin = 0.05 * (high - low) if math.isfinite(high - low) else 0.0
        if not low + margin <= home[i] <= high - margin:
            middle = 0.5 * (low + high)
            home[i] = middle if math.isfinite(middle) else min(max(home[i], low), high)
    for i, parent, multiplier, offset in follows:
        home[i] = multiplier * home[parent] + offset
    return home


def _tool(parsed: ParsedArticulation) -> tuple[str, str]:
    """Kind and name: a site or a link that is called as tools are, in the last half of a chain.

    Else the link at the end of the longest chain of hinges, before sliding fingers.
    """
    import mujoco

    model = parsed.model

    def rank(body: int) -> tuple[int, int, int]:
        depth, kinds = 0, []
        while body > 0:
            kinds += model.jnt_type[model.jnt_bodyid == body].tolist()
            body, depth = int(model.body_parentid[body]), depth + 1
        hinges = kinds.count(mujoco.mjtJoint.mjJNT_HINGE)
        slides = kinds.count(mujoco.mjtJoint.mjJNT_SLIDE)
        return (hinges, -slides, depth) if hinges else (slides, 0, depth)

    bodies = {name: model.body(name).id for name in parsed.link_names}
    links = sorted(bodies, key=lambda name: bodies[name])
    last = max(links, key=lambda name: rank(bodies[name]))
    sites = {name: int(model.site(name).bodyid[0]) for name in parsed.site_names}
    tools = []
    for kind, places in (("site", sites), ("link", bodies)):
        for name, body in places.items():
            word = _TOOL.search(name)
            joints, _, depth = rank(body)
            if word and 2 * joints >= rank(bodies[last])[0]:
                tools.append((_TOOLS.index(word[1].lower()), kind == "link", -depth, kind, name))
    return min(tools)[3:] if tools else ("link", last)


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
    """Joint -> number as YAML; one regex for all joints with the same number, if it is a key."""
    groups: dict[float, list[str]] = {}
    for name, value in values.items():
        groups.setdefault(value, []).append(name)
    parts = []
    for value, names in groups.items():
        regex = _regex(names, values)
        keys = [regex] if len(regex) <= _KEY else map(re.escape, names)
        parts += [f"{json.dumps(key)}: {_number(value)}" for key in keys]
    return f"{{{', '.join(parts)}}}"


def _regex(names: Sequence[str], all_names: Iterable[str]) -> str:
    """A regex that matches only these names: their common prefix if that is enough."""
    start = os.path.commonprefix(list(names))
    if start and len(names) > 1 and sum(n.startswith(start) for n in all_names) == len(names):
        return f"{re.escape(start)}.*"
    return "|".join(map(re.escape, names))


UR10 = _words(
    uid="ur10",
    fpath="UniversalRobots/UR10/UR10.urdf",
    height=1.0,
    home=(1.57, -1.57, 1.57, -1.57, -1.57, 0.0),
    tool=("link", "ee_link"),
    marker=(-0.16, 0.69, 1.65),
    radius=0.2,
    scale=0.6,
)
"""The robot of a new task by default: the bundled one, at a table's height."""

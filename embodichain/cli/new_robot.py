"""The robot of a new task: `describe_robot` reads its file, `robot_words` fills templates."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler import ParsedArticulation

__all__ = ["UR10", "RobotFacts", "describe_robot", "robot_words"]

_TAKEN = ("marker", "pedestal", "default_plane")

_PEDESTAL = """\
  pedestal:                        # to look at: the base stands in it, so that nothing may collide
    shape:
      shape_type: Cylinder
      radius: 0.1
      height: {height}
      visual_material: {{base_color: [0.3, 0.32, 0.35, 1]}}
    body_type: static
    attrs: {{enable_collision: false}}
    init_pos: [0, 0, {middle}]
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
      of: {{uid: {uid}}}{bounds}
"""


@dataclass(frozen=True, slots=True)
class RobotFacts:
    """A robot as a task's files name it.

    Attributes:
        uid: Its name in the scene.
        fpath: Its file, as it is looked up.
        position: (x, y, z) of its root, m; on or above the ground.
        home: Initial joint positions, rad or m.
        tool: The link that reaches.
        floating: Whether it stands on its own feet.
        limited: Whether its file has an effort limit for every driven joint.
        scale: What an action of 1 means, rad or m: one number, or joint -> number.
        radius: How far the marker may be from the tool, m.
        marker: (x, y, z) of the tool at the start, m.
        own_actuators: Whether its file has actuators (MJCF), which then drive it.
        passive: Joints without a drive or a servo; then actions are its actuators' controls.
        unbounded: Whether one of these has no range.
        bare: Whether nothing drives it but what `drive_pros` names (an MJCF without actuators).
    """

    uid: str
    fpath: str
    position: tuple[float, ...]
    home: tuple[float, ...]
    tool: str
    floating: bool
    limited: bool
    scale: float | dict[str, float]
    radius: float
    marker: tuple[float, ...]
    own_actuators: bool = False
    passive: tuple[str, ...] = ()
    unbounded: bool = False
    bare: bool = False


UR10 = RobotFacts(
    uid="ur10",
    fpath="UniversalRobots/UR10/UR10.urdf",
    position=(0.0, 0.0, 1.0),
    home=(1.57, -1.57, 1.57, -1.57, -1.57, 0.0),
    tool="ee_link",
    floating=False,
    limited=True,
    scale=0.6,
    radius=0.2,
    marker=(-0.16, 0.69, 1.65),
)
"""The robot of a task for which none is named: the one that is bundled, on a table's height."""


def describe_robot(fpath: str) -> RobotFacts:
    """Read a robot's file.

    Args:
        fpath: A URDF or MJCF, as `get_data_path` takes it.

    Raises:
        ConfigError: If there is no such file, it cannot be read, or none of its joints moves.
    """
    from embodichain.lab.sim.cfg import RobotCfg
    from embodichain.lab.sim.compiler.articulation import parse_with_problems
    from embodichain.lab.sim.compiler.model_files import locate, read_model

    floating = _is_floating(read_model(locate(fpath)).model)
    uid = re.sub(r"\W+", "_", Path(fpath).stem).strip("_").lower() or "robot"
    uid = f"{uid}_robot" if uid in _TAKEN else uid
    parsed, problems = parse_with_problems(
        uid, RobotCfg(uid=uid, fpath=fpath, fix_base=not floating)
    )
    if parsed is None:
        raise ConfigError(problems)
    active = [i for i in range(len(parsed.joint_names)) if i not in parsed.mimic_ids]
    if not active:
        raise ConfigError(f"{parsed.path}: no joint moves: there is nothing to act on")
    return _facts(parsed, fpath, active, floating)


def _is_floating(model: Any) -> bool:
    """Whether a file has a free joint: it is not fixed to the world."""
    import mujoco

    return bool((model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any())


def _facts(parsed: ParsedArticulation, fpath: str, active: list[int], floating: bool) -> RobotFacts:
    import mujoco
    import numpy as np

    model, names = parsed.model, parsed.joint_names
    home = _home(parsed)
    data = mujoco.MjData(model)
    for name, value in zip(names, home, strict=True):
        data.joint(name).qpos = value
    mujoco.mj_kinematics(model, data)
    lowest = _lowest(model, data)
    lift = -lowest if floating else max(0.0, -lowest)
    lift = math.ceil(100 * lift - 1e-6) / 100
    tool = _tool(parsed)
    place = data.body(tool).xpos
    length = math.dist(place, data.body(parsed.root_link_name).xpos)
    limits = parsed.qf_limits[active]
    passive = [names[i] for i in active if not parsed.drives[i]] if parsed.own_actuators else []
    return RobotFacts(
        uid=parsed.uid,
        fpath=fpath,
        position=(0.0, 0.0, lift),
        home=tuple(round(float(value), 4) for value in home),
        tool=tool,
        floating=floating,
        limited=bool(((limits > 0) & (limits < math.inf)).all()),
        scale=_scale(parsed, active),
        radius=round(min(0.2, max(0.04, 0.25 * length)), 2),
        marker=tuple(round(float(v), 2) + 0.0 for v in (place[0], place[1], place[2] + lift)),
        own_actuators=parsed.own_actuators,
        passive=tuple(passive),
        unbounded=not np.isfinite(parsed.ctrl_limits).all(),
        bare=not parsed.control_names,
    )


def _home(parsed: ParsedArticulation) -> list[float]:
    """The file's keyframe, else zero; in the middle where that is at a limit or beyond."""
    home = [float(value) for value in parsed.init_qpos]
    for i, (low, high) in enumerate(parsed.qpos_limits):
        margin = 0.05 * (high - low) if math.isfinite(high - low) else 0.0
        if not low + margin <= home[i] <= high - margin:
            home[i] = 0.5 * (low + high)
    mimics = zip(
        parsed.mimic_ids,
        parsed.mimic_parents,
        parsed.mimic_multipliers,
        parsed.mimic_offsets,
        strict=True,
    )
    for i, parent, multiplier, offset in mimics:
        home[i] = multiplier * home[parent] + offset
    return home


def _lowest(model: Any, data: Any) -> float:
    """Height of the lowest point that moves, m: a mesh's vertex, a corner of a shape's box."""
    import mujoco
    import numpy as np

    heights = []
    for i, kind in enumerate(model.geom_type):
        if model.body_treeid[model.geom_bodyid[i]] < 0:  # fixed to the world: touches nothing
            continue
        upwards = data.geom_xmat[i].reshape(3, 3)[2]
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[i]
            start = model.mesh_vertadr[mesh]
            vertices = model.mesh_vert[start : start + model.mesh_vertnum[mesh]]
            low = (vertices @ upwards).min()
        elif kind != mujoco.mjtGeom.mjGEOM_PLANE:
            middle, half = np.split(model.geom_aabb[i], 2)
            low = upwards @ middle - np.abs(upwards) @ half
        else:
            continue
        heights.append(float(data.geom_xpos[i, 2] + low))
    return min(heights, default=0.0)


def _tool(parsed: ParsedArticulation) -> str:
    """The link at the end of the longest chain of hinges, before fingers that slide."""
    import mujoco

    model = parsed.model

    def rank(body: int) -> tuple[int, int, int]:
        hinges = slides = depth = 0
        while body > 0:
            kinds = [model.jnt_type[j] for j in range(model.njnt) if model.jnt_bodyid[j] == body]
            hinges += kinds.count(mujoco.mjtJoint.mjJNT_HINGE)
            slides += kinds.count(mujoco.mjtJoint.mjJNT_SLIDE)
            depth += 1
            body = int(model.body_parentid[body])
        return (hinges, -slides, depth) if hinges else (slides, 0, depth)

    best = max((model.body(name).id for name in parsed.link_names), key=rank)
    return str(model.body(best).name)


def _scale(parsed: ParsedArticulation, active: list[int]) -> float | dict[str, float]:
    """0.4 rad for hinges; a quarter of the range, at most 0.1 m, for slides."""
    import mujoco

    scales: dict[str, float] = {}
    for i in active:
        name = parsed.joint_names[i]
        scales[name] = 0.4
        if parsed.model.joint(name).type[0] == mujoco.mjtJoint.mjJNT_SLIDE:
            low, high = parsed.qpos_limits[i]
            scales[name] = float(f"{min(0.1, 0.25 * (high - low)):.1g}")
    return next(iter(scales.values())) if len(set(scales.values())) == 1 else scales


def robot_words(robot: RobotFacts) -> dict[str, str]:
    """Return what the templates of a task's files say of a robot."""
    near = round(min(0.05, 0.5 * robot.radius), 2)
    height = robot.position[2]
    on_pedestal = height > 0 and not robot.floating
    effort = ", max_effort: file" if robot.limited else ""
    drives = f"drive_pros: {{stiffness: 500, damping: 50{effort}}}"
    if robot.own_actuators:
        drives = "drive_pros: {stiffness: file}    # by the actuators of its file, as they are"
    scale = _map(robot.scale) if isinstance(robot.scale, dict) else _number(robot.scale)
    action = _CONTROLS if robot.passive else _TARGETS
    bounds = "\n      clip: [-1, 1]" if robot.unbounded else ""
    held = "gravcomp: 1                      # it does not sag"
    pedestal = _PEDESTAL.format(height=_number(height), middle=_number(0.5 * height))
    return {
        "uid": robot.uid,
        "fpath": robot.fpath,
        "position": _list(robot.position),
        "home": _list(robot.home),
        "standing": "fix_base: false" if robot.floating else held,
        "drives": drives,
        "tool": robot.tool,
        "marker": _list(robot.marker),
        "radius": _number(robot.radius),
        "near": _number(near),
        "far": _number(4 * robot.radius),
        "actions": action.format(uid=robot.uid, scale=scale, bounds=bounds),
        "pedestal": pedestal if on_pedestal else "",
        "objects": "objects:\n" if on_pedestal else "",
        "tuple": f"({', '.join(map(repr, robot.position))})",
        "array": f"[{', '.join(map(repr, robot.home))}]",
        "fixed": "fix_base=False" if robot.floating else "gravcomp=1.0",
        "imports": _DRIVEN_IMPORTS if robot.bare else _IMPORTS,
        "gains": _GAINS if robot.bare else "",
    }


def _number(value: float) -> str:
    """A number without a needless fraction."""
    return f"{round(value, 4):g}"


def _list(values: Sequence[float]) -> str:
    return f"[{', '.join(map(_number, values))}]"


def _map(values: Mapping[str, float]) -> str:
    """Joint -> number; the joints of one number under one regex."""
    groups: dict[float, list[str]] = {}
    for name, value in values.items():
        groups.setdefault(value, []).append(name)
    parts = (f'"{_regex(names, values)}": {_number(value)}' for value, names in groups.items())
    return f"{{{', '.join(parts)}}}"


def _regex(names: Sequence[str], all_names: Iterable[str]) -> str:
    """What matches these names and no others: their common beginning where that is enough."""
    start = os.path.commonprefix(list(names))
    if start and len(names) > 1 and sum(n.startswith(start) for n in all_names) == len(names):
        return f"{re.escape(start)}.*"
    return "|".join(map(re.escape, names))

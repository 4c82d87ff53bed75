"""Robots and other articulations of a gym config."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from embodichain.compat.gym_config.draft import Draft, Path
from embodichain.compat.gym_config.rigid_objects import convert_attrs
from embodichain.compat.gym_config.vocabulary import (
    ARTICULATION,
    DRIVE,
    ROBOT,
    ROOT_PROPS,
    SOLVER,
    URDF,
    URDF_COMPONENT,
)
from embodichain.lab.sim.cfg import RobotCfg, name_of
from embodichain.lab.sim.urdf_cfg import URDFCfg, URDFComponentCfg
from embodichain.utils.suggest import did_you_mean

__all__ = ["convert_articulations", "convert_robot"]

_PRESETS = {"URRobot": ("UniversalRobots/UR10/UR10.urdf", 6, {"arm": ["Joint[1-6]"]})}
"""EmbodiChain's robot classes that are one file: the file, its joints, their control parts."""
_PLAIN = ("Robot", "RobotCfg")
"""The class that adds nothing."""


def convert_robot(draft: Draft, data: Any) -> str:
    """Convert the section `robot`; return the robot's uid, empty if it is unknown."""
    source: Path = ("robot",)
    if not draft.carry(data, source, ("robot",), ROBOT):
        return ""
    if data.get("uid"):
        draft.put(("robot", "uid"), data["uid"], ("robot", "uid"))
    joints = _file(draft, data)
    _init_qpos(draft, data.get("init_qpos"), joints)
    _solvers(draft, data.get("solver_cfg"))
    _parts_of_articulation(draft, data, source, ("robot",))
    fields = draft.task.get("robot", {})
    uid, fpath = (str(fields.get(key) or "") for key in ("uid", "fpath"))
    parts = fields.get("urdf_cfg", {}).get("components", [])
    urdf = URDFCfg([URDFComponentCfg(urdf_path=str(part.get("urdf_path"))) for part in parts])
    return name_of(RobotCfg(uid=uid, fpath=fpath, urdf_cfg=urdf)) if uid or fpath or parts else ""


def convert_articulations(draft: Draft, data: Any) -> None:
    """Convert the section `articulation`."""
    for source, item in draft.items(data, ("articulation",)):
        target = draft.entity(item, source, "articulations", fallback="fpath")
        if target is not None and draft.carry(item, source, target, ARTICULATION):
            _parts_of_articulation(draft, item, source, target)


def _file(draft: Draft, data: Mapping[str, Any]) -> int | None:
    """Put the robot's file; return how many joints it has if a preset says so."""
    kind_key = "class_type" if "class_type" in data else "robot_type"
    kind, urdf, own = data.get(kind_key), data.get("urdf_cfg"), bool(data.get("fpath"))
    joints = None
    preset = _PRESETS.get(str(kind))
    fpath = ""
    if not own and preset is not None:
        fpath, joints, parts = preset
        if data.get("control_parts") is None:
            draft.put(("robot", "control_parts"), parts, ("robot", kind_key))
        if urdf is None:
            draft.put(("robot", "fpath"), fpath, ("robot", kind_key))
        else:
            joints = None  # components bring their own
    elif kind is not None and preset is None and kind not in _PLAIN:
        _unknown_kind(draft, kind, kind_key, own or urdf is not None)
    if urdf is not None and own:
        draft.note(("robot", "urdf_cfg"), "fpath names the robot's file")
    elif urdf is not None:
        _urdf(draft, urdf, fpath)
    return joints


def _unknown_kind(draft: Draft, kind: Any, key: str, own: bool) -> None:
    message = f"the class {kind!r} is not here"
    if own:
        draft.note(("robot", key), f"{message}: only the keys of this file count")
    else:
        message = f"{message}; name the robot's file in fpath, or {', '.join(_PRESETS)}."
        draft.refuse(("robot", key), message, did_you_mean(str(kind), _PRESETS))


def _urdf(draft: Draft, urdf: Any, preset: str) -> None:
    """A robot assembled of files; a preset's file is its arm unless it names one."""
    source: Path = ("robot", "urdf_cfg")
    if not draft.carry(urdf, source, source, URDF):
        return
    given, where = urdf.get("components"), (*source, "components")
    if isinstance(given, Mapping):  # by component_type
        given = [{"component_type": key, **dict(value or {})} for key, value in given.items()]
    components: list[Any] = []
    for place, component in draft.items(given, where):
        if isinstance(component, Mapping):
            known = {key: value for key, value in component.items() if key in URDF_COMPONENT}
            for key in component.keys() - known.keys():
                draft.note((*place, key), "it has no effect")
            components.append(known)
        else:
            draft.refuse(place, f"expected a map, got {component!r}")
    kinds = [component.get("component_type") for component in components]
    if preset and "arm" not in kinds:
        components.append({"component_type": "arm", "urdf_path": preset})
        if urdf.get("name_case") is None:  # later releases keep the names of files
            draft.put((*source, "name_case"), {"joint": "none", "link": "none"}, source)
    draft.put((*source, "components"), components, where)


def _solvers(draft: Draft, data: Any) -> None:
    """Tool points by control part; a solver that names no part is the whole robot's."""
    source: Path = ("robot", "solver_cfg")
    if isinstance(data, Mapping) and any(key in SOLVER for key in data):
        draft.carry(data, source, (*source, "default"), SOLVER)
        return
    for where, part, solver in draft.entries(data, source):
        draft.carry(solver, where, (*source, part), SOLVER)


def _init_qpos(draft: Draft, values: Any, joints: int | None) -> None:
    """Values of joints that an assembly would have added are left out with it."""
    if values is None:
        return
    where = ("robot", "init_qpos")
    if joints is not None and isinstance(values, list) and len(values) > joints:
        draft.note(where, f"values {values[joints:]} belong to components that are left out")
        values = values[:joints]
    draft.put(where, values, where)


def _parts_of_articulation(
    draft: Draft, data: Mapping[str, Any], source: Path, target: Path
) -> None:
    """Drives, attributes and properties of the root, by the names of 0.2 and of 0.3."""
    for key in ("drive_pros", "joint_drive_props"):
        if data.get(key) is not None:
            draft.carry(data[key], (*source, key), (*target, "drive_pros"), DRIVE)
    if data.get("attrs") is not None:
        convert_attrs(draft, data["attrs"], (*source, "attrs"), (*target, "attrs"))
    root, where = data.get("root_props"), (*source, "root_props")
    if root is not None and draft.carry(root, where, target, ROOT_PROPS):
        if "fixed_base" in root:
            draft.put((*target, "fix_base"), root["fixed_base"], (*where, "fixed_base"))
        collides = root.get("self_collision_enabled")
        if collides is not None:
            name = (*where, "self_collision_enabled")
            draft.put((*target, "disable_self_collision"), not collides, name)

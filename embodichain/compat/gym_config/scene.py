"""The scene of a gym config: robots, articulations, rigid objects, lights and sensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from embodichain.compat.gym_config import vocabulary as known
from embodichain.compat.gym_config.draft import Draft, Path
from embodichain.lab.sim.cfg import RobotCfg, name_of
from embodichain.lab.sim.configs.urdf_cfg import URDFCfg, URDFComponentCfg
from embodichain.utils.suggest import did_you_mean

__all__ = [
    "convert_articulations",
    "convert_lights",
    "convert_objects",
    "convert_robot",
    "convert_sensors",
]

_OTHER_LIGHT_TYPES = ("rect", "mesh")
_PRESETS = {"URRobot": ("UniversalRobots/UR10/UR10.urdf", 6, {"arm": ["Joint[1-6]"]})}
"""EmbodiChain's robot classes with one file -> the file, its joints, their control parts."""
_CAMERA_TYPES = {"Camera": "camera", "StereoCamera": "stereo_camera"}
_LENS = (600, 600, 320.0, 240.0)
"""EmbodiChain's intrinsics of a camera without any, whatever its size."""
_DAMPING = 0.7
"""EmbodiChain's default of the linear and the angular damping, 1/s."""
_PLAIN = ("Robot", "RobotCfg")
"""The robot class that adds nothing to its config."""


def convert_objects(draft: Draft, section: str, data: Any) -> None:
    """Convert `rigid_object`, or `background`, whose bodies are static by default.

    Args:
        draft: The draft; the objects are added to it.
        section: ``rigid_object`` or ``background``.
        data: The list.
    """
    for source, item in draft.items(data, (section,)):
        target = draft.entity(item, source, "objects")
        if target is None or not draft.apply_rules(item, source, target, known.RIGID_OBJECT):
            continue
        if item.get("shape") is not None:
            _shape(draft, item["shape"], (*source, "shape"), (*target, "shape"))
        if item.get("attrs") is not None:
            _attrs(draft, item["attrs"], (*source, "attrs"), (*target, "attrs"))
        _body_type(draft, section, item, source, target)
        if not draft.ours:
            _damping(draft, source, target)


def _damping(draft: Draft, source: Path, target: Path) -> None:
    """Write EmbodiChain's default damping of a body that moves; here it is 0."""
    cfg = draft.task[target[0]][target[1]]
    attrs = cfg.get("attrs") or {}
    if cfg.get("body_type", "dynamic") != "dynamic" or not isinstance(attrs, Mapping):
        return
    for key in ("linear_damping", "angular_damping"):
        if key not in attrs:
            draft.put((*target, "attrs", key), _DAMPING, (*source, "attrs"))


def _attrs(draft: Draft, data: Any, source: Path, target: Path) -> None:
    """Convert the attributes of a body: flat, or in the groups of release 0.3."""
    if not isinstance(data, Mapping):
        draft.apply_rules(data, source, target, known.ATTRS)  # refuses it
        return
    flat = {k: v for k, v in data.items() if k not in known.ATTR_GROUPS}
    draft.apply_rules(flat, source, target, known.ATTRS)
    for group in known.ATTR_GROUPS:
        if data.get(group) is not None:
            draft.apply_rules(data[group], (*source, group), target, known.ATTRS)


def convert_lights(draft: Draft, data: Any) -> None:
    """Convert the section `light`: its direct lights."""
    if data is None or not draft.apply_rules(data, ("light",), (), known.LIGHTS):
        return
    for source, item in draft.items(data.get("direct"), ("light", "direct")):
        kind = item.get("light_type") if isinstance(item, Mapping) else None
        if kind in _OTHER_LIGHT_TYPES:
            draft.note(source, f"lights of type {kind} are not drawn")
            continue
        target = draft.entity(item, source, "lights")
        if target is None or not draft.apply_rules(item, source, target, known.LIGHT):
            continue
        if kind is not None:
            draft.put((*target, "light_type"), kind, (*source, "light_type"))


def convert_sensors(draft: Draft, data: Any, observe: bool = True) -> None:
    """Convert cameras, and add a note for each other sensor.

    Args:
        draft: The draft; the sensors are added to it.
        data: The list.
        observe: Whether observations contain the images.
    """
    for source, item in draft.items(data, ("sensor",)):
        kind = str(item.get("sensor_type")) if isinstance(item, Mapping) else repr(item)
        if kind in known.CAMERAS:
            _camera(draft, item, source, kind, observe)
        elif kind in known.SENSORS:
            draft.note(source, known.SENSORS[kind])
        else:
            names = [*known.CAMERAS, *known.SENSORS]
            message = f"unknown sensor {kind!r}; known: {', '.join(names)}."
            draft.refuse((*source, "sensor_type"), message, did_you_mean(kind, names))


def _camera(draft: Draft, item: Mapping[str, Any], source: Path, kind: str, observe: bool) -> None:
    """Convert a camera, or a pair of them."""
    target = draft.entity(item, source, "sensors")
    if target is None or not draft.apply_rules(item, source, target, known.CAMERAS[kind]):
        return
    draft.put((*target, "sensor_type"), _CAMERA_TYPES[kind], (*source, "sensor_type"))
    draft.put((*target, "observe"), observe, source)
    lenses = ("intrinsics", "intrinsics_right") if kind == "StereoCamera" else ("intrinsics",)
    for key in lenses:
        if key not in item:
            draft.put((*target, key), list(_LENS), source)
    extrinsics = item.get("extrinsics")
    is_attached = isinstance(extrinsics, Mapping) and extrinsics.get("parent")
    # EmbodiChain turns the axes of cameras that are fixed in the environment.
    draft.put((*target, "convention"), "opengl" if is_attached else "ros", source)


def _body_type(
    draft: Draft, section: str, item: Mapping[str, Any], source: Path, target: Path
) -> None:
    """Convert `body_type`; a background is static by default."""
    kind = item.get("body_type")
    where = (*source, "body_type")
    if section == "background" and kind == "dynamic":
        draft.refuse(where, "a background object is static or kinematic; use rigid_object")
    elif kind is not None:
        draft.put((*target, "body_type"), kind, where)
    elif section == "background":
        draft.put((*target, "body_type"), "static", source)


def _shape(draft: Draft, data: Any, source: Path, target: Path) -> None:
    """Convert a shape, with its material."""
    written = str(data.get("shape_type", "")) if isinstance(data, Mapping) else ""
    kind = written.removesuffix("Cfg")
    if kind not in known.SHAPES and draft.ours:
        draft.put(target, data, source)
        return
    if kind not in known.SHAPES:
        message = f"unknown shape_type {written!r}; known: {', '.join(known.SHAPES)}."
        draft.refuse((*source, "shape_type"), message, did_you_mean(kind, known.SHAPES))
        return
    draft.put((*target, "shape_type"), kind, (*source, "shape_type"))
    keys = {k: v for k, v in data.items() if k not in ("shape_type", "visual_material")}
    draft.apply_rules(keys, source, target, known.SHAPES[kind])
    material = data.get("visual_material")
    if material is not None:
        where = (*source, "visual_material")
        draft.apply_rules(material, where, (*target, "visual_material"), known.MATERIAL)
        texture = material.get("base_color_texture") if isinstance(material, Mapping) else None
        if isinstance(texture, str):
            place = (*target, "visual_material", "textures")
            draft.put(place, [texture], (*where, "base_color_texture"))
        elif texture is not None:
            draft.note((*where, "base_color_texture"), "a texture is a file of an image")


def convert_robot(draft: Draft, data: Any) -> str:
    """Convert the section `robot`; return the robot's uid, empty if it is unknown."""
    source: Path = ("robot",)
    if not draft.apply_rules(data, source, ("robot",), known.ROBOT):
        return ""
    if data.get("uid"):
        draft.put(("robot", "uid"), data["uid"], ("robot", "uid"))
    joints = _file(draft, data)
    _init_qpos(draft, data.get("init_qpos"), joints)
    _solvers(draft, data.get("solver_cfg"))
    _parts_of_articulation(draft, data, source, ("robot",))
    return _robot_uid(draft.task.get("robot", {}))


def _robot_uid(robot: Mapping[str, Any]) -> str:
    """The uid of a converted robot, which may be the name of its file; empty if it has none."""
    uid = str(robot.get("uid") or "")
    fpath = str(robot.get("fpath") or "")
    components = robot.get("urdf_cfg", {}).get("components", [])
    if not (uid or fpath or components):
        return ""
    files = [URDFComponentCfg(urdf_path=str(part.get("urdf_path"))) for part in components]
    return name_of(RobotCfg(uid=uid, fpath=fpath, urdf_cfg=URDFCfg(files)))


def convert_articulations(draft: Draft, data: Any) -> None:
    """Convert the section `articulation`."""
    for source, item in draft.items(data, ("articulation",)):
        target = draft.entity(item, source, "articulations", fallback="fpath")
        if target is not None and draft.apply_rules(item, source, target, known.ARTICULATION):
            _parts_of_articulation(draft, item, source, target)


def _file(draft: Draft, data: Mapping[str, Any]) -> int | None:
    """Set the robot's file; return its number of joints if a preset has it."""
    kind_key = "class_type" if "class_type" in data else "robot_type"
    kind = data.get(kind_key)
    urdf = data.get("urdf_cfg")
    has_file = bool(data.get("fpath"))
    joints = None
    preset = _PRESETS.get(str(kind))
    fpath = ""
    if not has_file and preset is not None:
        fpath, joints, parts = preset
        if data.get("control_parts") is None:
            draft.put(("robot", "control_parts"), parts, ("robot", kind_key))
        if urdf is None:
            draft.put(("robot", "fpath"), fpath, ("robot", kind_key))
        else:
            joints = None  # components add joints
    elif kind is not None and preset is None and kind not in _PLAIN:
        _unknown_kind(draft, kind, kind_key, has_file=has_file or urdf is not None)
    if urdf is not None and has_file:
        draft.note(("robot", "urdf_cfg"), "fpath names the robot's file")
    elif urdf is not None:
        _urdf(draft, urdf, fpath)
    return joints


def _unknown_kind(draft: Draft, kind: Any, key: str, *, has_file: bool) -> None:
    """Note a robot class that is not in this package; refuse it if no file is named either."""
    message = f"the class {kind!r} is not here"
    if has_file:
        draft.note(("robot", key), f"{message}: only the keys of this file count")
    else:
        message = f"{message}; name the robot's file in fpath, or {', '.join(_PRESETS)}."
        draft.refuse(("robot", key), message, did_you_mean(str(kind), _PRESETS))


def _urdf(draft: Draft, urdf: Any, preset: str) -> None:
    """Convert a robot assembled from files; the arm is the preset's file by default."""
    source: Path = ("robot", "urdf_cfg")
    if not draft.apply_rules(urdf, source, source, known.URDF):
        return
    where = (*source, "components")
    data = urdf.get("components")
    if isinstance(data, Mapping):  # by component_type
        data = [{"component_type": key, **dict(value or {})} for key, value in data.items()]
    components: list[Any] = []
    for place, component in draft.items(data, where):
        if isinstance(component, Mapping):
            keys = {key: value for key, value in component.items() if key in known.URDF_COMPONENT}
            for key in component.keys() - keys.keys():
                draft.note((*place, key), "it has no effect")
            components.append(keys)
        else:
            draft.refuse(place, f"expected a map, got {component!r}")
    kinds = [component.get("component_type") for component in components]
    if preset and "arm" not in kinds:
        components.append({"component_type": "arm", "urdf_path": preset})
        if urdf.get("name_case") is None:  # later releases keep the names of files
            draft.put((*source, "name_case"), {"joint": "none", "link": "none"}, source)
    draft.put((*source, "components"), components, where)


def _solvers(draft: Draft, data: Any) -> None:
    """Tool points by control part; a solver without a part applies to the whole robot."""
    source: Path = ("robot", "solver_cfg")
    if isinstance(data, Mapping) and any(key in known.SOLVER for key in data):
        draft.apply_rules(data, source, (*source, "default"), known.SOLVER)
        return
    for where, part, solver in draft.entries(data, source):
        draft.apply_rules(solver, where, (*source, part), known.SOLVER)


def _init_qpos(draft: Draft, values: Any, joints: int | None) -> None:
    """Convert initial joint positions, without those of joints that only an assembly adds."""
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
    """Drives, attributes and properties of the root, by the names of releases 0.2 and 0.3."""
    for key in ("drive_pros", "joint_drive_props"):
        if data.get(key) is not None:
            draft.apply_rules(data[key], (*source, key), (*target, "drive_pros"), known.DRIVE)
    if data.get("attrs") is not None:
        _attrs(draft, data["attrs"], (*source, "attrs"), (*target, "attrs"))
    root = data.get("root_props")
    where = (*source, "root_props")
    collides = root.get("self_collision_enabled") if isinstance(root, Mapping) else None
    if collides is None and data.get("disable_self_collision") is None:  # EmbodiChain's default
        draft.put((*target, "disable_self_collision"), True, source)
    if root is not None and draft.apply_rules(root, where, target, known.ROOT_PROPS):
        if "fixed_base" in root:
            draft.put((*target, "fix_base"), root["fixed_base"], (*where, "fixed_base"))
        if collides is not None:
            name = (*where, "self_collision_enabled")
            draft.put((*target, "disable_self_collision"), not collides, name)

"""The scene of a gym config: robots, articulations, rigid objects, lights and sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from embodichain.compat.gym_config import vocabulary
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


@dataclass(frozen=True)
class _Preset:
    """A robot class of EmbodiChain's with one file.

    Attributes:
        fpath: The file.
        num_joints: Number of its joints.
        control_parts: Part -> patterns of its joints.
    """

    fpath: str
    num_joints: int
    control_parts: dict[str, list[str]]


_PRESETS = {
    "URRobot": _Preset(
        fpath="UniversalRobots/UR10/UR10.urdf",
        num_joints=6,
        control_parts={"arm": ["Joint[1-6]"]},
    )
}
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
        target = draft.add_entity(item, source, "objects")
        if target is None or not draft.apply_rules(item, source, target, vocabulary.RIGID_OBJECT):
            continue
        if item.get("shape") is not None:
            _convert_shape(draft, item["shape"], (*source, "shape"), (*target, "shape"))
        if item.get("attrs") is not None:
            _convert_attrs(draft, item["attrs"], (*source, "attrs"), (*target, "attrs"))
        _convert_body_type(draft, section, item, source, target)
        if not draft.ours:
            _put_default_damping(draft, source, target)


def _put_default_damping(draft: Draft, source: Path, target: Path) -> None:
    """Write EmbodiChain's default damping of a body that moves; here it is 0."""
    cfg = draft.task[target[0]][target[1]]
    attrs = cfg.get("attrs") or {}
    if cfg.get("body_type", "dynamic") != "dynamic" or not isinstance(attrs, Mapping):
        return
    for key in ("linear_damping", "angular_damping"):
        if key not in attrs:
            draft.put((*target, "attrs", key), _DAMPING, (*source, "attrs"))


def _convert_attrs(draft: Draft, data: Any, source: Path, target: Path) -> None:
    """Convert the attributes of a body: flat, or in the groups of release 0.3."""
    if not isinstance(data, Mapping):
        draft.apply_rules(data, source, target, vocabulary.ATTRS)  # refuses it
        return
    flat_attrs = {key: value for key, value in data.items() if key not in vocabulary.ATTR_GROUPS}
    draft.apply_rules(flat_attrs, source, target, vocabulary.ATTRS)
    for group in vocabulary.ATTR_GROUPS:
        if data.get(group) is not None:
            draft.apply_rules(data[group], (*source, group), target, vocabulary.ATTRS)


def convert_lights(draft: Draft, data: Any) -> None:
    """Convert the section `light`: its direct lights."""
    if data is None or not draft.apply_rules(data, ("light",), (), vocabulary.LIGHTS):
        return
    for source, item in draft.items(data.get("direct"), ("light", "direct")):
        kind = item.get("light_type") if isinstance(item, Mapping) else None
        if kind in _OTHER_LIGHT_TYPES:
            draft.note(source, f"lights of type {kind} are not drawn")
            continue
        target = draft.add_entity(item, source, "lights")
        if target is None or not draft.apply_rules(item, source, target, vocabulary.LIGHT):
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
        if kind in vocabulary.CAMERAS:
            _convert_camera(draft, item, source, kind, observe)
        elif kind in vocabulary.SENSORS:
            draft.note(source, vocabulary.SENSORS[kind])
        else:
            names = [*vocabulary.CAMERAS, *vocabulary.SENSORS]
            message = f"unknown sensor {kind!r}; known: {', '.join(names)}."
            draft.refuse((*source, "sensor_type"), message, did_you_mean(kind, names))


def _convert_camera(
    draft: Draft, item: Mapping[str, Any], source: Path, kind: str, observe: bool
) -> None:
    """Convert a camera, or a pair of them."""
    target = draft.add_entity(item, source, "sensors")
    if target is None or not draft.apply_rules(item, source, target, vocabulary.CAMERAS[kind]):
        return
    draft.put((*target, "sensor_type"), _CAMERA_TYPES[kind], (*source, "sensor_type"))
    draft.put((*target, "observe"), observe, source)
    lenses = ["intrinsics"]
    if kind == "StereoCamera":
        lenses.append("intrinsics_right")
    for key in lenses:
        if key not in item:
            draft.put((*target, key), list(_LENS), source)
    extrinsics = item.get("extrinsics")
    # EmbodiChain turns the axes of cameras that are fixed in the environment.
    convention = "ros"
    if isinstance(extrinsics, Mapping) and extrinsics.get("parent"):
        convention = "opengl"
    draft.put((*target, "convention"), convention, source)


def _convert_body_type(
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


def _convert_shape(draft: Draft, data: Any, source: Path, target: Path) -> None:
    """Convert a shape, with its material."""
    shape_type = ""
    if isinstance(data, Mapping):
        shape_type = str(data.get("shape_type", ""))
    kind = shape_type.removesuffix("Cfg")
    if kind not in vocabulary.SHAPES and draft.ours:
        draft.put(target, data, source)
        return
    if kind not in vocabulary.SHAPES:
        message = f"unknown shape_type {shape_type!r}; known: {', '.join(vocabulary.SHAPES)}."
        draft.refuse((*source, "shape_type"), message, did_you_mean(kind, vocabulary.SHAPES))
        return
    draft.put((*target, "shape_type"), kind, (*source, "shape_type"))
    sizes = {
        key: value for key, value in data.items() if key not in ("shape_type", "visual_material")
    }
    draft.apply_rules(sizes, source, target, vocabulary.SHAPES[kind])
    material = data.get("visual_material")
    if material is not None:
        where = (*source, "visual_material")
        _convert_material(draft, material, where, (*target, "visual_material"))


def _convert_material(draft: Draft, data: Any, source: Path, target: Path) -> None:
    """Convert the material of a shape, with its texture."""
    if not draft.apply_rules(data, source, target, vocabulary.MATERIAL):
        return
    texture = data.get("base_color_texture")
    where = (*source, "base_color_texture")
    if isinstance(texture, str):
        draft.put((*target, "textures"), [texture], where)
    elif texture is not None:
        draft.note(where, "a texture is a file of an image")


def convert_robot(draft: Draft, data: Any) -> str:
    """Convert the section `robot`; return the robot's uid, empty if it is unknown."""
    source: Path = ("robot",)
    if not draft.apply_rules(data, source, ("robot",), vocabulary.ROBOT):
        return ""
    if data.get("uid"):
        draft.put(("robot", "uid"), data["uid"], ("robot", "uid"))
    joints = _convert_file(draft, data)
    _convert_init_qpos(draft, data.get("init_qpos"), joints)
    _convert_solvers(draft, data.get("solver_cfg"))
    _convert_parts(draft, data, source, ("robot",))
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
        target = draft.add_entity(item, source, "articulations", fallback="fpath")
        if target is not None and draft.apply_rules(item, source, target, vocabulary.ARTICULATION):
            _convert_parts(draft, item, source, target)


def _convert_file(draft: Draft, data: Mapping[str, Any]) -> int | None:
    """Set the robot's file; return its number of joints if a preset has it."""
    kind_key = "class_type" if "class_type" in data else "robot_type"
    kind = data.get(kind_key)
    urdf = data.get("urdf_cfg")
    has_file = bool(data.get("fpath"))
    num_joints = None
    preset = _PRESETS.get(str(kind))
    preset_file = ""
    if not has_file and preset is not None:
        preset_file = preset.fpath
        if data.get("control_parts") is None:
            draft.put(("robot", "control_parts"), preset.control_parts, ("robot", kind_key))
        if urdf is None:  # components add joints
            draft.put(("robot", "fpath"), preset_file, ("robot", kind_key))
            num_joints = preset.num_joints
    elif kind is not None and preset is None and kind not in _PLAIN:
        _report_unknown_class(draft, kind, kind_key, has_file=has_file or urdf is not None)
    if urdf is not None and has_file:
        draft.note(("robot", "urdf_cfg"), "fpath names the robot's file")
    elif urdf is not None:
        _convert_urdf(draft, urdf, preset_file)
    return num_joints


def _report_unknown_class(draft: Draft, kind: Any, key: str, *, has_file: bool) -> None:
    """Note a robot class that is not in this package; refuse it if no file is named either."""
    message = f"the class {kind!r} is not here"
    if has_file:
        draft.note(("robot", key), f"{message}: only the keys of this file count")
    else:
        message = f"{message}; name the robot's file in fpath, or {', '.join(_PRESETS)}."
        draft.refuse(("robot", key), message, did_you_mean(str(kind), _PRESETS))


def _convert_urdf(draft: Draft, urdf: Any, preset: str) -> None:
    """Convert a robot assembled from files; the arm is the preset's file by default."""
    source: Path = ("robot", "urdf_cfg")
    if not draft.apply_rules(urdf, source, source, vocabulary.URDF):
        return
    where = (*source, "components")
    data = urdf.get("components")
    if isinstance(data, Mapping):  # by component_type
        data = [{"component_type": key, **dict(value or {})} for key, value in data.items()]
    components: list[Any] = []
    for place, component in draft.items(data, where):
        if isinstance(component, Mapping):
            converted: dict[str, Any] = {}
            for key, value in component.items():
                if key in vocabulary.URDF_COMPONENT:
                    converted[key] = value
                else:
                    draft.note((*place, key), "it has no effect")
            components.append(converted)
        else:
            draft.refuse(place, f"expected a map, got {component!r}")
    kinds = [component.get("component_type") for component in components]
    if preset and "arm" not in kinds:
        components.append({"component_type": "arm", "urdf_path": preset})
        if urdf.get("name_case") is None:  # later releases keep the names of files
            draft.put((*source, "name_case"), {"joint": "none", "link": "none"}, source)
    draft.put((*source, "components"), components, where)


def _convert_solvers(draft: Draft, data: Any) -> None:
    """Convert tool points by control part; a solver without a part applies to the whole robot."""
    source: Path = ("robot", "solver_cfg")
    if isinstance(data, Mapping) and any(key in vocabulary.SOLVER for key in data):
        draft.apply_rules(data, source, (*source, "default"), vocabulary.SOLVER)
        return
    for where, part, solver in draft.entries(data, source):
        draft.apply_rules(solver, where, (*source, part), vocabulary.SOLVER)


def _convert_init_qpos(draft: Draft, values: Any, joints: int | None) -> None:
    """Convert initial joint positions, without those of joints that only an assembly adds."""
    if values is None:
        return
    where = ("robot", "init_qpos")
    if joints is not None and isinstance(values, list) and len(values) > joints:
        draft.note(where, f"values {values[joints:]} belong to components that are left out")
        values = values[:joints]
    draft.put(where, values, where)


def _convert_parts(draft: Draft, data: Mapping[str, Any], source: Path, target: Path) -> None:
    """Convert drives, attributes and root of an articulation, of releases 0.2 and 0.3."""
    for key in ("drive_pros", "joint_drive_props"):
        if data.get(key) is not None:
            draft.apply_rules(data[key], (*source, key), (*target, "drive_pros"), vocabulary.DRIVE)
    if data.get("attrs") is not None:
        _convert_attrs(draft, data["attrs"], (*source, "attrs"), (*target, "attrs"))
    root = data.get("root_props")
    where = (*source, "root_props")
    collides = None
    if isinstance(root, Mapping):
        collides = root.get("self_collision_enabled")
    if collides is None and data.get("disable_self_collision") is None:  # EmbodiChain's default
        draft.put((*target, "disable_self_collision"), True, source)
    if root is not None and draft.apply_rules(root, where, target, vocabulary.ROOT_PROPS):
        if "fixed_base" in root:
            draft.put((*target, "fix_base"), root["fixed_base"], (*where, "fixed_base"))
        if collides is not None:
            name = (*where, "self_collision_enabled")
            draft.put((*target, "disable_self_collision"), not collides, name)

"""Floors of robot files: horizontal planes of their worlds, in whose place the scene's ground is.

What a file says of its floor stays true of the ground: contact pairs and sensors that name the
floor are bound to the ground, which takes the floor's contact parameters.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64
from embodichain.utils.math import quat_rotate

__all__ = [
    "CONTACT_FIELDS",
    "Plane",
    "bind_floors",
    "floors_of",
    "move_to_world",
    "planes_of",
    "strangers_to",
    "without_references",
]

CONTACT_FIELDS = (
    "contype",
    "conaffinity",
    "condim",
    "priority",
    "friction",
    "solmix",
    "solref",
    "solimp",
    "margin",
    "gap",
    "adhesion",
    "surfacevel",
)
"""Attributes of a geom that decide what it collides with, and how."""
_OTHER_FIELDS = ("type", "size", "mass", "density", "group", "material", "rgba", "userdata")
_PLANE = mujoco.mjtGeom.mjGEOM_PLANE
_GEOM = mujoco.mjtObj.mjOBJ_GEOM
_UP = np.array([0.0, 0.0, 1.0])


class Plane(NamedTuple):
    """A plane in the world of a file.

    Attributes:
        pos: (3,) metres.
        quat: (4,) wxyz.
    """

    pos: F64
    quat: F64


def planes_of(spec: mujoco.MjSpec, model: mujoco.MjModel) -> dict[str, Plane]:
    """Return the planes in a file's world, by name.

    Args:
        spec: The file, whose geoms all have names.
        model: The file, compiled.
    """
    planes: dict[str, Plane] = {}
    for geom in spec.worldbody.geoms:
        if geom.type == _PLANE:
            compiled = model.geom(geom.name)
            planes[geom.name] = Plane(compiled.pos.copy(), compiled.quat.copy())
    return planes


def floors_of(planes: Mapping[str, Plane]) -> tuple[str, ...]:
    """Return the names of the horizontal ones of a world's planes."""
    floors: list[str] = []
    for name, plane in planes.items():
        normal = quat_rotate(plane.quat, _UP)
        if np.allclose(normal, _UP, atol=1e-6):
            floors.append(name)
    return tuple(floors)


def move_to_world(spec: mujoco.MjSpec, name: str, pos: F64, quat: F64) -> None:
    """Move a plane from a body into the world, where planes belong.

    Args:
        spec: The model.
        name: The plane's name, which stays.
        pos: (3,) metres, in the world.
        quat: (4,) wxyz, in the world.
    """
    old = spec.geom(name)
    values: dict[str, Any] = {}
    for field in (*CONTACT_FIELDS, *_OTHER_FIELDS):
        value = getattr(old, field)
        values[field] = np.array(value) if np.ndim(value) else value  # arrays are views of `old`
    spec.delete(old)
    new = spec.worldbody.add_geom(name=name)
    for field, value in values.items():
        setattr(new, field, value)
    new.pos = pos
    new.quat = quat


def bind_floors(
    spec: mujoco.MjSpec,
    ground: str | None,
    floors: Sequence[str],
    attached: Sequence[str],
    given: Collection[str] | None,
    at_height: bool = False,
) -> list[str]:
    """Put a scene's ground in the place of a robot file's floors.

    What names a floor names the ground, which takes the contact parameters of the file's first
    floor. Without a ground, the file's floors stay, but for those of attached files.

    Args:
        spec: The scene, with the robot.
        ground: The ground's geom, or None.
        floors: Floors of the robot's own file.
        attached: Floors of files attached to it.
        given: Contact parameters that the ground keeps; None is all.
        at_height: Whether the ground is to be at the height of the first floor.

    Returns:
        Messages for the user, without the robot's name.
    """
    if ground is None:
        messages = [
            f"its floor {_name_in_file(floor)!r} stays: the scene has no ground" for floor in floors
        ]
        if attached:
            removed = [f"floor {_name_in_file(floor)!r}" for floor in attached]
            removed += without_references(spec, attached)
            for floor in attached:
                spec.delete(spec.geom(floor))
            messages.append(f"left out: {', '.join(removed)}")
        return messages
    messages = [
        _replace_floor(
            spec.geom(ground), spec.geom(floor), given, is_first=not number, at_height=at_height
        )
        for number, floor in enumerate(floors)
    ]
    for floor in (*floors, *attached):
        _bind_to_geom(spec, floor, ground)
        spec.delete(spec.geom(floor))
    return messages


def _replace_floor(
    ground: mujoco.MjsGeom,
    floor: mujoco.MjsGeom,
    given: Collection[str] | None,
    *,
    is_first: bool,
    at_height: bool,
) -> str:
    """Give a ground the height and the contact parameters of a file's first floor.

    Args:
        ground: The ground; it changes.
        floor: The floor.
        given: Contact parameters that the ground keeps; None is all.
        is_first: Whether it is the file's first floor; the ground takes nothing of others.
        at_height: Whether the ground is to be at the height of the first floor.

    Returns:
        A message for the user.
    """
    message = f"its floor {_name_in_file(floor.name)!r} is the scene's ground"
    height = float(floor.pos[2])
    if height and at_height and is_first:
        ground.pos = [0.0, 0.0, height]
        message += f", at z = {height:g} as in the file"
    elif height:
        message += f", which is not at z = {height:g} as in the file"
    if is_first:
        changed, refused = _adopt_contact(ground, floor, given)
        if changed:
            message += f"; the ground takes its {', '.join(changed)}"
        if refused:
            message += f"; the ground does not have its {', '.join(refused)}"
    return message


def strangers_to(
    model: mujoco.MjModel, ground: int, entities: Mapping[str, Sequence[int]]
) -> list[str]:
    """Return the entities that collide, but none of whose shapes can touch the ground.

    Args:
        model: The scene.
        ground: The ground's geom.
        entities: Name -> geoms.
    """
    types = model.geom_contype
    affinities = model.geom_conaffinity
    meets_ground = ((types & affinities[ground]) | (affinities & types[ground])) != 0
    pairs = np.stack([model.pair_geom1, model.pair_geom2], axis=1)
    has_ground = (pairs == ground).any(axis=1)
    meets_ground[pairs[has_ground]] = True
    collides = (types | affinities) != 0
    strangers: list[str] = []
    for name, geoms in entities.items():
        ids = list(geoms)
        if collides[ids].any() and not meets_ground[ids].any():
            strangers.append(name)
    return strangers


def _bind_to_geom(spec: mujoco.MjSpec, old: str, new: str) -> None:
    """Let what names one geom name another: contact pairs, sensors, custom tuples."""
    for pair in spec.pairs:
        if pair.geomname1 == old:
            pair.geomname1 = new
        if pair.geomname2 == old:
            pair.geomname2 = new
    for sensor in spec.sensors:
        if sensor.objtype == _GEOM and sensor.objname == old:
            sensor.objname = new
        if sensor.reftype == _GEOM and sensor.refname == old:
            sensor.refname = new
    for group in spec.tuples:
        names = list(group.objname)
        for number, kind in enumerate(group.objtype):
            if kind == _GEOM and names[number] == old:
                names[number] = new
        group.objname = names


def without_references(spec: mujoco.MjSpec, geoms: Collection[str]) -> list[str]:
    """Remove the contact pairs and sensors that name geoms, and return their names."""
    removed: list[str] = []
    for pair in list(spec.pairs):
        if pair.geomname1 in geoms or pair.geomname2 in geoms:
            removed.append(f"pair of {pair.geomname1!r} and {pair.geomname2!r}")
            spec.delete(pair)
    for sensor in list(spec.sensors):
        reads_geom = sensor.objtype == _GEOM and sensor.objname in geoms
        refers_to_geom = sensor.reftype == _GEOM and sensor.refname in geoms
        if reads_geom or refers_to_geom:
            removed.append(f"sensor {sensor.name!r}")
            spec.delete(sensor)
    return removed


def _adopt_contact(
    ground: mujoco.MjsGeom, floor: mujoco.MjsGeom, given: Collection[str] | None
) -> tuple[list[str], list[str]]:
    """Give a ground the contact parameters of a floor.

    Args:
        ground: The ground; it changes.
        floor: The floor.
        given: Parameters that the ground keeps; None is all.

    Returns:
        The parameters that it took, and those of the floor that it did not, as ``NAME VALUE``.
    """
    changed: list[str] = []
    refused: list[str] = []
    for field in CONTACT_FIELDS:
        value = getattr(floor, field)
        differs = not np.array_equal(getattr(ground, field), value)
        if given is None or field in given:
            if differs:
                refused.append(f"{field} {_format(value)}")
        elif differs or field == "friction":  # which acts from now on
            setattr(ground, field, value)
            changed.append(f"{field} {_format(value)}")
    return changed, refused


def _name_in_file(name: str) -> str:
    """Return a name in the scene without that of the robot."""
    return name.partition("/")[2]


def _format(value: Any) -> str:
    if isinstance(value, int):
        return str(value)
    numbers: Sequence[float] = np.asarray(value, np.float64).reshape(-1).tolist()
    return " ".join(f"{number:g}" for number in numbers)

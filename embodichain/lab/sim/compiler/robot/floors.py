"""Floors of robot files: horizontal planes of their worlds, in whose place the scene's ground is.

What a file says of its floor stays true of the ground: contact pairs and sensors that name the
floor are bound to the ground, which takes the floor's contact parameters.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

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

Plane = tuple[F64, F64]
"""Position (3,) in metres and orientation (4,) wxyz in the file's world."""
CONTACT_FIELDS = (
    *("contype", "conaffinity", "condim", "priority", "friction", "solmix", "solref", "solimp"),
    *("margin", "gap", "adhesion", "surfacevel"),
)
"""Attributes of a geom that decide what it collides with, and how."""
_OTHER_FIELDS = ("type", "size", "mass", "density", "group", "material", "rgba", "userdata")
_PLANE, _GEOM = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtObj.mjOBJ_GEOM
_UP = np.array([0.0, 0.0, 1.0])


def planes_of(spec: mujoco.MjSpec, model: mujoco.MjModel) -> dict[str, Plane]:
    """Return the planes in a file's world, by name.

    Args:
        spec: The file, whose geoms all have names.
        model: The file, compiled.
    """
    names = [geom.name for geom in spec.worldbody.geoms if geom.type == _PLANE]
    return {name: (model.geom(name).pos.copy(), model.geom(name).quat.copy()) for name in names}


def floors_of(planes: Mapping[str, Plane]) -> tuple[str, ...]:
    """Return the names of the horizontal ones of a world's planes."""
    normals = {name: quat_rotate(quat, _UP) for name, (_, quat) in planes.items()}
    return tuple(name for name in planes if np.allclose(normals[name], _UP, atol=1e-6))


def move_to_world(spec: mujoco.MjSpec, name: str, pos: F64, quat: F64) -> None:
    """Move a plane from a body into the world, where planes belong.

    Args:
        spec: The model.
        name: The plane's name, which stays.
        pos: (3,) metres, in the world.
        quat: (4,) wxyz, in the world.
    """
    old = spec.geom(name)
    values = {field: getattr(old, field) for field in (*CONTACT_FIELDS, *_OTHER_FIELDS)}
    values = {field: np.array(v) if np.ndim(v) else v for field, v in values.items()}
    spec.delete(old)
    new = spec.worldbody.add_geom(name=name)
    for field, value in values.items():
        setattr(new, field, value)
    new.pos, new.quat = pos, quat


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
        removed = without_references(spec, attached)
        for floor in attached:
            spec.delete(spec.geom(floor))
        names = ", ".join([*(f"floor {_own(floor)!r}" for floor in attached), *removed])
        kept = [f"its floor {_own(floor)!r} stays: the scene has no ground" for floor in floors]
        return [*kept, f"left out: {names}"] if attached else kept
    said: list[str] = []
    for number, floor in enumerate(floors):
        geom = spec.geom(floor)
        message = f"its floor {_own(floor)!r} is the scene's ground"
        height = float(geom.pos[2])
        if height and at_height and not number:
            spec.geom(ground).pos = [0.0, 0.0, height]
            message += f", at z = {height:g} as in the file"
        elif height:
            message += f", which is not at z = {height:g} as in the file"
        changed, kept = ([], []) if number else _adopt_contact(spec.geom(ground), geom, given)
        if changed:
            message += f"; the ground takes its {', '.join(changed)}"
        if kept:
            message += f"; the ground does not have its {', '.join(kept)}"
        said.append(message)
    for floor in (*floors, *attached):
        _bind_to_geom(spec, floor, ground)
        spec.delete(spec.geom(floor))
    return said


def strangers_to(
    model: mujoco.MjModel, ground: int, entities: Mapping[str, Sequence[int]]
) -> list[str]:
    """Return the entities that collide, but none of whose shapes can touch the ground.

    Args:
        model: The scene.
        ground: The ground's geom.
        entities: Name -> geoms.
    """
    types, affinities = model.geom_contype, model.geom_conaffinity
    meet = (types & affinities[ground]) | (affinities & types[ground]) != 0
    partners = np.stack([model.pair_geom1, model.pair_geom2], axis=1)
    with_ground = (partners == ground).any(axis=1)
    meet[partners[with_ground]] = True
    collide = (types | affinities) != 0
    return [
        name
        for name, geoms in entities.items()
        if collide[list(geoms)].any() and not meet[list(geoms)].any()
    ]


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
        names = zip(group.objtype, group.objname, strict=True)
        group.objname = [new if kind == _GEOM and n == old else n for kind, n in names]


def without_references(spec: mujoco.MjSpec, geoms: Collection[str]) -> list[str]:
    """Remove the contact pairs and sensors that name geoms, and return their names."""
    removed: list[str] = []
    for pair in list(spec.pairs):
        if pair.geomname1 in geoms or pair.geomname2 in geoms:
            removed.append(f"pair of {pair.geomname1!r} and {pair.geomname2!r}")
            spec.delete(pair)
    for sensor in list(spec.sensors):
        named = {(sensor.objtype, sensor.objname), (sensor.reftype, sensor.refname)}
        if any(kind == _GEOM and name in geoms for kind, name in named):
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
        The parameters that it took, and those that differ and were kept, each as ``NAME VALUE``.
    """
    changed: list[str] = []
    kept: list[str] = []
    for field in CONTACT_FIELDS:
        value = getattr(floor, field)
        differs = not np.array_equal(getattr(ground, field), value)
        decided = given is None or field in given
        if decided and differs:
            kept.append(f"{field} {_shown(value)}")
        elif not decided and (differs or field == "friction"):  # which acts from now on
            setattr(ground, field, value)
            changed.append(f"{field} {_shown(value)}")
    return changed, kept


def _own(name: str) -> str:
    """Return a name in the scene without that of the robot."""
    return name.partition("/")[2]


def _shown(value: Any) -> str:
    if isinstance(value, int):
        return str(value)
    numbers: Sequence[float] = np.asarray(value, np.float64).reshape(-1).tolist()
    return " ".join(f"{number:g}" for number in numbers)

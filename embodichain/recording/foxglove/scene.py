"""What an environment looks like: one `SceneEntity` a body, locked to the body's frame.

Shapes become Foxglove's primitives: a capsule is a cylinder with two spheres, a mesh a list of
triangles.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from embodichain.recording import wire
from embodichain.recording.foxglove.frames import frame_names
from embodichain.recording.foxglove.messages import (
    Color,
    CubePrimitive,
    CylinderPrimitive,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    TriangleListPrimitive,
    Vector3,
    timestamp,
)
from embodichain.recording.shapes import Shape, mesh_of, shapes

__all__ = ["Scene"]


class Scene:
    """The entities of one environment; build a new one when its model fields change.

    Args:
        model: The environment's model.
        env_id: Which one.
    """

    def __init__(self, model: mujoco.MjModel, env_id: int) -> None:
        names = frame_names(model, env_id)
        self._entities: dict[int, Any] = {}
        for shape in shapes(model):
            entity = self._entities.get(shape.body)
            if entity is None:
                name = names[shape.body]
                entity = SceneEntity(frame_id=name, id=name, frame_locked=True)
                self._entities[shape.body] = entity
            _DRAW[shape.kind](entity, model, shape)

    def update(self, time_ns: int) -> bytes:
        """`SceneUpdate` that replaces all entities, as bytes."""
        stamp = timestamp(time_ns)
        for entity in self._entities.values():
            entity.timestamp.CopyFrom(stamp)
        update: bytes = SceneUpdate(entities=self._entities.values()).SerializeToString()
        return update


def _color(shape: Shape) -> Any:
    r, g, b, a = shape.rgba.tolist()
    return Color(r=r, g=g, b=b, a=a)


def _pose(shape: Shape, along_z: float = 0.0) -> Any:
    """A shape's pose in its body, moved along its own z axis."""
    axis = np.empty(3)
    mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, 1.0]), shape.quat)
    qw, qx, qy, qz = shape.quat.tolist()
    return Pose(
        position=_xyz(shape.pos + along_z * axis),
        orientation=Quaternion(x=qx, y=qy, z=qz, w=qw),
    )


def _xyz(values: Any) -> Vector3:
    x, y, z = (float(v) for v in values)
    return Vector3(x=x, y=y, z=z)


def _box(entity: Any, model: mujoco.MjModel, shape: Shape) -> None:
    size = _xyz(2 * shape.half)
    entity.cubes.append(CubePrimitive(pose=_pose(shape), size=size, color=_color(shape)))


def _ellipsoid(entity: Any, model: mujoco.MjModel, shape: Shape) -> None:
    size = _xyz(2 * shape.half)
    entity.spheres.append(SpherePrimitive(pose=_pose(shape), size=size, color=_color(shape)))


def _cylinder(entity: Any, model: mujoco.MjModel, shape: Shape) -> None:
    entity.cylinders.append(
        CylinderPrimitive(
            pose=_pose(shape),
            size=_xyz(2 * shape.half),
            bottom_scale=1.0,
            top_scale=1.0,
            color=_color(shape),
        )
    )


def _capsule(entity: Any, model: mujoco.MjModel, shape: Shape) -> None:
    _cylinder(entity, model, shape)
    radius, _, half = shape.half.tolist()
    for end in (-half, half):
        pose, size = _pose(shape, along_z=end), _xyz((2 * radius,) * 3)
        entity.spheres.append(SpherePrimitive(pose=pose, size=size, color=_color(shape)))


# A point on the wire: field 2 of the list, 27 bytes, then x, y and z, each one tag and 8 bytes.
_POINT = np.dtype(
    [("tag", "u1"), ("len", "u1")]
    + [item for c in "xyz" for item in ((f"{c}_tag", "u1"), (c, "<f8"))]
)


def _mesh(entity: Any, model: mujoco.MjModel, shape: Shape) -> None:
    mesh = mesh_of(model, shape.geom)
    points = np.empty(len(mesh.vertices), _POINT)
    points["tag"], points["len"] = 2 << 3 | 2, 27
    for number, name in enumerate("xyz", start=1):
        points[f"{name}_tag"] = number << 3 | 1
        points[name] = mesh.vertices[:, number - 1]
    indices = mesh.faces.reshape(-1)
    # Parsed at once by protobuf, instead of one Python object a vertex.
    triangles = TriangleListPrimitive.FromString(points.tobytes() + wire.array(5, indices, "<u4"))
    triangles.pose.CopyFrom(_pose(shape))
    triangles.color.CopyFrom(_color(shape))
    entity.triangles.append(triangles)


_DRAW: dict[str, Callable[[Any, mujoco.MjModel, Shape], None]] = {
    "box": _box,
    "ellipsoid": _ellipsoid,
    "capsule": _capsule,
    "cylinder": _cylinder,
    "mesh": _mesh,
}

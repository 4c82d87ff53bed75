"""`/env_I/scene`: one `SceneEntity` for each body, locked to the body's frame.

Shapes become Foxglove's primitives: a capsule is a cylinder with two spheres, a mesh a model as GLB
inside the message.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from embodichain.recording.views.meshes import MEDIA_TYPE, glb
from embodichain.recording.views.messages import (
    Color,
    CubePrimitive,
    CylinderPrimitive,
    ModelPrimitive,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    Vector3,
    set_time,
)
from embodichain.recording.views.motion import frame_names
from embodichain.recording.views.shapes import PLANE_SIZE, Shape, mesh_of, shapes

__all__ = ["Props", "scene_update"]


class Props:
    """Encoded meshes, which all environments share.

    Args:
        ground: Metres that an infinite plane is drawn wide.
    """

    def __init__(self, ground: float = PLANE_SIZE) -> None:
        self.ground = min(ground, PLANE_SIZE)
        self._encoded: dict[tuple[int, int], bytes] = {}

    def mesh(self, model: mujoco.MjModel, geom: int) -> bytes:
        """The GLB of a geom whose shape is a mesh."""
        key = int(model.geom_type[geom]), int(model.geom_dataid[geom])
        if key not in self._encoded:
            self._encoded[key] = glb(mesh_of(model, geom))
        return self._encoded[key]


def scene_update(time_ns: int, model: mujoco.MjModel, env_id: int, props: Props) -> bytes:
    """Return the serialized `SceneUpdate` that replaces all entities of an environment.

    Args:
        time_ns: Its time.
        model: The environment's model.
        env_id: The environment.
        props: Encoded meshes of this model, or of one with the same meshes.
    """
    names = frame_names(model, env_id)
    entities: dict[int, Any] = {}
    for shape in shapes(model):
        entity = entities.get(shape.body)
        if entity is None:
            name = names[shape.body]
            entity = entities[shape.body] = SceneEntity(frame_id=name, id=name, frame_locked=True)
            set_time(entity.timestamp, time_ns)
        _DRAW[shape.kind](entity, model, shape, props)
    data: bytes = SceneUpdate(entities=entities.values()).SerializeToString()
    return data


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


def _box(entity: Any, model: mujoco.MjModel, shape: Shape, props: Props) -> None:
    size = 2 * shape.half
    if int(model.geom_type[shape.geom]) == int(mujoco.mjtGeom.mjGEOM_PLANE):
        size[:2] = np.where(model.geom_size[shape.geom][:2] > 0, size[:2], props.ground)
    entity.cubes.append(CubePrimitive(pose=_pose(shape), size=_xyz(size), color=_color(shape)))


def _ellipsoid(entity: Any, model: mujoco.MjModel, shape: Shape, props: Props) -> None:
    size = _xyz(2 * shape.half)
    entity.spheres.append(SpherePrimitive(pose=_pose(shape), size=size, color=_color(shape)))


def _cylinder(entity: Any, model: mujoco.MjModel, shape: Shape, props: Props) -> None:
    entity.cylinders.append(
        CylinderPrimitive(
            pose=_pose(shape),
            size=_xyz(2 * shape.half),
            bottom_scale=1.0,
            top_scale=1.0,
            color=_color(shape),
        )
    )


def _capsule(entity: Any, model: mujoco.MjModel, shape: Shape, props: Props) -> None:
    _cylinder(entity, model, shape, props)
    radius, _, half = shape.half.tolist()
    for end in (-half, half):
        pose, size = _pose(shape, along_z=end), _xyz((2 * radius,) * 3)
        entity.spheres.append(SpherePrimitive(pose=pose, size=size, color=_color(shape)))


def _mesh(entity: Any, model: mujoco.MjModel, shape: Shape, props: Props) -> None:
    entity.models.append(
        ModelPrimitive(
            pose=_pose(shape),
            scale=Vector3(x=1.0, y=1.0, z=1.0),
            color=_color(shape),
            override_color=True,
            media_type=MEDIA_TYPE,
            data=props.mesh(model, shape.geom),
        )
    )


_DRAW: dict[str, Callable[[Any, mujoco.MjModel, Shape, Props], None]] = {
    "box": _box,
    "ellipsoid": _ellipsoid,
    "capsule": _capsule,
    "cylinder": _cylinder,
    "mesh": _mesh,
}

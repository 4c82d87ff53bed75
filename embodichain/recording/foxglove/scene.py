"""What an environment looks like: one `SceneEntity` a body, locked to the body's frame.

Shapes become Foxglove's primitives: a capsule is a cylinder with two spheres, a mesh a model as GLB
inside the message.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from embodichain.recording.foxglove.frames import frame_names
from embodichain.recording.foxglove.glb import MEDIA_TYPE, glb
from embodichain.recording.foxglove.messages import (
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
)
from embodichain.recording.foxglove.template import STAMP, Template, stamps
from embodichain.recording.shapes import PLANE_SIZE, Shape, mesh_of, shapes

__all__ = ["Props", "Scene"]


_NO_NUMBERS = np.empty((1, 0))


class Props:
    """What environments share: encoded meshes, whose triangles nothing randomizes.

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


class Scene:
    """The entities of one environment; build a new one when its model fields change.

    Args:
        model: The environment's model.
        env_id: Which one.
        props: Encoded meshes, this model's or of one with the same.
    """

    def __init__(self, model: mujoco.MjModel, env_id: int, props: Props) -> None:
        names = frame_names(model, env_id)
        entities: dict[int, Any] = {}
        for shape in shapes(model):
            entity = entities.get(shape.body)
            if entity is None:
                name = names[shape.body]
                entity = SceneEntity(timestamp=STAMP, frame_id=name, id=name, frame_locked=True)
                entities[shape.body] = entity
            _DRAW[shape.kind](entity, model, shape, props)
        self._template = Template(SceneUpdate(entities=entities.values()).SerializeToString(), 0)

    def update(self, time_ns: int) -> bytes:
        """`SceneUpdate` that replaces all entities, as bytes."""
        return self._template.table(_NO_NUMBERS, stamps([time_ns])).tobytes()


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

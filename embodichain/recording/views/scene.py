"""`/env_I/scene`: one `SceneEntity` for each body, locked to the body's frame.

Shapes become Foxglove's primitives: a capsule is a cylinder with two spheres, a mesh a model as GLB
inside the message.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.recording.views.meshes import MEDIA_TYPE, glb
from embodichain.recording.views.messages import (
    Color,
    Pose,
    Quaternion,
    SceneUpdate,
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
        """Return the GLB of a geom whose shape is a mesh."""
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
    names, update = frame_names(model, env_id), SceneUpdate()
    entities: dict[int, Any] = {}
    for shape in shapes(model):
        entity = entities.get(shape.body)
        if entity is None:
            name = names[shape.body]
            entity = update.entities.add(frame_id=name, id=name, frame_locked=True)
            entities[shape.body] = entity
            set_time(entity.timestamp, time_ns)
        _draw(entity, model, shape, props)
    data: bytes = update.SerializeToString()
    return data


def _draw(entity: Any, model: mujoco.MjModel, shape: Shape, props: Props) -> None:
    """Add the primitives of a shape."""
    size = 2 * shape.half
    common = {
        "pose": _pose(shape),
        "color": Color(**dict(zip("rgba", shape.rgba.tolist(), strict=True))),
    }
    if shape.kind == "box":
        if int(model.geom_type[shape.geom]) == int(mujoco.mjtGeom.mjGEOM_PLANE):
            size[:2] = np.where(model.geom_size[shape.geom][:2] > 0, size[:2], props.ground)
        entity.cubes.add(size=_xyz(size), **common)
    elif shape.kind == "ellipsoid":
        entity.spheres.add(size=_xyz(size), **common)
    elif shape.kind == "mesh":
        entity.models.add(
            scale=Vector3(x=1.0, y=1.0, z=1.0),
            override_color=True,
            media_type=MEDIA_TYPE,
            data=props.mesh(model, shape.geom),
            **common,
        )
    else:  # a cylinder, or a capsule
        entity.cylinders.add(size=_xyz(size), bottom_scale=1.0, top_scale=1.0, **common)
        if shape.kind == "capsule":
            ball = _xyz(size[[0, 0, 0]])
            for end in (-shape.half[2], shape.half[2]):
                entity.spheres.add(size=ball, **{**common, "pose": _pose(shape, along_z=end)})


def _pose(shape: Shape, along_z: float = 0.0) -> Pose:
    """A shape's pose in its body, moved along its own z axis."""
    axis = np.empty(3)
    mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, along_z]), shape.quat)
    w, x, y, z = shape.quat.tolist()
    return Pose(position=_xyz(shape.pos + axis), orientation=Quaternion(x=x, y=y, z=z, w=w))


def _xyz(values: NDArray[np.float64]) -> Vector3:
    x, y, z = values.tolist()
    return Vector3(x=x, y=y, z=z)

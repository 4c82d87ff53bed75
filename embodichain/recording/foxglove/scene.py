"""What an environment looks like: one `SceneEntity` a body, locked to the body's frame.

Geoms that MuJoCo shows by default (groups 0 to 2) become Foxglove's primitives; a capsule is a
cylinder with two spheres, a mesh a list of triangles. Height fields and signed distance fields have
no such primitive and are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

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

__all__ = ["PLANE_SIZE", "Scene"]

PLANE_SIZE = 4.0
"""Metres an infinite plane is drawn wide."""
_PLANE_THICKNESS = 0.002
_HIDDEN_GROUP = 3

F64 = NDArray[np.float64]


class Scene:
    """The entities of one environment; build a new one when its model fields change.

    Args:
        model: The environment's model.
        env_id: Which one.
    """

    def __init__(self, model: mujoco.MjModel, env_id: int) -> None:
        names = frame_names(model, env_id)
        self._entities: dict[int, Any] = {}
        for geom in range(model.ngeom):
            if model.geom_group[geom] >= _HIDDEN_GROUP or _rgba(model, geom)[3] == 0:
                continue
            body = int(model.geom_bodyid[geom])
            entity = self._entities.get(body)
            if entity is None:
                name = names[body]
                entity = SceneEntity(frame_id=name, id=name, frame_locked=True)
                self._entities[body] = entity
            draw = _DRAW.get(int(model.geom_type[geom]))
            if draw is not None:
                draw(entity, model, geom)

    def update(self, time_ns: int) -> bytes:
        """`SceneUpdate` that replaces all entities, as bytes."""
        stamp = timestamp(time_ns)
        for entity in self._entities.values():
            entity.timestamp.CopyFrom(stamp)
        update: bytes = SceneUpdate(entities=self._entities.values()).SerializeToString()
        return update


def _rgba(model: mujoco.MjModel, geom: int) -> F64:
    """A geom's colour: its own, or its material's where its own is the default grey."""
    own, material = model.geom_rgba[geom], int(model.geom_matid[geom])
    if material >= 0 and np.array_equal(own, np.array([0.5, 0.5, 0.5, 1.0], np.float32)):
        own = model.mat_rgba[material] * _texture_mean(model, material)
    return np.asarray(own, np.float64)


def _texture_mean(model: mujoco.MjModel, material: int) -> F64:
    """Mean RGBA of a material's texture: Foxglove's primitives have one colour. 1 without one."""
    texture = int(model.mat_texid[material, int(mujoco.mjtTextureRole.mjTEXROLE_RGB)])
    channels = int(model.tex_nchannel[texture]) if texture >= 0 else 0
    mean = np.ones(4)
    if channels >= 3:
        start = int(model.tex_adr[texture])
        size = int(model.tex_height[texture]) * int(model.tex_width[texture]) * channels
        pixels = model.tex_data[start : start + size].reshape(-1, channels)
        mean[:channels] = pixels.mean(axis=0) / 255
    return mean


def _color(model: mujoco.MjModel, geom: int) -> Any:
    r, g, b, a = _rgba(model, geom).tolist()
    return Color(r=r, g=g, b=b, a=a)


def _pose(model: mujoco.MjModel, geom: int, along_z: float = 0.0) -> Any:
    """A geom's pose in its body, moved along its own z axis."""
    quat = model.geom_quat[geom]
    axis = np.empty(3)
    mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, 1.0]), quat)
    qw, qx, qy, qz = quat.tolist()
    return Pose(
        position=_xyz(model.geom_pos[geom] + along_z * axis),
        orientation=Quaternion(x=qx, y=qy, z=qz, w=qw),
    )


def _xyz(values: Any) -> Vector3:
    x, y, z = (float(v) for v in values)
    return Vector3(x=x, y=y, z=z)


def _box(entity: Any, model: mujoco.MjModel, geom: int) -> None:
    size = _xyz(2 * model.geom_size[geom])
    entity.cubes.append(
        CubePrimitive(pose=_pose(model, geom), size=size, color=_color(model, geom))
    )


def _plane(entity: Any, model: mujoco.MjModel, geom: int) -> None:
    half = model.geom_size[geom]
    width, depth = (2 * h if h > 0 else PLANE_SIZE for h in half[:2])
    pose = _pose(model, geom, along_z=-_PLANE_THICKNESS / 2)
    size = _xyz((width, depth, _PLANE_THICKNESS))
    entity.cubes.append(CubePrimitive(pose=pose, size=size, color=_color(model, geom)))


def _ellipsoid(entity: Any, model: mujoco.MjModel, geom: int) -> None:
    half = model.geom_size[geom]
    if int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_SPHERE):
        half = half[[0, 0, 0]]
    entity.spheres.append(
        SpherePrimitive(pose=_pose(model, geom), size=_xyz(2 * half), color=_color(model, geom))
    )


def _cylinder(entity: Any, model: mujoco.MjModel, geom: int) -> None:
    radius, half = model.geom_size[geom][:2]
    entity.cylinders.append(
        CylinderPrimitive(
            pose=_pose(model, geom),
            size=_xyz((2 * radius, 2 * radius, 2 * half)),
            bottom_scale=1.0,
            top_scale=1.0,
            color=_color(model, geom),
        )
    )


def _capsule(entity: Any, model: mujoco.MjModel, geom: int) -> None:
    _cylinder(entity, model, geom)
    radius, half = model.geom_size[geom][:2]
    for end in (-half, half):
        pose = _pose(model, geom, along_z=float(end))
        size = _xyz((2 * radius,) * 3)
        entity.spheres.append(SpherePrimitive(pose=pose, size=size, color=_color(model, geom)))


# A point on the wire: field 2 of the list, 27 bytes, then x, y and z, each one tag and 8 bytes.
_POINT = np.dtype(
    [("tag", "u1"), ("len", "u1")]
    + [item for c in "xyz" for item in ((f"{c}_tag", "u1"), (c, "<f8"))]
)


def _mesh(entity: Any, model: mujoco.MjModel, geom: int) -> None:
    mesh = int(model.geom_dataid[geom])
    start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = model.mesh_vert[start : start + count]
    points = np.empty(count, _POINT)
    points["tag"], points["len"] = 2 << 3 | 2, 27
    for number, name in enumerate("xyz", start=1):
        points[f"{name}_tag"] = number << 3 | 1
        points[name] = vertices[:, number - 1]
    start, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    indices = model.mesh_face[start : start + count].reshape(-1)
    # Parsed at once by protobuf, instead of one Python object a vertex.
    triangles = TriangleListPrimitive.FromString(points.tobytes() + wire.array(5, indices, "<u4"))
    triangles.pose.CopyFrom(_pose(model, geom))
    triangles.color.CopyFrom(_color(model, geom))
    entity.triangles.append(triangles)


_DRAW: dict[int, Callable[[Any, mujoco.MjModel, int], None]] = {
    int(mujoco.mjtGeom.mjGEOM_PLANE): _plane,
    int(mujoco.mjtGeom.mjGEOM_SPHERE): _ellipsoid,
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): _ellipsoid,
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): _capsule,
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): _cylinder,
    int(mujoco.mjtGeom.mjGEOM_BOX): _box,
    int(mujoco.mjtGeom.mjGEOM_MESH): _mesh,
}

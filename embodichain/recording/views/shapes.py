"""What a model looks like: one `Shape` for every geom that MuJoCo's viewers show.

Groups 0 to 2 are shown unless they are fully transparent. A height field is a mesh here; a signed
distance field shows the mesh it was compiled with.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

__all__ = ["LOOKS", "PLANE_SIZE", "Mesh", "Shape", "mesh_of", "shapes"]

LOOKS = ("geom_size", "geom_pos", "geom_quat", "geom_rgba", "geom_matid", "mat_")
"""Model fields that shapes are made of, and that may be randomized, begin so."""

PLANE_SIZE = 4.0
"""Metres an infinite plane is drawn wide."""
_PLANE_THICKNESS = 0.002
_HIDDEN_GROUP = 3
_GREY = np.array([0.5, 0.5, 0.5, 1.0], np.float32)

F64 = NDArray[np.float64]
Kind = Literal["box", "ellipsoid", "cylinder", "capsule", "mesh"]

_PLANE, _HFIELD, _SPHERE, _ELLIPSOID, _CAPSULE, _CYLINDER, _BOX, _MESH, _SDF = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))
    for name in (
        *("PLANE", "HFIELD", "SPHERE", "ELLIPSOID", "CAPSULE", "CYLINDER"),
        *("BOX", "MESH", "SDF"),
    )
)
_KINDS: dict[int, Kind] = {
    **{_PLANE: "box", _BOX: "box", _SPHERE: "ellipsoid", _ELLIPSOID: "ellipsoid"},
    **{_CAPSULE: "capsule", _CYLINDER: "cylinder"},
    **{_HFIELD: "mesh", _MESH: "mesh", _SDF: "mesh"},
}


@dataclass(frozen=True, slots=True)
class Shape:
    """One geom, in the frame of its body.

    Attributes:
        geom: Id of the geom.
        body: Id of its body.
        kind: What to draw. A plane is a thin box below its surface.
        pos: (3,) centre, metres.
        quat: (4,) orientation, wxyz; cylinders and capsules lie along their z axis.
        half: (3,) half sizes, metres; of a capsule radius, radius and half its straight part; of a
            mesh 1.
        rgba: (4,) in 0 to 1: the geom's, or its material's with the mean of its texture.
    """

    geom: int
    body: int
    kind: Kind
    pos: F64
    quat: F64
    half: F64
    rgba: F64


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles of a mesh, in the frame of its geom.

    Attributes:
        vertices: (V, 3) metres.
        faces: (F, 3) indices of vertices, counter-clockwise seen from outside.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]


def shapes(model: mujoco.MjModel) -> Iterator[Shape]:
    """Yield what is shown of a model, by geom."""
    for geom in range(model.ngeom):
        if model.geom_group[geom] < _HIDDEN_GROUP:
            rgba = _rgba(model, geom)
            if rgba[3] > 0:
                yield _shape(model, geom, rgba)


def mesh_of(model: mujoco.MjModel, geom: int) -> Mesh:
    """The triangles of a geom whose shape is a mesh."""
    index = int(model.geom_dataid[geom])
    if int(model.geom_type[geom]) == _HFIELD:
        return _height_field(model, index)
    start, count = int(model.mesh_vertadr[index]), int(model.mesh_vertnum[index])
    vertices = model.mesh_vert[start : start + count]
    start, count = int(model.mesh_faceadr[index]), int(model.mesh_facenum[index])
    return Mesh(vertices, model.mesh_face[start : start + count])


def _shape(model: mujoco.MjModel, geom: int, rgba: F64) -> Shape:
    kind = int(model.geom_type[geom])
    pos, quat = model.geom_pos[geom].copy(), model.geom_quat[geom].copy()
    half = model.geom_size[geom].copy()
    if kind == _SPHERE:
        half[:] = half[0]
    elif kind in (_CAPSULE, _CYLINDER):
        half[:] = half[[0, 0, 1]]
    elif kind == _PLANE:
        half[:2] = np.where(half[:2] > 0, half[:2], PLANE_SIZE / 2)
        half[2] = _PLANE_THICKNESS / 2
        down = np.empty(3)
        mujoco.mju_rotVecQuat(down, np.array([0.0, 0.0, -half[2]]), quat)
        pos += down
    elif _KINDS[kind] == "mesh":
        half[:] = 1.0
    return Shape(geom, int(model.geom_bodyid[geom]), _KINDS[kind], pos, quat, half, rgba)


def _rgba(model: mujoco.MjModel, geom: int) -> F64:
    """A geom's colour: its own, or its material's where its own is the default grey."""
    own, material = model.geom_rgba[geom], int(model.geom_matid[geom])
    if material >= 0 and np.array_equal(own, _GREY):
        own = model.mat_rgba[material] * _texture_mean(model, material)
    return np.asarray(own, np.float64)


def _texture_mean(model: mujoco.MjModel, material: int) -> F64:
    """Mean RGBA of a material's texture: viewers' primitives have one colour. 1 without one."""
    texture = int(model.mat_texid[material, int(mujoco.mjtTextureRole.mjTEXROLE_RGB)])
    channels = int(model.tex_nchannel[texture]) if texture >= 0 else 0
    mean = np.ones(4)
    if channels >= 3:
        start = int(model.tex_adr[texture])
        size = int(model.tex_height[texture]) * int(model.tex_width[texture]) * channels
        pixels = model.tex_data[start : start + size].reshape(-1, channels)
        mean[:channels] = pixels.mean(axis=0) / 255
    return mean


def _height_field(model: mujoco.MjModel, index: int) -> Mesh:
    """The surface of a height field: two triangles a cell."""
    rows, columns = int(model.hfield_nrow[index]), int(model.hfield_ncol[index])
    half_x, half_y, height, _ = model.hfield_size[index]
    start = int(model.hfield_adr[index])
    x, y = np.meshgrid(np.linspace(-half_x, half_x, columns), np.linspace(-half_y, half_y, rows))
    z = height * model.hfield_data[start : start + rows * columns]
    vertices = np.stack([x.ravel(), y.ravel(), z], axis=1).astype(np.float32)
    ids = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = ids[:-1, :-1], ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2)
    return Mesh(vertices, faces.reshape(-1, 3))

"""Visible shapes of a model: one `Shape` for every geom that MuJoCo's viewers show; GLB meshes.

Geoms of groups 0 to 2 are shown unless they are fully transparent. A height field is converted to
a mesh; a signed distance field is shown as the mesh it was compiled with.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import F64

__all__ = [
    "LOOKS",
    "MEDIA_TYPE",
    "PLANE_SIZE",
    "Mesh",
    "Shape",
    "corner_normals",
    "glb",
    "mesh_of",
    "shapes",
]

LOOKS = ("geom_size", "geom_pos", "geom_quat", "geom_rgba", "geom_matid", "mat_")
"""Prefixes of the randomizable model fields that shapes depend on."""
MEDIA_TYPE = "model/gltf-binary"
PLANE_SIZE = 4.0
"""Width at which an infinite plane is drawn, metres."""
_PLANE_THICKNESS = 0.002
_HIDDEN_GROUP = 3
_GREY = np.array([0.5, 0.5, 0.5, 1.0], np.float32)
_SHARP = np.cos(np.radians(40))
"""Cosine of 40 degrees: edges with a larger angle are sharp; smaller ones are shaded smooth."""
_SAME_RISE = 1e-6
"""Difference in metres below which the rises of neighbouring cells of a height field are equal."""
_MOST_FACES = 256
"""Vertices with more faces are shaded flat: the number of pairs of faces is quadratic."""

Kind = Literal["box", "ellipsoid", "cylinder", "capsule", "mesh"]

_T = mujoco.mjtGeom
_KINDS: dict[int, Kind] = {
    int(_T.mjGEOM_PLANE): "box",
    int(_T.mjGEOM_BOX): "box",
    int(_T.mjGEOM_SPHERE): "ellipsoid",
    int(_T.mjGEOM_ELLIPSOID): "ellipsoid",
    int(_T.mjGEOM_CAPSULE): "capsule",
    int(_T.mjGEOM_CYLINDER): "cylinder",
    int(_T.mjGEOM_HFIELD): "mesh",
    int(_T.mjGEOM_MESH): "mesh",
    int(_T.mjGEOM_SDF): "mesh",
}


@dataclass(frozen=True, slots=True)
class Shape:
    """One geom, in the frame of its body.

    Attributes:
        geom: Id of the geom.
        body: Id of its body.
        kind: Kind of shape. A plane is a thin box below its surface.
        pos: (3,) centre, metres.
        quat: (4,) orientation, wxyz; cylinders and capsules are along their z axis.
        half: (3,) half sizes, metres; for a capsule: radius, radius, half of its straight part;
            for a mesh: 1.
        rgba: (4,) in 0 to 1: the geom's colour, or its material's times the texture's mean.
    """

    geom: int
    body: int
    kind: Kind
    pos: F64
    quat: F64
    half: F64
    rgba: F64


class Mesh(NamedTuple):
    """Triangles of a mesh, in the frame of its geom.

    Attributes:
        vertices: (V, 3) metres.
        faces: (F, 3) indices of vertices, counter-clockwise as viewed from outside.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]


def shapes(model: mujoco.MjModel) -> Iterator[Shape]:
    """Yield the visible shapes of a model, by geom."""
    for geom in range(model.ngeom):
        if model.geom_group[geom] < _HIDDEN_GROUP:
            rgba = _rgba(model, geom)
            if rgba[3] > 0:
                yield _shape(model, geom, rgba)


def _shape(model: mujoco.MjModel, geom: int, rgba: F64) -> Shape:
    kind = int(model.geom_type[geom])
    pos = model.geom_pos[geom].copy()
    quat = model.geom_quat[geom].copy()
    half = model.geom_size[geom].copy()
    if kind == _T.mjGEOM_SPHERE:
        half[:] = half[0]
    elif kind in (_T.mjGEOM_CAPSULE, _T.mjGEOM_CYLINDER):
        half[:] = half[[0, 0, 1]]
    elif kind == _T.mjGEOM_PLANE:
        half[:2] = np.where(half[:2] > 0, half[:2], PLANE_SIZE / 2)
        half[2] = _PLANE_THICKNESS / 2
        down = np.empty(3)
        mujoco.mju_rotVecQuat(down, np.array([0.0, 0.0, -half[2]]), quat)
        pos += down
    elif _KINDS[kind] == "mesh":
        half[:] = 1.0
    return Shape(
        geom=geom,
        body=int(model.geom_bodyid[geom]),
        kind=_KINDS[kind],
        pos=pos,
        quat=quat,
        half=half,
        rgba=rgba,
    )


def _rgba(model: mujoco.MjModel, geom: int) -> F64:
    """A geom's colour, or its material's if the geom's is the default grey.

    A texture is replaced by its mean, since viewers' primitives have one colour.
    """
    geom_rgba = model.geom_rgba[geom]
    material = int(model.geom_matid[geom])
    if material < 0 or not np.array_equal(geom_rgba, _GREY):
        return np.asarray(geom_rgba, np.float64)
    rgba = np.asarray(model.mat_rgba[material], np.float64)
    texture = int(model.mat_texid[material, int(mujoco.mjtTextureRole.mjTEXROLE_RGB)])
    channels = int(model.tex_nchannel[texture]) if texture >= 0 else 0
    if channels >= 3:
        start = int(model.tex_adr[texture])
        size = int(model.tex_height[texture]) * int(model.tex_width[texture]) * channels
        pixels = model.tex_data[start : start + size].reshape(-1, channels)
        rgba[:channels] *= pixels.mean(axis=0) / 255
    return rgba


# -- meshes ----------------------------------------------------------------------------------------


def mesh_of(model: mujoco.MjModel, geom: int) -> Mesh:
    """The triangles of a geom whose shape is a mesh."""
    index = int(model.geom_dataid[geom])
    if int(model.geom_type[geom]) == _T.mjGEOM_HFIELD:
        return _height_field(model, index)
    start = int(model.mesh_vertadr[index])
    count = int(model.mesh_vertnum[index])
    vertices = model.mesh_vert[start : start + count]
    start = int(model.mesh_faceadr[index])
    count = int(model.mesh_facenum[index])
    return Mesh(vertices, model.mesh_face[start : start + count])


def _height_field(model: mujoco.MjModel, index: int) -> Mesh:
    """The surface of a height field: two triangles for each run of cells along x in one plane."""
    rows = int(model.hfield_nrow[index])
    columns = int(model.hfield_ncol[index])
    half_x, half_y, height, _ = model.hfield_size[index]
    start = int(model.hfield_adr[index])
    x, y = np.meshgrid(np.linspace(-half_x, half_x, columns), np.linspace(-half_y, half_y, rows))
    z = height * model.hfield_data[start : start + rows * columns]
    vertices = np.stack([x.ravel(), y.ravel(), z], axis=1).astype(np.float32)
    ids = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    rise = np.diff(z.reshape(rows, columns), axis=1)
    # A cell continues a run if both of its edges along x rise as those of the cell before.
    edges = np.stack([rise[:-1, :-1], rise[:-1, 1:], rise[1:, :-1], rise[1:, 1:]])
    begins_run = np.ones((rows - 1, columns - 1), np.bool_)
    begins_run[:, 1:] = np.ptp(edges, axis=0) > _SAME_RISE
    ends_run = np.roll(begins_run, -1, axis=1)
    ends_run[:, -1] = True
    # The corners of each run, counter-clockwise.
    a = ids[:-1, :-1][begins_run]
    b = ids[:-1, 1:][ends_run]
    c = ids[1:, 1:][ends_run]
    d = ids[1:, :-1][begins_run]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=1)
    return Mesh(vertices, faces.reshape(-1, 3))


def corner_normals(mesh: Mesh) -> F64:
    """Return (3 F, 3) unit normals at the corners of (F, 3) faces.

    Each is the area-weighted mean over the faces at its vertex whose angle to the corner's face is
    less than 40 degrees.
    """
    points = mesh.vertices[mesh.faces].astype(np.float64)
    areas = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    up = np.tile([0.0, 0.0, 1.0], (len(areas), 1))  # for triangles without area
    units = _normalized(areas, up)
    # All pairs of corners (3 x face + index) that share a vertex, including pairs of equal corners.
    vertex = mesh.faces.reshape(-1)
    order = np.argsort(vertex, kind="stable")
    count = np.bincount(vertex)
    start = np.cumsum(count) - count
    repeat = np.where(count[vertex] > _MOST_FACES, 0, count[vertex])
    corner = np.repeat(np.arange(len(vertex)), repeat)
    rank = np.arange(len(corner)) - np.repeat(np.cumsum(repeat) - repeat, repeat)
    other = order[start[vertex[corner]] + rank]
    is_smooth = (units[corner // 3] * units[other // 3]).sum(axis=1) >= _SHARP
    corner = corner[is_smooth]
    weights = areas[other[is_smooth] // 3]
    sums = [np.bincount(corner, weights[:, axis], len(vertex)) for axis in range(3)]
    return _normalized(np.stack(sums, axis=1), np.repeat(units, 3, axis=0))


def _normalized(vectors: F64, otherwise: F64) -> F64:
    """(n, 3) unit vectors; `otherwise` where the length is 0."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    units: F64 = np.divide(vectors, length, out=otherwise, where=length > 0)
    return units


def glb(mesh: Mesh) -> bytes:
    """Encode positions, normals and triangles as binary glTF 2.0.

    The mesh has no colour: the primitive that embeds it has one. In glTF the y axis is up, in the
    mesh the z axis: the node rotates the mesh, and viewers rotate it back.
    """
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    rows, index = _unique(np.concatenate([corners, corner_normals(mesh)], axis=1).astype("<f4"))
    points = rows[:, :3]
    normals = rows[:, 3:]
    buffers = [points.tobytes(), normals.tobytes(), index.astype("<u4").tobytes()]
    ends = np.cumsum([len(buffer) for buffer in buffers]).tolist()  # multiples of four
    views = [
        {"buffer": 0, "byteOffset": end - len(buffer), "byteLength": len(buffer), "target": target}
        for buffer, end, target in zip(buffers, ends, (34962, 34962, 34963), strict=True)
    ]
    vectors = {"componentType": 5126, "count": len(rows), "type": "VEC3"}  # float32
    box = {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
    indices = {"componentType": 5125, "count": index.size, "type": "SCALAR"}  # uint32
    primitive = {"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2, "material": 0}
    half = float(np.sqrt(0.5))
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": [-half, 0.0, 0.0, half]}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.7}}],
        "accessors": [
            {"bufferView": 0, **vectors, **box},
            {"bufferView": 1, **vectors},
            {"bufferView": 2, **indices},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": ends[-1]}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + ends[-1])
    json_head = struct.pack("<I4s", len(text), b"JSON")
    binary_head = struct.pack("<I4s", ends[-1], b"BIN\0")
    return b"".join([head, json_head, text, binary_head, *buffers])


def _unique(rows: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return the distinct rows of an (n, 6) array, and the index of each row among them.

    `np.unique` with an axis is slower by a factor of 5.
    """
    words = rows.view(np.uint64)
    order = np.lexsort(words.T)
    is_new = np.ones(len(rows), np.bool_)
    is_new[1:] = (words[order[1:]] != words[order[:-1]]).any(axis=1)
    index = np.empty(len(rows), np.int64)
    index[order] = np.cumsum(is_new) - 1
    return rows[order[is_new]], index

"""`SceneGeometry`: the triangles of a model's visible geoms, in buffers that one draw call takes.

Primitives are of unit size, so that a geom's size is a number an environment uploads. A vertex is
``position x scale``, moved along z by ``end x half length``: that is what the two caps of a capsule
need, which keep their radius when its length changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.overlays import PartKind

__all__ = ["VERTEX", "SceneGeometry", "geom_scales", "overlay_geometry"]

VERTEX = np.dtype(
    [
        ("position", np.float32, 3),
        ("normal", np.float32, 3),
        ("texcoord", np.float32, 2),
        ("geom", np.float32),
        ("end", np.float32),
    ]
)
"""A vertex; ``geom`` is its id, ``end`` is -1, 0 or 1."""

F32 = NDArray[np.float32]
Triangles = NDArray[np.uint32]

_PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
_HFIELD = int(mujoco.mjtGeom.mjGEOM_HFIELD)
_SPHERE = int(mujoco.mjtGeom.mjGEOM_SPHERE)
_CAPSULE = int(mujoco.mjtGeom.mjGEOM_CAPSULE)
_ELLIPSOID = int(mujoco.mjtGeom.mjGEOM_ELLIPSOID)
_CYLINDER = int(mujoco.mjtGeom.mjGEOM_CYLINDER)
_BOX = int(mujoco.mjtGeom.mjGEOM_BOX)
_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)

VISIBLE_GROUPS = 3
"""Geoms of the groups 0, 1, 2 are drawn, as in MuJoCo's own viewers; 3 to 5 are for collisions."""


@dataclass(frozen=True, eq=False)
class SceneGeometry:
    """What is drawn of a model.

    Attributes:
        vertices: (V,) of `VERTEX`.
        triangles: Geom id -> (T, 3) indices of vertices; planes come last, they are behind.
        planes: Ids of the planes among them.
        fields: Ids of the height fields among them.
    """

    vertices: NDArray[Any]
    triangles: dict[int, Triangles]
    planes: frozenset[int]
    fields: frozenset[int]

    @classmethod
    def of_model(
        cls, model: mujoco.MjModel, slices: int, most_triangles: int | None = None
    ) -> SceneGeometry:
        """Collect the geoms that are visible.

        Args:
            model: The compiled scene.
            slices: Around a sphere or cylinder.
            most_triangles: Meshes without texture coordinates are simplified to about so many.
        """
        parts: list[NDArray[Any]] = [np.zeros(0, VERTEX)]
        triangles: dict[int, Triangles] = {}
        count = 0
        for geom in np.argsort(model.geom_type == _PLANE, kind="stable").tolist():
            if model.geom_group[geom] >= VISIBLE_GROUPS:
                continue
            shape = _shape_of(model, geom, slices, most_triangles)
            if shape is None:
                continue
            vertices, faces = shape
            part, faces = _in_patches(vertices, faces)
            part["geom"] = geom
            parts.append(part)
            triangles[geom] = faces + np.uint32(count)
            count += len(part)
        return cls(
            vertices=np.concatenate(parts),
            triangles=triangles,
            planes=frozenset(geom for geom in triangles if model.geom_type[geom] == _PLANE),
            fields=frozenset(geom for geom in triangles if model.geom_type[geom] == _HFIELD),
        )


def overlay_geometry(kinds: Sequence[PartKind], first: int, slices: int) -> SceneGeometry:
    """Return the parts of an overlay as geoms whose ids follow those of a model.

    Args:
        kinds: What each part is; all are of unit size.
        first: The id of the first.
        slices: Around each of them.
    """
    parts: list[NDArray[Any]] = [np.zeros(0, VERTEX)]
    triangles: dict[int, Triangles] = {}
    count = 0
    for geom, kind in enumerate(kinds, first):
        if kind == "sphere":
            part, faces = _round(slices, np.linspace(0.0, np.pi, slices // 2 + 1), None)
        elif kind == "cylinder":
            part, faces = _cylinder(slices)
        else:
            part, faces = _cone(slices)
        part["geom"] = geom
        parts.append(part)
        triangles[geom] = faces + np.uint32(count)
        count += len(part)
    return SceneGeometry(np.concatenate(parts), triangles, frozenset(), frozenset())


def geom_scales(types: NDArray[np.int32], sizes: NDArray[Any]) -> F32:
    """(..., ngeom, 4) scales of unit shapes along x, y, z, and half lengths, of geoms' sizes.

    The scale of a plane without an edge is 0 along it.

    Args:
        types: (ngeom,) of `mjtGeom`.
        sizes: (..., ngeom, 3) `geom_size`.
    """
    scales: F32 = np.ones((*sizes.shape[:-1], 4), np.float32)
    x = sizes[..., 0]
    y = sizes[..., 1]
    z = sizes[..., 2]
    scales[..., 3] = 0.0
    for kind, values in (
        (_PLANE, (np.maximum(x, 0), np.maximum(y, 0), np.ones_like(x))),
        (_SPHERE, (x, x, x)),
        (_CAPSULE, (x, x, x)),
        (_ELLIPSOID, (x, y, z)),
        (_CYLINDER, (x, x, y)),
        (_BOX, (x, y, z)),
    ):
        of_kind = types == kind
        for axis, value in enumerate(values):
            scales[..., of_kind, axis] = value[..., of_kind]
    capsules = types == _CAPSULE
    scales[..., capsules, 3] = y[..., capsules]
    return scales


def _shape_of(
    model: mujoco.MjModel, geom: int, slices: int, most_triangles: int | None
) -> tuple[NDArray[Any], Triangles] | None:
    """Return the vertices and triangles of a geom; None where MuJoCo draws nothing else."""
    kind = int(model.geom_type[geom])
    data = int(model.geom_dataid[geom])
    if kind == _MESH:
        vertices, triangles = _mesh(model, data)
        has_texcoords = model.mesh_texcoordadr[data] >= 0
        if most_triangles is None or has_texcoords or len(triangles) <= most_triangles:
            return vertices, triangles
        return _simplified(vertices, triangles, most_triangles)
    if kind == _HFIELD:
        return _height_field(model, data)
    if kind == _PLANE:
        return _grid(1, 1, lambda u, v: (2 * u - 1, 1 - 2 * v, 0 * u), _upwards)
    if kind in (_SPHERE, _ELLIPSOID):
        return _round(slices, np.linspace(0.0, np.pi, slices // 2 + 1), None)
    if kind == _CAPSULE:
        half = np.linspace(0.0, np.pi / 2, slices // 4 + 1)
        return _round(slices, np.concatenate([half, half + np.pi / 2]), slices // 4)
    if kind == _CYLINDER:
        return _cylinder(slices)
    if kind == _BOX:
        return _box()
    return None


def _in_patches(vertices: NDArray[Any], triangles: Triangles) -> tuple[NDArray[Any], Triangles]:
    """The same surface, in patches of neighbours, so that drawing shades vertices less often.

    Triangles are sorted along a Z-order curve, and vertices by their first triangle. The software
    rasterizer shades the vertices of 341 triangles at a time: 1.0 for each triangle of the Panda's
    meshes, and 0.7 in this order.
    """
    middles = vertices["position"][triangles].mean(axis=1)
    low = middles.min(axis=0)
    high = middles.max(axis=0)
    cells = ((middles - low) / max(float((high - low).max()), 1e-9) * 1023).astype(np.int64)
    curve = np.zeros(len(triangles), np.int64)
    for bit in range(10):
        curve |= (((cells >> bit) & 1) << (3 * bit + np.arange(3))).sum(axis=1)
    triangles = triangles[np.argsort(curve, kind="stable")]
    used, first = np.unique(triangles, return_index=True)
    used = used[np.argsort(first)]
    places = np.zeros(len(vertices), np.uint32)
    places[used] = np.arange(len(used))
    return vertices[used], places[triangles]


def _vertices(position: Any, normal: Any, texcoord: Any, end: Any = 0.0) -> NDArray[Any]:
    vertices = np.zeros(len(position), VERTEX)
    vertices["position"] = position
    vertices["normal"] = normal
    vertices["texcoord"] = texcoord
    vertices["end"] = end
    return vertices


def _from_above(places: NDArray[Any], half: NDArray[Any]) -> NDArray[Any]:
    """(V, 2) texture coordinates of a mesh that has none: its x and y."""
    return 0.5 + 0.5 * places[:, :2] / half[:2] * (1.0, -1.0)


def _upwards(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.tile([0.0, 0.0, 1.0], (len(points), 1))


def _grid(rows: int, columns: int, place: Any, normal: Any) -> tuple[NDArray[Any], Triangles]:
    """A surface over the unit square, (rows x columns) quads; x grows with u, y falls with v."""
    u = np.tile(np.linspace(0, 1, columns + 1), rows + 1)
    v = np.repeat(np.linspace(0, 1, rows + 1), columns + 1)
    points = np.stack(place(u, v), axis=1)
    return _vertices(points, normal(points), np.stack([u, v], axis=1)), _quads(rows, columns)


def _quads(rows: int, columns: int) -> Triangles:
    """Two triangles for each quad of a grid of (rows + 1) x (columns + 1) vertices.

    Quads are cut from the left below to the right above, as MuJoCo's height fields are.
    """
    a = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).reshape(-1)
    b = a + columns + 1
    c = a + columns + 2
    d = a + 1
    faces = np.stack([np.stack([a, b, d], 1), np.stack([b, c, d], 1)], axis=1)
    return faces.reshape(-1, 3).astype(np.uint32)


def _round(
    slices: int, polar: NDArray[np.float64], ring: int | None
) -> tuple[NDArray[Any], Triangles]:
    """A unit sphere by rings of polar angles; those up to `ring` are the upper cap of a capsule."""
    stacks = len(polar) - 1
    grid = np.meshgrid(np.linspace(0, 2 * np.pi, slices + 1), polar)
    azimuth = grid[0].reshape(-1)
    inclination = grid[1].reshape(-1)
    sine = np.sin(inclination)
    points = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(inclination)], axis=1)
    end: Any = 0.0
    if ring is not None:
        end = np.where(np.arange(stacks + 1) <= ring, 1.0, -1.0).repeat(slices + 1)
    texcoord = np.stack([azimuth / (2 * np.pi), inclination / np.pi], axis=1)
    return _vertices(points, points, texcoord, end), _quads(stacks, slices)


def _cylinder(slices: int) -> tuple[NDArray[Any], Triangles]:
    angle = np.linspace(0, 2 * np.pi, slices + 1)
    cos = np.cos(angle)
    sin = np.sin(angle)
    one = np.ones(slices + 1)
    parts: list[NDArray[Any]] = []
    faces: list[Triangles] = []
    start = 0

    def add(rings: list[tuple[float, float]], normal: Any) -> None:
        """Add what lies between two rings, each a radius and a height."""
        nonlocal start
        points = [np.stack([r * cos, r * sin, z * one], axis=1) for r, z in rings]
        place = np.concatenate(points)
        down = np.repeat([0.0, 1.0], slices + 1)
        texcoord = np.stack([np.tile(angle / (2 * np.pi), 2), down], axis=1)
        if rings[0][1] == rings[1][1]:
            texcoord = 0.5 + 0.5 * place[:, :2]  # as MuJoCo's
        parts.append(_vertices(place, normal, texcoord))
        faces.append(_quads(1, slices) + np.uint32(start))
        start += 2 * (slices + 1)

    around = np.stack([cos, sin, 0 * one], axis=1)
    add([(1.0, 1.0), (1.0, -1.0)], np.tile(around, (2, 1)))
    add([(0.0, 1.0), (1.0, 1.0)], np.array([0.0, 0.0, 1.0]))
    add([(1.0, -1.0), (0.0, -1.0)], np.array([0.0, 0.0, -1.0]))
    return np.concatenate(parts), np.concatenate(faces)


def _cone(slices: int) -> tuple[NDArray[Any], Triangles]:
    """A unit cone from a base at z = -1 to a tip at z = 1."""
    angle = np.linspace(0, 2 * np.pi, slices + 1)
    cos = np.cos(angle)
    sin = np.sin(angle)
    one = np.ones(slices + 1)
    base = np.stack([cos, sin, -one], axis=1)
    outwards = np.stack([cos, sin, 0.5 * one], axis=1) / np.hypot(1.0, 0.5)
    side = _vertices(
        np.concatenate([np.stack([0 * one, 0 * one, one], axis=1), base]),
        np.tile(outwards, (2, 1)),
        np.zeros(2),
    )
    centre = np.stack([0 * one, 0 * one, -one], axis=1)
    bottom = _vertices(np.concatenate([base, centre]), np.array([0.0, 0.0, -1.0]), np.zeros(2))
    faces = _quads(1, slices)
    return np.concatenate([side, bottom]), np.concatenate([faces, faces + np.uint32(len(side))])


def _box() -> tuple[NDArray[Any], Triangles]:
    parts: list[NDArray[Any]] = []
    faces: list[Triangles] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            part, quad = _grid(1, 1, lambda u, v: (2 * u - 1, 1 - 2 * v, 0 * u), _upwards)
            corners = np.zeros((4, 3))
            # Mirrored on the side that looks the other way, so that it is seen from outside.
            corners[:, (axis + 1) % 3] = sign * part["position"][:, 0]
            corners[:, (axis + 2) % 3] = part["position"][:, 1]
            corners[:, axis] = sign
            normal = np.zeros(3)
            normal[axis] = sign
            parts.append(_vertices(corners, normal, part["texcoord"]))
            faces.append(quad + np.uint32(4 * len(faces)))
    return np.concatenate(parts), np.concatenate(faces)


def _mesh(model: mujoco.MjModel, mesh: int) -> tuple[NDArray[Any], Triangles]:
    """A mesh's faces; corners that differ in normal or texture coordinate are vertices apart.

    MuJoCo averages normals at a vertex; where that differs from a face's normal by more than 37 deg
    (a cosine of 0.8), the edge is sharp and the corner has the face's normal.
    """

    def part(name: str, first: str, count: str) -> NDArray[Any]:
        start = int(getattr(model, first)[mesh])
        if start < 0:
            return np.zeros((0, 2), np.float32)
        return getattr(model, name)[start : start + int(getattr(model, count)[mesh])]

    positions = part("mesh_vert", "mesh_vertadr", "mesh_vertnum")
    normals = part("mesh_normal", "mesh_normaladr", "mesh_normalnum")
    texcoords = part("mesh_texcoord", "mesh_texcoordadr", "mesh_texcoordnum")
    face = slice(int(model.mesh_faceadr[mesh]), None)
    count = int(model.mesh_facenum[mesh])
    faces = model.mesh_face[face][:count].astype(np.int64)
    averaged = model.mesh_facenormal[face][:count].astype(np.int64)
    face_normals = _face_normals(positions, faces)
    is_sharp = (normals[averaged] * face_normals[:, None]).sum(axis=2) < 0.8
    of_face = np.broadcast_to(len(normals) + np.arange(count)[:, None], faces.shape)
    normals = np.concatenate([normals, face_normals])
    corners = [faces.reshape(-1), np.where(is_sharp, of_face, averaged).reshape(-1)]
    if len(texcoords):
        corners.append(model.mesh_facetexcoord[face][:count].reshape(-1).astype(np.int64))
    unique, inverse = np.unique(np.stack(corners, axis=1), axis=0, return_inverse=True)
    places = positions[unique[:, 0]]
    if len(texcoords):
        texcoord = texcoords[unique[:, 2]]
    else:
        half = np.maximum(np.abs(positions).max(axis=0, initial=0.0), 1e-9)
        texcoord = _from_above(places, half)
    vertices = _vertices(places, normals[unique[:, 1]], texcoord)
    return vertices, inverse.reshape(-1, 3).astype(np.uint32)


def _face_normals(points: NDArray[Any], faces: NDArray[np.int64]) -> NDArray[Any]:
    """(F, 3) unit normals; zeros where a face has no area."""
    corners = points[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)


def _simplified(
    vertices: NDArray[Any], triangles: Triangles, most: int
) -> tuple[NDArray[Any], Triangles]:
    """A mesh of about `most` triangles by quadric decimation."""
    import fast_simplification

    points, joined = np.unique(vertices["position"], axis=0, return_inverse=True)
    points, faces = fast_simplification.simplify(
        points, joined[triangles].astype(np.int32), target_count=most
    )
    return _creased(np.asarray(points), faces.astype(np.int64))


def _creased(points: NDArray[Any], faces: NDArray[np.int64]) -> tuple[NDArray[Any], Triangles]:
    """Triangles with normals: smooth across edges, but not where faces turn by more than 60 deg."""
    corners = points[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)

    # All ordered pairs of corners that are at the same point.
    point = faces.reshape(-1)
    sharing = np.bincount(point, minlength=len(points))  # corners at each point
    corner = np.repeat(np.arange(point.size), sharing[point])
    before = np.cumsum(sharing[point]) - sharing[point]
    turn = np.arange(corner.size) - np.repeat(before, sharing[point])
    by_point = np.argsort(point, kind="stable")
    first = np.cumsum(sharing) - sharing
    other = by_point[first[point[corner]] + turn]

    # A corner's normal is the mean over those whose faces are nearly parallel to its own.
    is_smooth = (unit[corner // 3] * unit[other // 3]).sum(axis=1) > np.cos(np.radians(60.0))
    normals = np.zeros((point.size, 3))
    np.add.at(normals, corner[is_smooth], across[other[is_smooth] // 3])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)

    # Corners that agree in point and normal are one vertex.
    rows = np.concatenate([faces.reshape(-1, 1), np.round(1e4 * normals).astype(np.int64)], axis=1)
    _, unique, joined = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    half = np.maximum(np.abs(points).max(axis=0, initial=0.0), 1e-9)
    places = points[faces.reshape(-1)[unique]]
    vertices = _vertices(places, normals[unique], _from_above(places, half))
    return vertices, joined.reshape(-1, 3).astype(np.uint32)


def _height_field(model: mujoco.MjModel, field: int) -> tuple[NDArray[Any], Triangles]:
    """The top of a height field, and nothing of its sides."""
    rows = int(model.hfield_nrow[field])
    columns = int(model.hfield_ncol[field])
    start = int(model.hfield_adr[field])
    data = model.hfield_data[start : start + rows * columns].reshape(rows, columns)
    x, y, top, _ = model.hfield_size[field]
    heights = data[::-1].astype(np.float64) * top  # the first row of the data is at -y
    slope_y, slope_x = np.gradient(heights, 2 * y / max(rows - 1, 1), 2 * x / max(columns - 1, 1))
    normals = np.stack([-slope_x, slope_y, np.ones_like(heights)], axis=-1).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)

    def place(u: Any, v: Any) -> tuple[Any, Any, Any]:
        return (2 * u - 1) * x, (1 - 2 * v) * y, heights.reshape(-1)

    return _grid(rows - 1, columns - 1, place, lambda points: normals)

"""Meshes as binary glTF 2.0 (GLB), which `ModelPrimitive` embeds and browsers draw at once.

A mesh has no colour of its own: the primitive gives it, so a randomized colour needs no new mesh.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.views.shapes import Mesh

__all__ = ["MEDIA_TYPE", "corner_normals", "glb"]

MEDIA_TYPE = "model/gltf-binary"

# glTF 2.0, sections 3.6 (accessors, buffer views) and 4 (GLB).
_MAGIC, _VERSION, _JSON, _BIN = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
_FLOAT, _UINT = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
_HALF = float(np.sqrt(0.5))
_SHARP = np.cos(np.radians(40))
"""Faces that meet at more than 40 degrees keep an edge; others are shaded as one surface."""
_MOST_FACES = 256
"""At a vertex, above which its faces stay flat: the number of pairs is quadratic."""


def glb(mesh: Mesh) -> bytes:
    """Encode positions, normals and triangles.

    Args:
        mesh: The mesh. Its z axis is up, glTF's is y: the node turns it, viewers turn it back.
    """
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    rows, index = _unique(np.concatenate([corners, corner_normals(mesh)], axis=1).astype("<f4"))
    points, normals = rows[:, :3], rows[:, 3:]
    buffers = [points.tobytes(), normals.tobytes(), index.astype("<u4").tobytes()]
    views, offset = [], 0
    for buffer, target in zip(buffers, (_VERTICES, _VERTICES, _INDICES), strict=True):
        size = len(buffer)  # a multiple of four
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": size, "target": target})
        offset += size
    vectors = {"componentType": _FLOAT, "count": len(rows), "type": "VEC3"}
    ends = {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
    indices = {"componentType": _UINT, "count": index.size, "type": "SCALAR"}
    primitive = {"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2, "material": 0}
    document: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": [-_HALF, 0.0, 0.0, _HALF]}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.7}}],
        "accessors": [
            {"bufferView": 0, **vectors, **ends},
            {"bufferView": 1, **vectors},
            {"bufferView": 2, **indices},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<III", _MAGIC, _VERSION, 12 + 8 + len(text) + 8 + offset)
    chunks = struct.pack("<II", len(text), _JSON), text, struct.pack("<II", offset, _BIN)
    return b"".join([head, *chunks, *buffers])


def _unique(rows: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Return the distinct rows of (n, 6) float32, and which of them each row is.

    `np.unique` with an axis takes five times as long.
    """
    words = rows.view(np.uint64)
    order = np.lexsort(words.T)
    new = np.ones(len(rows), np.bool_)
    new[1:] = (words[order[1:]] != words[order[:-1]]).any(axis=1)
    index = np.empty(len(rows), np.int64)
    index[order] = np.cumsum(new) - 1
    return rows[order[new]], index


def corner_normals(mesh: Mesh) -> NDArray[np.float64]:
    """Return (3 F, 3) unit normals at the corners of (F, 3) faces.

    Each is the area-weighted mean of the faces at its vertex that meet the corner's own at less
    than 40 degrees.
    """
    points = mesh.vertices[mesh.faces].astype(np.float64)
    areas = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    length = np.linalg.norm(areas, axis=1, keepdims=True)
    up = np.tile([0.0, 0.0, 1.0], (len(areas), 1))  # of triangles without area
    units = np.divide(areas, length, out=up, where=length > 0)
    # All pairs of corners (face x 3 + number) that share a vertex, each with itself too.
    vertex = mesh.faces.reshape(-1)
    order, count = np.argsort(vertex, kind="stable"), np.bincount(vertex)
    start = np.cumsum(count) - count
    repeat = np.where(count[vertex] > _MOST_FACES, 0, count[vertex])
    one = np.repeat(np.arange(len(vertex)), repeat)
    within = np.arange(len(one)) - np.repeat(np.cumsum(repeat) - repeat, repeat)
    other = order[start[vertex[one]] + within]
    near = (units[one // 3] * units[other // 3]).sum(axis=1) >= _SHARP
    one, weights = one[near], areas[other[near] // 3]
    sums = [np.bincount(one, weights[:, axis], len(vertex)) for axis in range(3)]
    normals = np.stack(sums, axis=1)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    np.divide(normals, length, out=normals, where=length > 0)
    return np.where(length > 0, normals, np.repeat(units, 3, axis=0))

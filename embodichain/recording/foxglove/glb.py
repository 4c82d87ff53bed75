"""Meshes as binary glTF 2.0 (GLB): what `ModelPrimitive` embeds and browsers draw at once.

A mesh has one colour, which the primitive gives; so that a randomized colour needs no new mesh.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.shapes import Mesh

__all__ = ["MEDIA_TYPE", "glb"]

MEDIA_TYPE = "model/gltf-binary"

# glTF 2.0, sections 3.6 (accessors, buffer views) and 4 (GLB).
_MAGIC, _VERSION, _JSON, _BIN = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
_FLOAT, _UINT = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
_HALF = float(np.sqrt(0.5))
_SHARP = np.cos(np.radians(40))
"""Faces that meet at more than 40 degrees keep an edge; others are shaded as one surface."""
_MOST_FACES = 256


def glb(mesh: Mesh) -> bytes:
    """Encode a mesh: positions, normals and triangles.

    Args:
        mesh: Its triangles. Its z axis is up, glTF's is y: the node turns it, viewers turn it back.
    """
    positions, normals, faces = _shaded(mesh)
    buffers = [positions.astype("<f4"), normals.astype("<f4"), faces.astype("<u4")]
    views, offset = [], 0
    for buffer, target in zip(buffers, (_VERTICES, _VERTICES, _INDICES), strict=True):
        size = buffer.nbytes
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": size, "target": target})
        offset += size  # all are multiples of four
    points = buffers[0]
    document: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": [-_HALF, 0.0, 0.0, _HALF]}],
        "meshes": [
            {
                "primitives": [
                    {"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2, "material": 0}
                ]
            }
        ],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.7}}],
        "accessors": [
            {
                **{"bufferView": 0, "componentType": _FLOAT, "count": len(points), "type": "VEC3"},
                **{"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()},
            },
            {"bufferView": 1, "componentType": _FLOAT, "count": len(points), "type": "VEC3"},
            {"bufferView": 2, "componentType": _UINT, "count": faces.size, "type": "SCALAR"},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    content = b"".join(buffer.tobytes() for buffer in buffers)
    total = 12 + 8 + len(text) + 8 + len(content)
    head = struct.pack("<III", _MAGIC, _VERSION, total)
    return b"".join(
        [head, struct.pack("<II", len(text), _JSON), text,
         struct.pack("<II", len(content), _BIN), content]
    )  # fmt: skip


def _shaded(mesh: Mesh) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Vertices with normals, and faces of them: split where an edge is to be seen.

    A corner's normal is the mean, by area, of the faces at its vertex that are not turned far.
    """
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(areas, axis=1, keepdims=True)
    up = np.tile([0.0, 0.0, 1.0], (len(areas), 1))  # of triangles without area, which nobody sees
    units = np.divide(areas, length, out=up, where=length > 0)
    one, other = _meeting(mesh.faces)
    near = (units[one // 3] * units[other // 3]).sum(axis=1) >= _SHARP
    one, weights = one[near], areas[other[near] // 3]
    sums = [np.bincount(one, weights[:, axis], 3 * len(mesh.faces)) for axis in range(3)]
    normals = np.stack(sums, axis=1)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.repeat(units, 3, axis=0), where=length > 0)
    rows = np.concatenate([corners.reshape(-1, 3), normals], axis=1)
    found, index = np.unique(rows.astype(np.float32), axis=0, return_inverse=True)
    return found[:, :3], found[:, 3:], index.reshape(-1, 3)


def _meeting(faces: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """All pairs of corners (face x 3 + number) that have their vertex in common, with themselves.

    Where a vertex has very many faces there are too many pairs, and its faces stay flat.
    """
    vertex = faces.reshape(-1)
    corner = np.arange(len(vertex))
    order = np.argsort(vertex, kind="stable")
    count = np.bincount(vertex)
    start = np.cumsum(count) - count
    many = count[vertex] > _MOST_FACES
    repeat = np.where(many, 0, count[vertex])
    one = np.repeat(corner, repeat)
    within = np.arange(len(one)) - np.repeat(np.cumsum(repeat) - repeat, repeat)
    return one, order[start[vertex[one]] + within]

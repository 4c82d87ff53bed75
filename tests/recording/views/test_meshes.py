"""GLB read as its specification says: header, JSON chunk, binary chunk, accessors."""

import json
import struct

import numpy as np
import pytest

from embodichain.recording.views.shapes import Mesh, glb

CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 2) for z in (0, 3)], np.float32)
BOX = Mesh(
    CORNERS,
    np.array(
        [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
         (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)], np.int32
    ),
)  # fmt: skip


def ball(count=24):
    """A sphere of radius 1: rings of triangles."""
    u, v = np.meshgrid(np.linspace(0, np.pi, count), np.linspace(0, 2 * np.pi, count))
    points = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], -1)
    points, where = np.unique(points.reshape(-1, 3).round(6), axis=0, return_inverse=True)
    ids = where.reshape(count, count)
    a, b, c, d = ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]
    faces = np.concatenate([np.stack([a, c, b], -1), np.stack([a, d, c], -1)]).reshape(-1, 3)
    return Mesh(points.astype(np.float32), faces.astype(np.int32))


def read(data):
    """Document, positions, normals and triangles."""
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert (kind, size % 4) == (b"JSON", 0)
    document = json.loads(data[20 : 20 + size])
    start = 20 + size
    size, kind = struct.unpack_from("<I4s", data, start)
    assert (kind, size) == (b"BIN\0", document["buffers"][0]["byteLength"])
    content = data[start + 8 :]
    assert len(content) == size
    arrays = []
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        part = content[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        kind = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
        array = np.frombuffer(part, kind).reshape(accessor["count"], -1)
        assert array.shape[1] == {"VEC3": 3, "SCALAR": 1}[accessor["type"]]
        arrays.append(array)
    return document, arrays[0], arrays[1], arrays[2].reshape(-1, 3)


@pytest.mark.parametrize("mesh", [BOX, ball()], ids=["box", "ball"])
def test_triangles_are_the_meshs(mesh):
    document, points, normals, faces = read(glb(mesh))
    assert np.array_equal(points[faces], mesh.vertices[mesh.faces])  # order and winding too
    primitive = document["meshes"][0]["primitives"][0]
    assert primitive["attributes"] == {"POSITION": 0, "NORMAL": 1}
    assert primitive["indices"] == 2
    assert document["accessors"][0]["min"] == points.min(0).tolist()
    assert document["accessors"][0]["max"] == points.max(0).tolist()
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1, abs=1e-5)


def test_up_is_y_in_gltf():
    document, *_ = read(glb(BOX))
    x, y, z, w = document["nodes"][0]["rotation"]
    # The node turns our z axis (up) to glTF's y axis: the quaternion's third column.
    assert (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)) == pytest.approx(
        (0, 1, 0), abs=1e-12
    )


def test_edges_of_a_box_stay_sharp_and_a_ball_is_smooth():
    _, points, normals, faces = read(glb(BOX))
    assert len(points) == 24  # each corner three times
    a, b, c = points[faces].swapaxes(0, 1)
    flat = np.cross(b - a, c - a)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    assert np.allclose(normals[faces], flat[:, None], atol=1e-6)
    mesh = ball()
    mesh = Mesh(mesh.vertices, np.array([f for f in mesh.faces if len(set(f.tolist())) == 3]))
    _, points, normals, _ = read(glb(mesh))
    assert len(points) == len(mesh.vertices)
    assert (points * normals).sum(1).min() > 0.99  # outwards

"""The 3D scene of a recording for Rerun: a body's shapes below its path, its pose over time.

Bodies hang on their environment, each by its own pose, as in `/tf`.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.recording.api import Log
from embodichain.recording.export.formats import Part
from embodichain.recording.export.poses import poses
from embodichain.recording.export.rrd_stream import Stream, path_of
from embodichain.recording.views.meshes import corner_normals
from embodichain.recording.views.shapes import Shape, mesh_of, shapes

__all__ = ["Scene"]

_STEPS = 1000
"""Whose poses are sent together."""

Looks = dict[str, tuple[Any, ...]]
"""Path to the arrays that make up what is drawn there."""


class Scene:
    """One environment in 3D.

    Args:
        stream: Where it goes.
        log: The log.
        env_id: The environment.
        offset: (3,) its position in the world, metres.
    """

    def __init__(self, stream: Stream, log: Log, env_id: int, offset: NDArray[np.float64]) -> None:
        self._stream, self._log, self._env_id = stream, log, env_id
        self._root = f"/world/env_{env_id}"
        self._paths = _paths(log.model, self._root)
        self._drawn: Looks = {}
        self._last: NDArray[np.float64] | None = None
        stream.log(self._root, stream.rr.Transform3D(translation=offset), None)

    def send(self, part: Part) -> None:
        """Send the control steps of a part."""
        steps, rows = list[int](), list[NDArray[np.float64]]()
        for step, data, changed in poses(self._log, self._env_id, part):
            steps.append(step)
            rows.append(np.concatenate([data.xpos[1:], data.xquat[1:]], axis=1))
            if changed:
                self._draw(data.model, step)
            if len(steps) == _STEPS:
                self._move(steps, rows)
                steps, rows = [], []
        if steps:
            self._move(steps, rows)

    def _draw(self, model: mujoco.MjModel, step: int) -> None:
        """Draw what is new or looks other than before."""
        for path, look in _looks(model, self._paths).items():
            before = self._drawn.get(path)
            if before is None or not _same(before, look):
                self._drawn[path] = look
                self._stream.log(path, _archetype(self._stream.rr, path, look), step)

    def _move(self, numbers: list[int], rows: list[NDArray[np.float64]]) -> None:
        """Send (nbody - 1, 7) poses of some steps, each body's where it differs from before."""
        steps, poses = np.array(numbers, np.int64), np.array(rows)
        first = poses[:1] if self._last is None else self._last
        changed = np.any(np.diff(poses, axis=0, prepend=first) != 0, axis=2)
        changed[0] |= self._last is None
        self._last = poses[-1:]
        for body, path in enumerate(self._paths[1:]):
            there = changed[:, body]
            if there.any():
                here = poses[there, body]
                columns = self._stream.rr.Transform3D.columns(
                    translation=here[:, :3], quaternion=here[:, [4, 5, 6, 3]]
                )
                self._stream.columns(path, steps[there], columns)


def _paths(model: mujoco.MjModel, root: str) -> list[str]:
    """Paths of bodies by id. None lies below another: poses below each other are chained."""
    names = [model.body(i).name or f"body_{i}" for i in range(1, model.nbody)]
    paths = [path_of(root, name) for name in names]
    inner = {p for p in paths if any(other.startswith(f"{p}/") for other in paths)}
    return [f"{root}/world", *(f"{p}/body" if p in inner else p for p in paths)]


def _looks(model: mujoco.MjModel, paths: list[str]) -> Looks:
    """What is drawn: one batch for each body and kind of primitive, each mesh by itself."""
    groups: dict[tuple[int, str], list[Shape]] = {}
    for shape in shapes(model):
        name = f"mesh_{shape.geom}" if shape.kind == "mesh" else shape.kind
        groups.setdefault((shape.body, name), []).append(shape)
    return {
        f"{paths[body]}/{name}": _mesh(model, group[0])
        if group[0].kind == "mesh"
        else _primitives(group)
        for (body, name), group in groups.items()
    }


def _primitives(group: list[Shape]) -> tuple[Any, ...]:
    pos, quat, half, rgba = (
        np.array([getattr(shape, name) for shape in group])
        for name in ("pos", "quat", "half", "rgba")
    )
    if group[0].kind == "capsule":  # Rerun's begin at the centre of one cap
        pos -= [_rotated(q, np.array([0.0, 0.0, h])) for q, h in zip(quat, half[:, 2], strict=True)]
    return pos, quat[:, [1, 2, 3, 0]], half, _packed(rgba)


def _mesh(model: mujoco.MjModel, shape: Shape) -> tuple[Any, ...]:
    """Vertices, faces and normals in the body's frame, and the colour; corners are not shared."""
    mesh = mesh_of(model, shape.geom)
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, shape.quat)
    matrix = turn.reshape(3, 3).T
    vertices = mesh.vertices[mesh.faces].reshape(-1, 3) @ matrix + shape.pos
    normals = corner_normals(mesh) @ matrix
    faces = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
    return vertices.astype(np.float32), faces, normals.astype(np.float32), _packed(shape.rgba)


def _archetype(rr: Any, path: str, look: tuple[Any, ...]) -> Any:
    kind = path.rpartition("/")[2]
    if kind.startswith("mesh_"):
        vertices, faces, normals, rgba = look
        return rr.Mesh3D(
            vertex_positions=vertices,
            triangle_indices=faces,
            vertex_normals=normals,
            albedo_factor=int(rgba),
        )
    pos, quat, half, rgba = look
    common = {"quaternions": quat, "colors": rgba, "fill_mode": "solid"}
    if kind == "box":
        return rr.Boxes3D(half_sizes=half, centers=pos, **common)
    if kind == "ellipsoid":
        return rr.Ellipsoids3D(half_sizes=half, centers=pos, **common)
    lengths, radii = 2 * half[:, 2], half[:, 0]
    if kind == "cylinder":
        return rr.Cylinders3D(lengths=lengths, radii=radii, centers=pos, **common)
    return rr.Capsules3D(lengths=lengths, radii=radii, translations=pos, **common)


def _rotated(quat: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
    out = np.empty(3)
    mujoco.mju_rotVecQuat(out, vector, quat)
    return out


def _packed(rgba: NDArray[np.float64]) -> NDArray[np.uint32]:
    """(..., 4) in 0 to 1 as 0xRRGGBBAA: four numbers could be four colours."""
    levels = np.clip(np.rint(255 * rgba), 0, 255).astype(np.uint32)
    packed: NDArray[np.uint32] = np.bitwise_or.reduce(
        levels << np.array([24, 16, 8, 0], np.uint32), axis=-1
    )
    return packed


def _same(a: tuple[Any, ...], b: tuple[Any, ...]) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))

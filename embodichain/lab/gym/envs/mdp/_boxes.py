"""`Boxes`: oriented boxes around what collides, and whether they overlap.

Boxes are those of geoms, or of all geoms of a body. Sums are added up term by term: the rounding of
a numpy reduction may depend on the number of environments.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.utils.math import quat_to_matrix, rotate, rotate_back

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.sim.engine.api import Engine
    from embodichain.utils.array_types import EnvIds, Floats

__all__ = ["Boxes", "box_around", "boxes_of_geoms", "has_solid", "solid_geoms"]

# MuJoCo's types of geoms; MuJoCo itself is not imported for tables of terms.
_PLANE, _HFIELD, _SPHERE, _CAPSULE, _ELLIPSOID, _CYLINDER, _BOX = range(7)
TOUCHING = 1e-6
"""Metres: boxes that overlap by less only touch."""
_PARALLEL = 1e-9
"""Added to cosines of edges: the cross product of parallel ones is no axis to separate by."""


@dataclass(frozen=True)
class Boxes:
    """Oriented boxes, of any leading shape.

    Attributes:
        middle: (..., 3) metres.
        axes: (..., 3, 3) rotation matrices: their columns are the directions of the edges.
        half: (..., 3) half edge lengths, metres.
    """

    middle: Floats
    axes: Floats
    half: Floats

    def moved(self, pos: Floats, axes: Floats) -> Boxes:
        """Return boxes in the frame of a body as boxes in the frame where the body is.

        Args:
            pos: (..., 3) position of the body, m.
            axes: (..., 3, 3) its rotation matrix.
        """
        columns = [rotate(axes, self.axes[..., k]) for k in range(3)]
        shape = columns[0].shape
        return Boxes(
            middle=pos + rotate(axes, self.middle),
            axes=np.stack(columns, axis=-1),
            half=np.broadcast_to(self.half, shape),
        )

    def widened(self, margin: float) -> Boxes:
        """Return boxes that are larger by a margin on each side, m, but not up- or downwards."""
        upwards = self.axes[..., 2, :]
        sideways = np.sqrt(np.maximum(0.0, 1.0 - upwards * upwards))
        return Boxes(self.middle, self.axes, self.half + margin * sideways)

    def rows(self, rows: Any) -> Boxes:
        """Return the boxes of some rows."""
        return Boxes(self.middle[rows], self.axes[rows], self.half[rows])

    def reach(self, direction: Floats) -> Floats:
        """How far boxes (n,) extend from their middles along unit vectors (n or 1, 3): (n,) m."""
        along = np.abs(rotate_back(self.axes, direction))
        return _sum3(along * self.half)

    def overlap(self, others: Boxes) -> NDArray[np.bool_]:
        """Whether each box (n,) overlaps each of its others (n, K): (n, K).

        Two boxes are apart if a direction separates them: one of their edges, or perpendicular to
        an edge of each (S. Gottschalk et al., "OBBTree", SIGGRAPH 1996).
        """
        axes = self.axes[:, None]
        half = self.half[:, None]
        other_half = others.half
        # In the axes of `self`, (n, K, 3), and cosines between its edges and theirs, (n, K, 3, 3).
        offset = rotate_back(axes, others.middle - self.middle[:, None])
        cosines = [rotate_back(axes, others.axes[..., j]) for j in range(3)]
        cosine = np.stack(cosines, axis=-1)
        size = np.abs(cosine) + _PARALLEL

        is_apart = np.zeros(offset.shape[:-1], np.bool_)
        for i in range(3):
            room = half[..., i] + _sum3(other_half * size[..., i, :])
            is_apart |= np.abs(offset[..., i]) > room - TOUCHING
        for j in range(3):
            distance = np.abs(_sum3(offset * cosine[..., :, j]))
            room = other_half[..., j] + _sum3(half * size[..., :, j])
            is_apart |= distance > room - TOUCHING
        for i in range(3):
            i1 = (i + 1) % 3
            i2 = (i + 2) % 3
            for j in range(3):
                j1 = (j + 1) % 3
                j2 = (j + 2) % 3
                distance = offset[..., i2] * cosine[..., i1, j]
                distance = np.abs(distance - offset[..., i1] * cosine[..., i2, j])
                room = half[..., i1] * size[..., i2, j] + half[..., i2] * size[..., i1, j]
                room += other_half[..., j1] * size[..., i, j2]
                room += other_half[..., j2] * size[..., i, j1]
                is_apart |= distance > room
        return ~is_apart


def _sum3(values: Floats) -> Floats:
    return values[..., 0] + values[..., 1] + values[..., 2]


def solid_geoms(engine: Engine, body: int) -> NDArray[np.int64]:
    """Geoms of a body that collide in any environment and have an end; else all that have one."""
    model = engine.model
    has_end = ~np.isin(model.geom_type, (_PLANE, _HFIELD))
    geoms = np.flatnonzero((model.geom_bodyid == body) & has_end)
    colliding_geoms = geoms[_collides(engine, geoms).any(axis=0)]
    return colliding_geoms if len(colliding_geoms) else geoms


def has_solid(engine: Engine, body: int) -> bool:
    """Whether a geom of a body collides in any environment, planes and height fields aside."""
    return bool(_collides(engine, solid_geoms(engine, body)).any())


def _collides(engine: Engine, geoms: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(N or 1, G) whether geoms collide."""
    contype = engine.model_values("geom_contype")[:, geoms]
    conaffinity = engine.model_values("geom_conaffinity")[:, geoms]
    result: NDArray[np.bool_] = (contype | conaffinity).astype(np.bool_)
    return result


def boxes_of_geoms(engine: Engine, geoms: NDArray[np.int64], ids: EnvIds) -> Boxes:
    """The box of each geom in the frame of its body, (n, G)."""
    aabb = _rows(engine, "geom_aabb", geoms, ids)
    pos = _rows(engine, "geom_pos", geoms, ids)
    quat = _rows(engine, "geom_quat", geoms, ids)
    half = aabb[..., 3:].copy()
    size = _rows(engine, "geom_size", geoms, ids)
    for column, geom in enumerate(geoms.tolist()):
        own = _half_of_primitive(int(engine.model.geom_type[geom]), size[:, column])
        if own is not None:  # its size may differ between environments
            half[:, column] = own
    axes = quat_to_matrix(quat)
    return Boxes(pos + rotate(axes, aabb[..., :3]), axes, half)


def _rows(engine: Engine, field: str, geoms: NDArray[np.int64], ids: EnvIds) -> Floats:
    """(n, G, ...) values of a model field."""
    values = engine.model_values(field)[:, geoms]
    if len(values) == 1:
        return np.repeat(values, len(ids), axis=0)
    return values[ids]


def _half_of_primitive(kind: int, size: Floats) -> Floats | None:
    """(n, 3) half edges of the box around a primitive geom; None for meshes."""
    if kind in (_BOX, _ELLIPSOID):
        return size
    if kind == _SPHERE:
        return size[:, [0, 0, 0]]
    if kind == _CYLINDER:
        return size[:, [0, 0, 1]]
    if kind == _CAPSULE:
        half = size[:, [0, 0, 1]]
        half[:, 2] += size[:, 0]
        return half
    return None


def box_around(engine: Engine, geoms: NDArray[np.int64], ids: EnvIds) -> Boxes:
    """The box around geoms of one body, along the body's axes, (n,).

    Those that collide in an environment count there; where none does, all of them.
    """
    boxes = boxes_of_geoms(engine, geoms, ids)
    sides = np.abs(boxes.axes) * boxes.half[..., None, :]
    extent = _sum3(sides)
    counts: NDArray[np.bool_] = _collides(engine, geoms)
    counts = np.repeat(counts, len(ids), axis=0) if len(counts) == 1 else counts[ids]
    counts |= counts.sum(axis=1, keepdims=True) == 0
    low = np.where(counts[..., None], boxes.middle - extent, np.inf).min(axis=1)
    high = np.where(counts[..., None], boxes.middle + extent, -np.inf).max(axis=1)
    axes = np.broadcast_to(np.eye(3), (len(ids), 3, 3))
    return Boxes(0.5 * (low + high), axes, 0.5 * (high - low))

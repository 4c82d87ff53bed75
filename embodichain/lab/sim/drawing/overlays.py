"""`Overlay`: spheres and arrows that pictures for people show, and that the model does not have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Arrows",
    "Overlay",
    "Part",
    "PartKind",
    "Spheres",
    "ViewerGeom",
    "add_geoms",
    "axes_along",
]

F64 = NDArray[np.float64]
PartKind = Literal["sphere", "cylinder", "cone"]

_HEAD_SHARE = 0.3
"""Length of an arrow's head over the arrow's."""
_HEAD_LENGTH = 0.08
"""Metres: the longest head."""
_HEAD_WIDTH = 2.2
"""Radius of an arrow's head over that of its shaft."""


@dataclass(frozen=True, eq=False)
class Part:
    """A convex shape in each of N environments.

    Attributes:
        kind: A sphere; a cylinder along z; or a cone whose tip is at +z.
        positions: (N, 3) metres, its middle.
        axes: (N, 3, 3) rotation matrices.
        sizes: (N, 3) metres: the radius thrice, or radius, radius and half length.
        colors: (N, 4) RGBA; it is not drawn where alpha is 0.
    """

    kind: PartKind
    positions: F64
    axes: F64
    sizes: F64
    colors: F64


@dataclass(frozen=True, eq=False)
class ViewerGeom:
    """A geom of MuJoCo's viewers that is not in the model.

    Attributes:
        kind: Of `mjtGeom`.
        size: (3,) metres, as in a model; of an arrow radius, radius and length.
        pos: (3,) metres; of an arrow, where it starts.
        axes: (3, 3) rotation matrix.
        color: (4,) RGBA.
    """

    kind: int
    size: F64
    pos: F64
    axes: F64
    color: F64

    def put_into(self, geom: mujoco.MjvGeom) -> None:
        """Make this of a geom."""
        mujoco.mjv_initGeom(
            geom,
            self.kind,
            np.asarray(self.size, np.float64),
            np.asarray(self.pos, np.float64),
            np.ascontiguousarray(self.axes, np.float64).reshape(-1),
            np.asarray(self.color, np.float32),
        )

    def made(self) -> mujoco.MjvGeom:
        """Return a new geom."""
        geom = mujoco.MjvGeom()
        self.put_into(geom)
        return geom


@dataclass(frozen=True, eq=False)
class Spheres:
    """A sphere in each of N environments.

    Attributes:
        positions: (N, 3) metres.
        radius: Metres.
        colors: (N, 4) RGBA; it is not drawn where alpha is 0.
    """

    positions: F64
    radius: float
    colors: F64

    def parts(self) -> list[Part]:
        """The convex shapes that it is made of."""
        count = len(self.positions)
        return [
            Part(
                kind="sphere",
                positions=self.positions,
                axes=np.broadcast_to(np.eye(3), (count, 3, 3)),
                sizes=np.full((count, 3), self.radius),
                colors=self.colors,
            )
        ]

    def viewer_geom(self, env: int) -> ViewerGeom:
        """The sphere of one environment."""
        return ViewerGeom(
            kind=int(mujoco.mjtGeom.mjGEOM_SPHERE),
            size=np.full(3, self.radius),
            pos=self.positions[env],
            axes=np.eye(3),
            color=self.colors[env],
        )


@dataclass(frozen=True, eq=False)
class Arrows:
    """An arrow in each of N environments.

    Attributes:
        starts: (N, 3) metres.
        vectors: (N, 3) metres, from the start to the tip.
        radius: Metres, of the shaft.
        colors: (N, 4) RGBA; it is not drawn where alpha is 0.
    """

    starts: F64
    vectors: F64
    radius: float
    colors: F64

    def parts(self) -> list[Part]:
        """The convex shapes that it is made of."""
        lengths = np.linalg.norm(self.vectors, axis=1)
        axes = axes_along(self.vectors)
        heads = np.minimum(_HEAD_SHARE * lengths, _HEAD_LENGTH)
        shafts = lengths - heads
        return [
            self._part("cylinder", axes, middle=0.5 * shafts, length=shafts, radius=self.radius),
            self._part(
                "cone",
                axes,
                middle=shafts + 0.5 * heads,
                length=heads,
                radius=_HEAD_WIDTH * self.radius,
            ),
        ]

    def _part(self, kind: PartKind, axes: F64, *, middle: F64, length: F64, radius: float) -> Part:
        sizes = np.full((len(length), 3), radius)
        sizes[:, 2] = np.maximum(0.5 * length, 1e-6)
        return Part(
            kind=kind,
            positions=self.starts + middle[:, None] * axes[:, :, 2],
            axes=axes,
            sizes=sizes,
            colors=self.colors,
        )

    def viewer_geom(self, env: int) -> ViewerGeom:
        """The arrow of one environment."""
        vector = self.vectors[env : env + 1]
        return ViewerGeom(
            kind=int(mujoco.mjtGeom.mjGEOM_ARROW),
            size=np.array([self.radius, self.radius, np.linalg.norm(vector)]),
            pos=self.starts[env],
            axes=axes_along(vector)[0],
            color=self.colors[env],
        )


@dataclass(frozen=True, eq=False)
class Overlay:
    """What is drawn beside the geoms of N environments.

    Attributes:
        shapes: The spheres and arrows.
    """

    shapes: Sequence[Spheres | Arrows] = ()

    def parts(self) -> list[Part]:
        """The convex shapes that all of it is made of."""
        return [part for shape in self.shapes for part in shape.parts()]

    def viewer_geoms(self, env: int) -> list[ViewerGeom]:
        """The shapes of one environment that are seen."""
        return [shape.viewer_geom(env) for shape in self.shapes if shape.colors[env, 3] > 0.0]


def add_geoms(scene: mujoco.MjvScene, geoms: Sequence[ViewerGeom]) -> None:
    """Add geoms to a scene, as many as it has room for."""
    for geom in geoms[: scene.maxgeom - scene.ngeom]:
        geom.put_into(scene.geoms[scene.ngeom])
        scene.ngeom += 1


def axes_along(vectors: F64) -> F64:
    """(N, 3, 3) rotation matrices whose z axes have the direction of (N, 3) vectors.

    Of a vector without a length it is some rotation.
    """
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    z = np.where(lengths > 1e-9, vectors / np.maximum(lengths, 1e-9), [0.0, 0.0, 1.0])
    beside = np.where(np.abs(z[:, :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    x = np.cross(beside, z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=2)

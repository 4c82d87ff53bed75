"""`RayRenderer`: depth and masks of pinhole cameras by MuJoCo's rays, without OpenGL."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol, runtime_checkable

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.geometry import VISIBLE_GROUPS
from embodichain.lab.sim.drawing.looks import opaque_geoms
from embodichain.lab.sim.drawing.views import DrawnState, Pictures, View
from embodichain.utils.errors import RenderError

__all__ = ["CastingState", "RayRenderer"]

_RAYS_AT_ONCE = 2**20
"""About 100 MB of origins, directions and hits."""


F64 = NDArray[np.float64]


class Hits(Protocol):
    """What R rays hit in n environments."""

    @property
    def distance(self) -> F64:
        """(n, R) in lengths of the ray's direction; -1 where nothing is hit."""

    @property
    def geom(self) -> NDArray[np.int32]:
        """(n, R) geom ids; -1 where nothing is hit."""


@runtime_checkable
class CastingState(Protocol):
    """Environments in which rays can be cast: an engine."""

    def cast_rays(
        self,
        origins: F64,
        directions: F64,
        geoms: NDArray[np.bool_],
        env_ids: NDArray[np.int64] | None = None,
        *,
        normal: bool = False,
    ) -> Hits:
        """See `Engine.cast_rays`."""


class RayRenderer:
    """Draws depth and masks with a ray through the middle of each pixel.

    Opaque geoms of visible groups are hit; meshes and round shapes are exact.
    It costs more than OpenGL, but for small images.

    Args:
        model: The compiled scene.
    """

    about = "rays of MuJoCo, depth and masks only"

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._visible: NDArray[np.bool_] = np.asarray(model.geom_group) < VISIBLE_GROUPS

    def draw(
        self, state: DrawnState, views: Sequence[View], envs: NDArray[np.int64] | None = None
    ) -> list[Pictures]:
        """Draw every view of n environments; see `Renderer`.

        Raises:
            RenderError: If a view has the output ``color``, or `state` is not an engine.
        """
        if any("color" in view.outputs for view in views):
            raise RenderError("colours need OpenGL, and rays draw here")
        if not isinstance(state, CastingState):
            raise RenderError("stored states need OpenGL, and rays draw here")
        if envs is None:
            envs = np.arange(state.num_envs)
        rows, places = np.unique(envs, return_inverse=True)  # rays are cast in sorted ones
        geoms = opaque_geoms(state, self._model) & self._visible
        pictures = [_draw(state, view, rows, geoms) for view in views]
        if np.array_equal(rows, envs):
            return pictures
        return [
            {name: values[places] for name, values in pictures_of_view.items()}
            for pictures_of_view in pictures
        ]

    def close(self) -> None:
        """No effect: it has no memory of its own."""


def _draw(
    state: CastingState, view: View, rows: NDArray[np.int64], geoms: NDArray[np.bool_]
) -> Pictures:
    """Draw a view of n environments, as many at once as memory allows.

    Args:
        state: The environments.
        view: The view.
        rows: (n,) which of them.
        geoms: (N or 1, ngeom) the geoms that are hit.
    """
    optics = view.optics
    pixels = optics.width * optics.height
    depth = np.empty((len(rows), pixels), np.float32)
    mask = np.empty((len(rows), pixels), np.int32)
    for part, part_geoms in _parts(rows, geoms, max(1, _RAYS_AT_ONCE // pixels)):
        eye, ray = _rays(view, rows[part])
        hits = state.cast_rays(eye + optics.near * ray, ray, part_geoms, rows[part])
        # Rays are 1 m long along the axis, so that distances in their lengths are depths.
        distance = hits.distance + optics.near
        is_hit = (hits.distance >= 0.0) & (distance <= optics.far)
        depth[part] = np.where(is_hit, distance, 0.0)
        mask[part] = np.where(is_hit, hits.geom, -1)
    size = (len(rows), optics.height, optics.width)
    pictures: Pictures = {"depth": depth.reshape(size), "mask": mask.reshape(size)}
    return {name: pictures[name] for name in view.outputs}


def _parts(
    rows: NDArray[np.int64], geoms: NDArray[np.bool_], most: int
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.bool_]]]:
    """Yield places in `rows`, at most so many at once, and (ngeom,) the geoms that are hit there.

    Rays are cast at the same geoms in all environments of a call.
    """
    kinds, kind_of = np.unique(geoms, axis=0, return_inverse=True)
    kind_of = np.broadcast_to(kind_of.reshape(-1), max(len(geoms), int(rows.max(initial=0)) + 1))
    for number, kind in enumerate(kinds):
        places = np.flatnonzero(kind_of[rows] == number)
        for start in range(0, len(places), most):
            yield places[start : start + most], kind


def _rays(view: View, rows: NDArray[np.int64]) -> tuple[F64, F64]:
    """(n, 1, 3) positions of the camera, and (n, H W, 3) rays of 1 m along its axis."""
    position = _of_rows(np.asarray(view.position), rows)
    axes = _of_rows(np.asarray(view.axes), rows).reshape(-1, 1, 1, 3, 3)
    lens = _of_rows(view.lens, rows)
    fx, fy, cx, cy = (lens[:, i, None] for i in range(4))
    right = ((np.arange(view.optics.width) + 0.5 - cx) / fx)[:, None, :, None]
    up = ((cy - np.arange(view.optics.height) - 0.5) / fy)[:, :, None, None]
    rays: F64 = right * axes[..., 0] + up * axes[..., 1] - axes[..., 2]
    return position[:, None], rays.reshape(len(rays), -1, 3)


def _of_rows(values: F64, rows: NDArray[np.int64]) -> F64:
    """Return the values of some environments; a single row is that of all."""
    if len(values) == 1:
        return values
    return values[rows]

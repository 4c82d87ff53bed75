"""Cameras as numbers for shaders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.views import Optics, View

__all__ = ["EYE_ROW", "VIEW_ROWS", "view_table"]

VIEW_ROWS = 9
"""Rows of four numbers for each view and environment; `shading_source` reads them by number."""
EYE_ROW = 4
"""The row with a view's eye, and with its environment's place among those that are drawn."""
_CORNER_ROW = 5
_WIDTH_ROW = 6
_HEIGHT_ROW = 7
_DEPTH_ROW = 8


def view_table(views: Sequence[View], rows: NDArray[np.int64]) -> NDArray[np.float32]:
    """(V, n, 9, 4) of each view and environment.

    Args:
        views: The cameras.
        rows: (n,) environments.

    Returns:
        Four rows of the view projection; eye and place among `rows`; the ray through the top left
        corner, and what the picture's width and height add to it, these three with the axis that
        points backwards at their end; 1 / far and 1 / near - 1 / far.
    """
    table = np.zeros((len(views), len(rows), VIEW_ROWS, 4), np.float32)
    for out, view in zip(table, views, strict=True):
        position = _of_rows(np.asarray(view.position, np.float64), rows)
        axes = _of_rows(np.asarray(view.axes, np.float64).reshape(-1, 3, 3), rows)
        lens = _of_rows(view.lens, rows)
        optics = view.optics
        rays = _rays(optics, lens, axes)

        out[:, :4] = _projection(optics, lens) @ _world_to_camera(position, axes)
        out[:, EYE_ROW, :3] = position
        out[:, EYE_ROW, 3] = np.arange(len(rows))
        out[:, _CORNER_ROW, :3] = rays.corner
        out[:, _WIDTH_ROW, :3] = rays.width
        out[:, _HEIGHT_ROW, :3] = rays.height
        out[:, _CORNER_ROW : _HEIGHT_ROW + 1, 3] = axes[..., 2]
        out[:, _DEPTH_ROW, 0] = 1.0 / optics.far
        out[:, _DEPTH_ROW, 1] = 1.0 / optics.near - 1.0 / optics.far
    return table


def _of_rows(values: NDArray[np.float64], rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the values of some environments; a single row is that of all."""
    if len(values) == 1:
        return values
    return values[rows]


def _world_to_camera(
    position: NDArray[np.float64], axes: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n, 4, 4) transforms from the world to cameras; n is 1 where all have the same pose."""
    rotation = np.swapaxes(axes, 1, 2)
    transform = np.zeros((max(len(axes), len(position)), 4, 4))
    transform[:, :3, :3] = rotation
    transform[:, :3, 3] = -(rotation * position[:, None]).sum(axis=2)
    transform[:, 3, 3] = 1.0
    return transform


def _projection(optics: Optics, lens: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 4, 4) projections, upside down, so that the first row read is the top.

    Depth is 1 at `near` and 0 at `far`.
    """
    near = optics.near
    far = optics.far
    size = np.array([optics.width, optics.height])
    focal = lens[:, :2]
    centre = lens[:, 2:]
    projection = np.zeros((len(lens), 4, 4))
    projection[:, (0, 1), (0, 1)] = 2.0 * focal / size * (1.0, -1.0)
    projection[:, :2, 2] = 1.0 - 2.0 * centre / size
    projection[:, 2, 2] = near / (far - near)
    projection[:, 2, 3] = far * near / (far - near)
    projection[:, 3, 2] = -1.0
    return projection


@dataclass(frozen=True)
class _Rays:
    """Rays through pixels in the world's axes, each (n, 3), one unit deep.

    Attributes:
        corner: The ray through the top left corner.
        width: What the whole width of the picture adds to it.
        height: What its whole height adds, downwards.
    """

    corner: NDArray[Any]
    width: NDArray[Any]
    height: NDArray[Any]


def _rays(optics: Optics, lens: NDArray[np.float64], axes: NDArray[Any]) -> _Rays:
    fx, fy, cx, cy = (lens[:, i : i + 1] for i in range(4))
    right = axes[..., 0]
    up = axes[..., 1]
    back = axes[..., 2]
    return _Rays(
        corner=-cx / fx * right + cy / fy * up - back,
        width=right * optics.width / fx,
        height=-up * optics.height / fy,
    )

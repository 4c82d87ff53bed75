"""Cameras as numbers for shaders."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.views import Optics, View

__all__ = ["view_table"]


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
    found = np.zeros((len(views), len(rows), 9, 4), np.float32)
    for out, view in zip(found, views, strict=True):
        position = np.asarray(view.position, np.float64)
        axes = np.asarray(view.axes, np.float64).reshape(-1, 3, 3)
        position, axes = (a if len(a) == 1 else a[rows] for a in (position, axes))
        lens = view.lens if len(view.lens) == 1 else view.lens[rows]
        turned = np.swapaxes(axes, 1, 2)  # world to camera
        world = np.zeros((max(len(axes), len(position)), 4, 4))
        world[:, :3, :3] = turned
        world[:, :3, 3] = -(turned * position[:, None]).sum(axis=2)
        world[:, 3, 3] = 1.0
        out[:, :4] = _projection(view.optics, lens) @ world
        out[:, 4, :3], out[:, 4, 3] = position, np.arange(len(rows))
        out[:, 5, :3], out[:, 6, :3], out[:, 7, :3] = _rays(view.optics, lens, axes)
        out[:, 5:8, 3] = axes[..., 2]
        near, far = view.optics.near, view.optics.far
        out[:, 8, :2] = 1.0 / far, 1.0 / near - 1.0 / far
    return found


def _projection(optics: Optics, lens: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 4, 4) projections, upside down, so that the first row read is the top.

    Depth is 1 at `near` and 0 at `far`.
    """
    near, far = optics.near, optics.far
    size = np.array([optics.width, optics.height])
    found = np.zeros((len(lens), 4, 4))
    found[:, (0, 1), (0, 1)] = 2.0 * lens[:, :2] / size * (1.0, -1.0)
    found[:, :2, 2] = 1.0 - 2.0 * lens[:, 2:] / size
    found[:, 2, 2], found[:, 2, 3] = near / (far - near), far * near / (far - near)
    found[:, 3, 2] = -1.0
    return found


def _rays(
    optics: Optics, lens: NDArray[np.float64], axes: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """(n, 3) each: the ray through the top left corner, and what one width and one height add."""
    fx, fy, cx, cy = (lens[:, i : i + 1] for i in range(4))
    right, up, back = axes[..., 0], axes[..., 1], axes[..., 2]
    corner = -cx / fx * right + cy / fy * up - back
    return corner, right * optics.width / fx, -up * optics.height / fy

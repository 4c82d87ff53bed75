"""Images that follow from depth and a pinhole lens: distances, positions, normals, disparities.

Arrays are float32; N is the number of environments, H and W are the rows and columns of an image.
Depth is along the camera's axis, and 0 where nothing is drawn.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["disparities", "distances", "normals", "positions", "slopes"]

F32 = NDArray[np.float32]


def slopes(lens: NDArray[np.float64], width: int, height: int) -> tuple[F32, F32]:
    """How far a pixel's ray goes to the right and up for each metre along the axis.

    Args:
        lens: (N or 1, 4) fx, fy, cx, cy in pixels.
        width: Pixels.
        height: Pixels.

    Returns:
        (N or 1, 1, W) to the right, (N or 1, H, 1) up, through the middles of pixels.
    """
    fx, fy, cx, cy = (lens[:, i, None] for i in range(4))
    right = (np.arange(width) + 0.5 - cx) / fx
    up = (cy - np.arange(height) - 0.5) / fy
    return right.astype(np.float32)[:, None, :], up.astype(np.float32)[:, :, None]


def distances(depth: F32, right: F32, up: F32) -> F32:
    """(N, H, W) distances along the ray, m; 0 where nothing is drawn."""
    return depth * np.sqrt(np.float32(1.0) + right * right + up * up)


def positions(
    depth: F32, right: F32, up: F32, eye: NDArray[np.float64], axes: NDArray[np.float64]
) -> F32:
    """(N, H, W, 3) points in the environment's frame, m; 0 where nothing is drawn.

    Args:
        depth: (N, H, W).
        right: As of `slopes`.
        up: As of `slopes`.
        eye: (N or 1, 3) position of the camera.
        axes: (N or 1, 3, 3) its axes: right, up and backwards are columns.
    """
    x, y, z = np.moveaxis(axes.astype(np.float32)[:, None, None], -1, 0)
    ray = right[..., None] * x + up[..., None] * y - z
    points = depth[..., None] * ray + eye.astype(np.float32)[:, None, None]
    return np.where((depth > 0)[..., None], points, np.float32(0.0))


def normals(depth: F32, points: F32, eye: NDArray[np.float64]) -> F32:
    """(N, H, W, 3) unit normals of surfaces, towards the camera; 0 where nothing is drawn.

    They are cross products of differences between neighbouring points. Of the two neighbours along
    a row or a column, the one whose depth is closer counts, so that edges remain sharp.

    Args:
        depth: (N, H, W).
        points: (N, H, W, 3), of `positions`.
        eye: (N or 1, 3) position of the camera.
    """
    across = _step(depth, points, axis=2)
    down = _step(depth, points, axis=1)
    normal = np.stack(
        [
            across[..., i] * down[..., j] - across[..., j] * down[..., i]
            for i, j in ((1, 2), (2, 0), (0, 1))
        ],
        axis=-1,
    )
    length = np.sqrt((normal * normal).sum(axis=-1, keepdims=True))
    to_eye = eye.astype(np.float32)[:, None, None] - points
    points_away = (normal * to_eye).sum(axis=-1, keepdims=True) < 0
    unit = normal / np.where(length > 0, length, np.float32(1.0))
    unit = np.where(points_away, -unit, unit)
    return np.where((depth > 0)[..., None], unit, np.float32(0.0))


def _step(depth: F32, points: F32, axis: int) -> F32:
    """Differences to the neighbour along an axis with the closer depth."""
    if depth.shape[axis] < 2:
        return np.zeros_like(points)

    def part(values: F32, start: int | None, stop: int | None) -> F32:
        return values[(*[slice(None)] * axis, slice(start, stop))]

    def to_previous(values: F32) -> F32:
        difference = part(values, 1, None) - part(values, None, -1)
        return np.concatenate([part(difference, None, 1), difference], axis=axis)

    def to_next(values: F32) -> F32:
        difference = part(values, 1, None) - part(values, None, -1)
        return np.concatenate([difference, part(difference, -1, None)], axis=axis)

    previous_is_closer = np.abs(to_previous(depth)) <= np.abs(to_next(depth))
    return np.where(previous_is_closer[..., None], to_previous(points), to_next(points))


def disparities(depth: F32, focal: NDArray[np.float64], baseline: float) -> F32:
    """(N, H, W) pixels between the places of a point in two parallel cameras: fx b / depth.

    Args:
        depth: (N, H, W) of the left camera; the disparity is 0 where it is 0.
        focal: (N or 1,) fx in pixels.
        baseline: Metres between the cameras.
    """
    scale = (focal * baseline).astype(np.float32)[:, None, None]
    return np.where(depth > 0, scale / np.where(depth > 0, depth, np.float32(1.0)), np.float32(0))

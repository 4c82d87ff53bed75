"""`pattern_rays`: where rays of a pattern start and point, in a sensor's frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from embodichain.lab.sim.configs.sensor_cfg import RayFanCfg, RayGridCfg, RayPatternCfg
    from embodichain.utils.array_types import Floats

__all__ = ["pattern_rays"]


def pattern_rays(cfg: RayPatternCfg) -> tuple[Floats, Floats]:
    """Return starts (R, 3) in metres and unit directions (R, 3) of a checked pattern.

    A grid is in rows along x, the first at the lowest y; a fan is in rows of ascending azimuth, the
    first at the lowest elevation.
    """
    if cfg.grid is not None:
        starts = _grid(cfg.grid)
        directions = np.broadcast_to(np.asarray(cfg.grid.direction, np.float64), starts.shape)
    else:
        directions = np.asarray(cfg.directions, np.float64) if cfg.fan is None else _fan(cfg.fan)
        starts = np.zeros_like(directions)
    return starts, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _grid(cfg: RayGridCfg) -> Floats:
    """(R, 3) points; a length that is no multiple of the resolution is shortened to one."""
    # The tolerance is for quotients such as 1.6 / 0.1, which are a little below an integer.
    cells = [math.floor(length / cfg.resolution + 1e-6) for length in cfg.size]
    x, y = (cfg.resolution * (np.arange(n + 1) - n / 2.0) for n in cells)
    across, along = np.meshgrid(x, y)
    return np.stack([across.ravel(), along.ravel(), np.zeros(across.size)], axis=1)


def _fan(cfg: RayFanCfg) -> Floats:
    """(R, 3) unit vectors."""
    full_turn = cfg.horizontal_range[1] - cfg.horizontal_range[0] > 2 * math.pi - 1e-6
    azimuth = _spread(cfg.horizontal_range, cfg.horizontal_count, not full_turn)
    elevation = _spread(cfg.vertical_range, cfg.vertical_count, True)
    across, up = (angles.ravel() for angles in np.meshgrid(azimuth, elevation))
    flat = np.cos(up)
    return np.stack([flat * np.cos(across), flat * np.sin(across), np.sin(up)], axis=1)


def _spread(bounds: Sequence[float], count: int, endpoint: bool) -> Floats:
    """(count,) even angles; a single one is in the middle."""
    if count == 1:
        return np.array([0.5 * (bounds[0] + bounds[1])])
    return np.linspace(bounds[0], bounds[1], count, endpoint=endpoint)

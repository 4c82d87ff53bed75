"""Patterns of rays: their configs, and `pattern_rays`, where rays start and point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from embodichain.lab.sim.configs.scene_cfg import Vec3
from embodichain.utils.configclass import configclass
from embodichain.utils.errors import Problem
from embodichain.utils.fields.value_checks import are_finite, is_positive, require

if TYPE_CHECKING:
    from embodichain.utils.array_types import Floats

__all__ = ["RayFanCfg", "RayGridCfg", "RayPatternCfg", "pattern_rays"]

_Pair = Annotated[
    Sequence[float],
    Field(min_length=2, max_length=2),
    require("must be 2 finite numbers, got {}", are_finite),
]
_Range = Annotated[_Pair, require("must be [lowest, highest], got {}", lambda x: x[0] <= x[1])]
_Count = Annotated[int, Field(ge=1)]
_Direction = Annotated[Vec3, require("must not be zero: it is a direction", any)]
_MOST_RAYS = 100_000


@configclass
class RayGridCfg:
    """Parallel rays that start on a grid in the x-y plane, centred on the origin."""

    size: Annotated[_Pair, require("must not be negative, got {}", lambda x: min(x) >= 0)]
    """Lengths along x and y, metres."""
    resolution: Annotated[float, require("must be positive, metres, got {}", is_positive)]
    """Distance between neighbours, metres."""
    direction: _Direction = (0.0, 0.0, -1.0)

    def count(self) -> float:
        """Return how many points it has, at most."""
        across, along = (length / self.resolution + 1 for length in self.size)
        return across * along


@configclass
class RayFanCfg:
    """Rays from the origin at even angles: of a planar or rotating range finder."""

    horizontal_range: _Range = (-math.pi, math.pi)
    """Lowest and highest azimuth, rad from x towards y. A full turn has no ray twice."""
    horizontal_count: _Count = 36
    vertical_range: _Range = (0.0, 0.0)
    """Lowest and highest elevation, rad from the x-y plane towards z."""
    vertical_count: _Count = 1


@configclass
class RayPatternCfg:
    """Rays in a sensor's frame; exactly one of the keys."""

    grid: RayGridCfg | None = None
    fan: RayFanCfg | None = None
    directions: list[_Direction] | None = None
    """Of rays from the origin; any length but zero."""

    def check(self) -> list[Problem]:
        """Return a mistake unless it has one of its keys, with rays, and not too many."""
        named = [name for name, value in vars(self).items() if value is not None]
        if len(named) != 1:
            message = f"give one of {', '.join(vars(self))}; got {', '.join(named) or 'none'}"
            return [Problem("pattern", message)]
        if self.grid is not None:
            return _check_count(self.grid.count())
        if self.fan is not None:
            return _check_count(self.fan.horizontal_count * self.fan.vertical_count)
        if not self.directions:
            return [Problem("pattern.directions", "names no ray")]
        return _check_count(len(self.directions))


def _check_count(rays: float) -> list[Problem]:
    if rays <= _MOST_RAYS:
        return []
    return [Problem("pattern", f"has {rays:.0f} rays; a sensor can have {_MOST_RAYS}")]


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
    """(R, 3) points; a length that is not a multiple of the resolution is shortened to one."""
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

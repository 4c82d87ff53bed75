"""Patterns of rays: their configs, and `pattern_rays`, where rays start and point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from embodichain.lab.sim.configs.scene_cfg import Vec3
from embodichain.lab.sim.configs.sensor_checks import check_direction, check_numbers
from embodichain.utils.configclass import configclass
from embodichain.utils.errors import Problem

if TYPE_CHECKING:
    from embodichain.utils.array_types import Floats

__all__ = ["RayFanCfg", "RayGridCfg", "RayPatternCfg", "pattern_rays"]

_Pair = Annotated[Sequence[float], Field(min_length=2, max_length=2)]
_MOST_RAYS = 100_000


@configclass
class RayGridCfg:
    """Parallel rays that start on a grid in the x-y plane, centred on the origin."""

    size: _Pair
    """Lengths along x and y, metres."""
    resolution: float
    """Distance between neighbours, metres."""
    direction: Vec3 = (0.0, 0.0, -1.0)

    def check(self) -> list[Problem]:
        """Return the mistakes in its values, with paths below it."""
        problems = check_numbers("size", self.size, 2)
        problems += check_direction("direction", self.direction)
        if not problems and min(self.size) < 0:
            problems.append(Problem("size", f"must not be negative, got {list(self.size)}"))
        if not 0 < self.resolution < math.inf:
            message = f"must be positive, metres, got {self.resolution!r}"
            problems.append(Problem("resolution", message))
        return problems

    def count(self) -> float:
        """Return how many points it has, at most."""
        across, along = (length / self.resolution + 1 for length in self.size)
        return across * along


@configclass
class RayFanCfg:
    """Rays from the origin at even angles: of a planar or rotating range finder."""

    horizontal_range: _Pair = (-math.pi, math.pi)
    """Lowest and highest azimuth, rad from x towards y. A full turn has no ray twice."""
    horizontal_count: int = 36
    vertical_range: _Pair = (0.0, 0.0)
    """Lowest and highest elevation, rad from the x-y plane towards z."""
    vertical_count: int = 1

    def check(self) -> list[Problem]:
        """Return the mistakes in its values, with paths below it."""
        problems: list[Problem] = []
        for axis in ("horizontal", "vertical"):
            key = f"{axis}_range"
            count = getattr(self, f"{axis}_count")
            bounds = getattr(self, key)
            mistakes = check_numbers(key, bounds, 2)
            if not mistakes and bounds[0] > bounds[1]:
                mistakes = [Problem(key, f"must be [lowest, highest], got {list(bounds)}")]
            if not count >= 1:
                mistakes.append(Problem(f"{axis}_count", f"must be at least 1, got {count!r}"))
            problems += mistakes
        return problems


@configclass
class RayPatternCfg:
    """Rays in a sensor's frame; exactly one of the keys."""

    grid: RayGridCfg | None = None
    fan: RayFanCfg | None = None
    directions: list[Vec3] | None = None
    """Of rays from the origin; any length but zero."""

    def check(self) -> list[Problem]:
        """Return the mistakes in its values, with paths that begin with ``pattern``."""
        named = [name for name, value in vars(self).items() if value is not None]
        if len(named) != 1:
            message = f"give one of {', '.join(vars(self))}; got {', '.join(named) or 'none'}"
            return [Problem("pattern", message)]
        if self.grid is not None:
            problems = [p.below("pattern.grid") for p in self.grid.check()]
            return problems or _check_count(self.grid.count())
        if self.fan is not None:
            problems = [p.below("pattern.fan") for p in self.fan.check()]
            return problems or _check_count(self.fan.horizontal_count * self.fan.vertical_count)
        directions = self.directions or []
        if not directions:
            return [Problem("pattern.directions", "names no ray")]
        problems = []
        for i, value in enumerate(directions):
            problems += check_direction(f"pattern.directions.{i}", value)
        return problems or _check_count(len(directions))


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

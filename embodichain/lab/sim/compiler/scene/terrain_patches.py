"""`patch_heights`: the heights of one patch of a terrain.

A patch is a function of its config, a difficulty in [0, 1], places and random numbers. Its middle
is flat, so that an episode starts on level ground whatever the kind is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.configs.scene_cfg import (
    BlocksPatchCfg,
    FlatPatchCfg,
    GapsPatchCfg,
    PatchCfg,
    RoughPatchCfg,
    SlopePatchCfg,
    StairsPatchCfg,
    StonesPatchCfg,
    WavesPatchCfg,
)
from embodichain.utils.random import stream_keys

__all__ = ["PatchGrid", "patch_heights"]

_UNIT = 2.0**-53
_MILLIMETRES = 1000.0
"""Heights are rounded to millimetres: sines of two mathematics libraries then give one terrain."""


@dataclass(frozen=True, slots=True)
class PatchGrid:
    """The nodes of a patch, and where its middle ends.

    Attributes:
        count: Nodes along an edge.
        resolution: Metres between two nodes.
        platform: Metres: edge of the flat square in the middle.
    """

    count: int
    resolution: float
    platform: float

    @property
    def half(self) -> float:
        """Metres: half an edge."""
        return 0.5 * self.count * self.resolution

    @property
    def axis(self) -> F64:
        """(count,) m: coordinates of the nodes from the middle, the same along x and y."""
        return (np.arange(self.count, dtype=np.float64) - 0.5 * (self.count - 1)) * self.resolution

    @property
    def radius(self) -> F64:
        """(count, count) m: half the edge of the square around the middle through each node."""
        axis = np.abs(self.axis)
        return np.maximum(axis[:, None], axis[None, :])

    @property
    def outside(self) -> F64:
        """(count, count) m: distance of each node from the platform, 0 on it."""
        return np.maximum(self.radius - 0.5 * self.platform, 0.0)


class _Numbers:
    """Random numbers of one patch, which depend on the seed, its name and its level only."""

    def __init__(self, seed: int, name: str) -> None:
        self._seed = seed
        self._name = name

    def __call__(self, rows: int, columns: int) -> F64:
        """(rows, columns) uniform in [0, 1)."""
        keys = stream_keys(self._seed, self._name, np.arange(rows * columns, dtype=np.uint64))
        numbers = (keys >> np.uint64(11)).astype(np.float64) * _UNIT
        return numbers.reshape(rows, columns)


def patch_heights(
    cfg: PatchCfg, grid: PatchGrid, difficulty: float, seed: int, name: str
) -> tuple[F64, float]:
    """Return the heights of a patch, (count, count) m with y along the rows, and its middle's.

    Args:
        cfg: The patch.
        grid: Its nodes.
        difficulty: 0 at the lowest level, 1 at the highest.
        seed: Of the terrain.
        name: Of the patch's random numbers: no two patches of a terrain have the same.
    """
    heights = _KINDS[type(cfg)](cfg, grid, difficulty, _Numbers(seed, name))
    rounded: F64 = np.round(heights * _MILLIMETRES) / _MILLIMETRES
    middle = grid.count // 2
    return rounded, float(rounded[middle, middle])


def _at(ends: Sequence[float], difficulty: float) -> float:
    return float(ends[0] + (ends[1] - ends[0]) * difficulty)


def _sign(direction: str) -> float:
    """A patch that rises to its edge, at height 0, is below 0 in its middle."""
    return -1.0 if direction == "up" else 1.0


def _flat(cfg: FlatPatchCfg, grid: PatchGrid, difficulty: float, numbers: _Numbers) -> F64:
    return np.zeros((grid.count, grid.count))


def _rough(cfg: RoughPatchCfg, grid: PatchGrid, difficulty: float, numbers: _Numbers) -> F64:
    limit = _at(cfg.height, difficulty)
    spacing = cfg.spacing
    place = (grid.axis + grid.half) / spacing
    first = np.floor(place).astype(np.int64)
    count = int(first[-1]) + 2
    knots = (2.0 * numbers(count, count) - 1.0) * limit
    share = place - first
    rows = knots[first] + share[:, None] * (knots[first + 1] - knots[first])
    mixed: F64 = rows[:, first] + share * (rows[:, first + 1] - rows[:, first])
    return mixed * np.minimum(grid.outside / spacing, 1.0)


def _slope(cfg: SlopePatchCfg, grid: PatchGrid, difficulty: float, numbers: _Numbers) -> F64:
    run = np.minimum(grid.half - grid.radius, grid.half - 0.5 * grid.platform)
    return _sign(cfg.direction) * _at(cfg.slope, difficulty) * run


def _stairs(cfg: StairsPatchCfg, grid: PatchGrid, difficulty: float, numbers: _Numbers) -> F64:
    most = np.floor((grid.half - 0.5 * grid.platform) / cfg.step_depth)
    steps = np.minimum(np.floor((grid.half - grid.radius) / cfg.step_depth), most)
    return _sign(cfg.direction) * _at(cfg.step_height, difficulty) * steps


def _waves(cfg: WavesPatchCfg, grid: PatchGrid, difficulty: float, numbers: _Numbers) -> F64:
    length = 2.0 * grid.half / cfg.count
    wave = np.sin(2.0 * np.pi * (grid.axis + grid.half) / length)
    fade = np.minimum(grid.outside / (0.25 * length), 1.0)
    return _at(cfg.height, difficulty) * wave[:, None] * wave[None, :] * fade


def _squares(grid: PatchGrid, pitch: float) -> tuple[NDArray[np.int64], F64]:
    """(count,) the square of a lattice in which each node is, and (count,) m from its lower edge.

    A square is in the middle of the patch.
    """
    offset = np.ceil(grid.half / pitch) + 0.5
    place = grid.axis + offset * pitch
    number = np.floor(place / pitch).astype(np.int64)
    return number, place - number * pitch


def _blocks(cfg: BlocksPatchCfg, grid: PatchGrid, difficulty: float, numbers: _Numbers) -> F64:
    number, _ = _squares(grid, cfg.size)
    count = int(number[-1]) + 1
    heights = _at(cfg.height, difficulty) * numbers(count, count)[np.ix_(number, number)]
    return np.where(grid.outside > 0.0, heights, 0.0)


def _stones(cfg: StonesPatchCfg, grid: PatchGrid, difficulty: float, numbers: _Numbers) -> F64:
    size = _at(cfg.size, difficulty)
    gap = _at(cfg.gap, difficulty)
    number, place = _squares(grid, size + gap)
    count = int(number[-1]) + 1
    tops = (2.0 * numbers(count, count) - 1.0) * _at(cfg.height, difficulty)
    is_on_stone = (place >= 0.5 * gap) & (place < 0.5 * gap + size)
    is_top = is_on_stone[:, None] & is_on_stone[None, :]
    heights = np.where(is_top, tops[np.ix_(number, number)], -cfg.depth)
    return np.where(grid.outside > 0.0, heights, 0.0)


def _gaps(cfg: GapsPatchCfg, grid: PatchGrid, difficulty: float, numbers: _Numbers) -> F64:
    width = _at(cfg.width, difficulty)
    place = np.mod(grid.outside, width + cfg.land)
    return np.where((grid.outside > 0.0) & (place < width), -cfg.depth, 0.0)


_KINDS: dict[type[PatchCfg], Callable[..., F64]] = {
    FlatPatchCfg: _flat,
    RoughPatchCfg: _rough,
    SlopePatchCfg: _slope,
    StairsPatchCfg: _stairs,
    WavesPatchCfg: _waves,
    BlocksPatchCfg: _blocks,
    StonesPatchCfg: _stones,
    GapsPatchCfg: _gaps,
}

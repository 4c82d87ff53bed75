"""`GroundHeights`: the ground of a terrain below points, read from its height field.

That is exact, since physics collides with the same two triangles of every cell, and cheaper than
rays by a factor of about 10.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.names import GROUND
from embodichain.utils.arrays import is_host
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.sim.engine.api import Engine, EnvIndex
    from embodichain.utils.array_types import Floats

__all__ = ["GroundHeights"]

_KNOWN: WeakKeyDictionary[Engine, GroundHeights] = WeakKeyDictionary()


class GroundHeights:
    """Heights of a terrain in N environments.

    Args:
        engine: The engine of a scene with a terrain, with arrays on the host.

    Attributes:
        columns: Columns of ``mocap_pos`` with the position of the terrain.
    """

    def __init__(self, engine: Engine) -> None:
        model = engine.model
        geom = model.geom(GROUND)
        field = int(geom.dataid[0])
        start = int(model.hfield_adr[field])
        rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
        half_x, half_y, extent, _ = model.hfield_size[field].tolist()
        first = 3 * int(model.body_mocapid[geom.bodyid[0]])
        self.columns = slice(first, first + 3)
        self._positions = engine.state("mocap_pos")
        values = model.hfield_data[start : start + rows * columns].astype(np.float64)
        self._heights: Floats = values * extent + float(geom.pos[2])
        self._shape = rows, columns
        self._half = half_x, half_y
        self._scale = (columns - 1) / (2.0 * half_x), (rows - 1) / (2.0 * half_y)

    @classmethod
    def of(cls, engine: Engine) -> GroundHeights:
        """The heights of an engine's scene: one object for all that read them.

        Raises:
            ConfigError: If arrays are on a device.
        """
        found = _KNOWN.get(engine)
        if found is None:
            if not is_host(engine.state("mocap_pos")):
                raise ConfigError("heights of a terrain need arrays on the host: warp.arrays=host")
            found = _KNOWN[engine] = cls(engine)
        return found

    @classmethod
    def hit_alone(cls, engine: Engine, geoms: NDArray[np.bool_]) -> GroundHeights | None:
        """The heights, if the ground is a terrain and the only one of these geoms; else None.

        Args:
            engine: The engine.
            geoms: (ngeom,) mask of geoms.
        """
        model, chosen = engine.model, np.flatnonzero(geoms)
        if len(chosen) != 1 or model.geom(int(chosen[0])).name != GROUND:
            return None
        is_field = model.geom_type[chosen[0]] == mujoco.mjtGeom.mjGEOM_HFIELD
        there = is_field and model.body_mocapid[model.geom_bodyid[chosen[0]]] >= 0
        return cls.of(engine) if there and is_host(engine.state("mocap_pos")) else None

    def offset(self, env_ids: EnvIndex | None = None) -> Floats:
        """(n, 3) m: position of the terrain in environments; None is all. Do not write."""
        return self._positions[slice(None) if env_ids is None else env_ids, self.columns]

    def read(
        self, x: Floats, y: Floats, env_ids: EnvIndex | None = None
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Height of the ground at places, and whether there is ground.

        Args:
            x: (n, ...) m in the environment's frame.
            y: (n, ...) m.
            env_ids: (n,) the environments; None is all.

        Returns:
            (n, ...) m, where there is none that of the nearest edge, and a mask (n, ...).
        """
        offset = self.offset(env_ids).reshape(-1, 3, *(1,) * (x.ndim - 1))
        x, y = x - offset[:, 0], y - offset[:, 1]
        inside = (np.abs(x) <= self._half[0]) & (np.abs(y) <= self._half[1])
        column, u = _cell((x + self._half[0]) * self._scale[0], self._shape[1])
        row, v = _cell((y + self._half[1]) * self._scale[1], self._shape[0])
        first = row * self._shape[1] + column
        near, far = self._heights[first], self._heights[first + self._shape[1] + 1]
        # The third corner of the triangle: MuJoCo divides a cell from its first corner to the last.
        right = u >= v
        other = self._heights[first + np.where(right, 1, self._shape[1])]
        most, least = np.maximum(u, v), np.minimum(u, v)
        found: Floats = near + most * (other - near) + least * (far - other) + offset[:, 2]
        return found, inside


def _cell(place: Floats, nodes: int) -> tuple[NDArray[np.int64], Floats]:
    """The cell in which each coordinate is, in steps of the grid, and the share in [0, 1] of it."""
    place = np.clip(place, 0.0, nodes - 1.0)
    cell = np.minimum(place.astype(np.int64), nodes - 2)
    return cell, place - cell

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

_HEIGHTS_OF: WeakKeyDictionary[Engine, GroundHeights] = WeakKeyDictionary()


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
        half_x, half_y, extent, _ = model.hfield_size[field].tolist()
        self._half_x: float = half_x
        self._half_y: float = half_y

        # The grid: nodes along y and x, their heights, and nodes a metre.
        self._nodes_y = int(model.hfield_nrow[field])
        self._nodes_x = int(model.hfield_ncol[field])
        start = int(model.hfield_adr[field])
        values = model.hfield_data[start : start + self._nodes_y * self._nodes_x].astype(np.float64)
        self._heights: Floats = values * extent + float(geom.pos[2])
        self._scale_x = (self._nodes_x - 1) / (2.0 * half_x)
        self._scale_y = (self._nodes_y - 1) / (2.0 * half_y)

        # Where it is: a part of the state, since environments begin on tiles of their own.
        first = 3 * int(model.body_mocapid[geom.bodyid[0]])
        self.columns = slice(first, first + 3)
        self._positions = engine.state("mocap_pos")

    @classmethod
    def of(cls, engine: Engine) -> GroundHeights:
        """The heights of an engine's scene: one object for all that read them.

        Raises:
            ConfigError: If arrays are on a device.
        """
        heights = _HEIGHTS_OF.get(engine)
        if heights is None:
            if not is_host(engine.state("mocap_pos")):
                raise ConfigError("heights of a terrain need arrays on the host: warp.arrays=host")
            heights = cls(engine)
            _HEIGHTS_OF[engine] = heights
        return heights

    @classmethod
    def hit_alone(cls, engine: Engine, geoms: NDArray[np.bool_]) -> GroundHeights | None:
        """The heights, if the ground is a terrain and the only one of these geoms; else None.

        Args:
            engine: The engine.
            geoms: (ngeom,) mask of geoms.
        """
        model = engine.model
        ids = np.flatnonzero(geoms)
        if len(ids) != 1:
            return None
        geom = model.geom(int(ids[0]))
        is_field = geom.type[0] == mujoco.mjtGeom.mjGEOM_HFIELD
        if geom.name != GROUND or not is_field:
            return None
        is_terrain = model.body_mocapid[geom.bodyid[0]] >= 0
        if not is_terrain or not is_host(engine.state("mocap_pos")):
            return None
        return cls.of(engine)

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
        x = x - offset[:, 0]
        y = y - offset[:, 1]
        is_inside = (np.abs(x) <= self._half_x) & (np.abs(y) <= self._half_y)
        column, u = _cell((x + self._half_x) * self._scale_x, self._nodes_x)
        row, v = _cell((y + self._half_y) * self._scale_y, self._nodes_y)
        first = row * self._nodes_x + column
        near = self._heights[first]
        far = self._heights[first + self._nodes_x + 1]
        # The third corner of the triangle: MuJoCo divides a cell from its first corner to the last.
        third = self._heights[first + np.where(u >= v, 1, self._nodes_x)]
        larger = np.maximum(u, v)
        smaller = np.minimum(u, v)
        heights: Floats = near + larger * (third - near) + smaller * (far - third) + offset[:, 2]
        return heights, is_inside


def _cell(place: Floats, nodes: int) -> tuple[NDArray[np.int64], Floats]:
    """The cell in which each coordinate is, in steps of the grid, and the share in [0, 1] of it."""
    place = np.clip(place, 0.0, nodes - 1.0)
    cell = np.minimum(place.astype(np.int64), nodes - 2)
    return cell, place - cell

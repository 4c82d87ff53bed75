"""`add_terrain`: the patches of a terrain as one height field, which environments move under them.

One height field is one geom: collision detection visits only the cells below a shape, so a large
field costs what a small one costs, where a geom for each patch would be one pair more with each
link. It is on a mocap body, so the patch that an environment is on is part of its state: logs,
replays and viewers need nothing else, and the environment's origin is always on its patch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.geoms.contact_parameters import (
    check_fixed_contact,
    fixed_contact,
    set_contact_parameters,
)
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import GROUND
from embodichain.lab.sim.compiler.scene.appearance import add_ground
from embodichain.lab.sim.compiler.scene.terrain_patches import PatchGrid, patch_heights
from embodichain.lab.sim.configs.scene_cfg import GroundCfg, TerrainCfg
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["Terrain", "add_terrain", "terrain_heights"]

_MOST_NODES = 4_000_000
"""Heights of a field: 16 MB in the model; viewers get two triangles for each."""
_FEWEST_NODES = 8
"""Along the edge of a patch."""
_BASE = 1.0
"""Metres of ground below the lowest point."""


@dataclass(frozen=True, eq=False)
class Terrain:
    """The patches of a terrain, in the frame of its body, whose axes are the world's.

    Attributes:
        kinds: (K,) name of the kind of each column.
        origins: (L, K, 3) m: the ground in the middle of each patch, by level and column.
        size: Metres: edge of a patch.
        half: Metres along x and y: half the edges of the field, border included.
    """

    kinds: tuple[str, ...]
    origins: F64
    size: float
    half: tuple[float, float]

    @property
    def levels(self) -> int:
        """L."""
        return len(self.origins)


def terrain_heights(cfg: TerrainCfg) -> tuple[F64, Terrain]:
    """Return heights, metres, (rows along y, columns along x), and the patches.

    Equal configs give equal bytes.

    Raises:
        ConfigError: If the numbers do not fit together.
    """
    _check(cfg)
    count = round(cfg.size / cfg.resolution)
    edge = round(cfg.border / cfg.resolution)
    grid = PatchGrid(count, cfg.resolution, cfg.platform)
    columns = [(name, i) for name, patch in cfg.patches.items() for i in range(patch.columns)]
    rows_of_field = len(columns) * count + 2 * edge
    columns_of_field = cfg.levels * count + 2 * edge
    heights = np.zeros((rows_of_field, columns_of_field))
    origins = np.zeros((cfg.levels, len(columns), 3))
    for level in range(cfg.levels):
        difficulty = level / max(cfg.levels - 1, 1)
        first_column = edge + level * count
        x = first_column + 0.5 * (count - columns_of_field)
        for column, (name, number) in enumerate(columns):
            first_row = edge + column * count
            y = first_row + 0.5 * (count - rows_of_field)
            stream = f"terrain/{name}/{number}/{level}"
            patch, middle = patch_heights(cfg.patches[name], grid, difficulty, cfg.seed, stream)
            heights[first_row : first_row + count, first_column : first_column + count] = patch
            origins[level, column] = x * cfg.resolution, y * cfg.resolution, middle
    terrain = Terrain(
        kinds=tuple(name for name, _ in columns),
        origins=origins,
        size=count * cfg.resolution,
        half=(
            0.5 * (columns_of_field - 1) * cfg.resolution,
            0.5 * (rows_of_field - 1) * cfg.resolution,
        ),
    )
    return heights, terrain


def _check(cfg: TerrainCfg) -> None:
    problems = check_fixed_contact(cfg)
    if not cfg.patches:
        problems.append(Problem("patches", "names no patch"))
    if not cfg.size / cfg.resolution >= _FEWEST_NODES:
        message = f"must be at most an eighth of size, {cfg.size} m, got {cfg.resolution}"
        problems.append(Problem("resolution", message))
    if not 2.0 * cfg.resolution <= cfg.platform < cfg.size:
        message = f"must be less than size, {cfg.size} m, and at least twice the resolution"
        problems.append(Problem("platform", f"{message}, got {cfg.platform}"))
    columns = sum(patch.columns for patch in cfg.patches.values())
    edges = (n * cfg.size + 2.0 * cfg.border for n in (cfg.levels, columns))
    nodes = math.prod(edge / cfg.resolution for edge in edges)
    if nodes > _MOST_NODES:
        message = f"gives {nodes:.2g} heights; a terrain can have {_MOST_NODES:.0e}"
        problems.append(Problem("resolution", message))
    if problems:
        raise ConfigError(p.below("scene.terrain") for p in problems)


def add_terrain(spec: mujoco.MjSpec, cfg: TerrainCfg, ground: GroundCfg) -> Terrain:
    """Add the height field as geom `GROUND` of a mocap body; its first patch is at the origin.

    Args:
        spec: The scene.
        cfg: The terrain.
        ground: Its colours.

    Raises:
        ConfigError: If the numbers do not fit together; paths begin with ``scene.terrain``.
    """
    heights, terrain = terrain_heights(cfg)
    lowest = float(heights.min())
    extent = float(heights.max()) - lowest
    spec.add_hfield(
        name=GROUND,
        nrow=heights.shape[0],
        ncol=heights.shape[1],
        size=[*terrain.half, extent or 1.0, _BASE],
        userdata=((heights - lowest) / (extent or 1.0)).astype(np.float32).ravel(),
    )
    add_ground(spec, ground)
    spec.delete(spec.geom(GROUND))
    # The images of a height field are counted over all of it, those of a plane every 2 m.
    material = spec.material(GROUND)
    material.texuniform = False
    material.texrepeat = np.array(terrain.half) * np.asarray(material.texrepeat)
    body = spec.worldbody.add_body(name=GROUND, mocap=True, pos=-terrain.origins[0, 0])
    geom = body.add_geom(
        name=GROUND,
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname=GROUND,
        pos=[0.0, 0.0, lowest],
        material=GROUND,
    )
    set_contact_parameters([geom], fixed_contact(cfg))
    return terrain

"""`above_ground`: heights of places count from the ground of a terrain, where there is one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.reads.height_field import GroundHeights
    from embodichain.utils.array_types import Floats

__all__ = ["above_ground", "ground_of"]

_FLAT = 1e-6
"""Metres: the middle of a patch is at height 0 but for the rounding of the field's float32."""


def ground_of(env: TermContext) -> GroundHeights | None:
    """The ground of a scene with a terrain, None of any other scene.

    Raises:
        ConfigError: If there is a terrain, and arrays are on a device.
    """
    if env.sim.scene.terrain is None:
        return None
    from embodichain.lab.sim.reads.height_field import GroundHeights  # few scenes have a terrain

    return GroundHeights.of(env.sim.engine)


def above_ground(ground: GroundHeights | None, places: Floats, env_ids: EnvIndex | None) -> Floats:
    """Return places whose heights count from the ground below them.

    Args:
        ground: The result of `ground_of`; None returns the places themselves.
        places: (n, 3) m, heights above the ground; not changed.
        env_ids: (n,) the environments, or None for all.

    Returns:
        (n, 3) m in the environment's frame. Beyond the terrain the height of its edge counts.
    """
    if ground is None:
        return places
    height, _ = ground.read(places[:, 0], places[:, 1], env_ids)
    raised = places.copy()
    raised[:, 2] += np.where(np.abs(height) < _FLAT, 0.0, height)
    return raised

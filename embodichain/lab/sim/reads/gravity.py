"""`gravity_direction`: where gravity points, in each environment."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from embodichain.utils.arrays import is_host

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.api import Engine
    from embodichain.utils.array_types import Floats

__all__ = ["gravity_direction"]


def gravity_direction(engine: Engine) -> Floats:
    """(N or 1, 3) unit vectors along gravity, world axes; zeros where there is none: do not write.

    One row if all environments have the same gravity.

    Args:
        engine: The engine; gravity may be drawn for each environment.
    """
    gravity: Floats = engine.model_values("opt.gravity")
    if not engine.has_gravity:
        return np.zeros_like(gravity)
    if len(gravity) == 1 and is_host(gravity):  # it seldom changes: twenty times faster
        return _direction_of_one(gravity.tobytes())
    return _directions(gravity)


@lru_cache(maxsize=64)
def _direction_of_one(gravity: bytes) -> Floats:
    """(1, 3), read-only, of (1, 3) float64 as bytes."""
    direction = _directions(np.frombuffer(gravity).reshape(1, 3))
    direction.setflags(write=False)
    return direction


def _directions(gravity: Floats) -> Floats:
    """(n, 3) unit vectors; zeros where a vector is zero."""
    x, y, z = gravity.T
    length = np.sqrt(x * x + y * y + z * z)[:, None]
    is_absent = length == 0.0
    return np.where(is_absent, 0.0, gravity / np.where(is_absent, 1.0, length))

"""`gravity_direction`: where gravity points, in each environment."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.api import Engine
    from embodichain.utils.array_types import Floats

__all__ = ["gravity_direction"]


def gravity_direction(engine: Engine) -> Floats:
    """(N or 1, 3) unit vectors along gravity, world axes; zeros where there is none.

    One row if all environments have the same gravity.

    Args:
        engine: The engine; gravity may be drawn for each environment.
    """
    import mujoco  # lists of terms are made without it

    gravity: Floats = engine.model_values("opt.gravity")
    if engine.model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY):
        return np.zeros_like(gravity)
    x, y, z = gravity.T
    length = np.sqrt(x * x + y * y + z * z)[:, None]
    is_absent = length == 0.0
    return np.where(is_absent, 0.0, gravity / np.where(is_absent, 1.0, length))

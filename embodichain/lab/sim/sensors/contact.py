"""`ContactSensor`: which links are touched, and with what net force."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64
from embodichain.lab.sim.sensors.base import BaseSensor, as_tensor

__all__ = ["ContactSensor"]


class ContactSensor(BaseSensor):
    """Contacts of n links with anything, or with the entity that the config names.

    Contacts belong to the acceleration stage: they are those of the last physics step, and after a
    reset those of the state that it left. Shapes that collide with nothing report nothing.
    """

    def read_found(self) -> NDArray[np.bool_]:
        """(N, n) whether each link is touched."""
        found = self._last()[..., 0] > 0
        touched: NDArray[np.bool_] = found[:, :, 0]
        for other in range(1, found.shape[2]):
            touched = touched | found[:, :, other]
        return touched

    def read_force(self) -> F64:
        """(N, n, 3) N: net force that contacts exert on each link, world axes."""
        forces = self._last()[..., 1:]
        # MuJoCo reports what the link exerts on the other.
        net: F64 = 0.0 - forces[:, :, 0]
        for other in range(1, forces.shape[2]):
            net -= forces[:, :, other]
        return net

    def get_data(self) -> dict[str, torch.Tensor]:
        """``found`` (N, n), 1 or 0, and ``force`` (N, n, 3) in N, world axes."""
        return {
            "found": torch.from_numpy(self.read_found().astype(np.float32)),
            "force": as_tensor(self.read_force()),
        }

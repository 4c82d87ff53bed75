"""`ForceTorqueSensor`: what parents exert on links."""

from __future__ import annotations

import torch

from embodichain.lab.sim.engine.base import F64
from embodichain.lab.sim.sensors.base import BaseSensor, as_tensor

__all__ = ["ForceTorqueSensor"]


class ForceTorqueSensor(BaseSensor):
    """Force and torque between n links and their parents, read at each link's origin.

    They belong to the acceleration stage: those of the last physics step, and after a reset those
    of the state that it left. They are what the parent exerts on the link: at rest, upwards as much
    as the link and all it carries weigh.
    """

    def read_force(self) -> F64:
        """(N, n, 3) N, link axes."""
        return self._last()[..., 0:3].copy()

    def read_torque(self) -> F64:
        """(N, n, 3) N m about the link's origin, link axes."""
        return self._last()[..., 3:6].copy()

    def get_data(self) -> dict[str, torch.Tensor]:
        """``force`` (N, n, 3) and ``torque`` (N, n, 3)."""
        return {"force": as_tensor(self.read_force()), "torque": as_tensor(self.read_torque())}

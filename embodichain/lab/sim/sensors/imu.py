"""`ImuSensor`: accelerometer, gyroscope and orientation of one link."""

from __future__ import annotations

import numpy as np
import torch

from embodichain.lab.sim.engine.base import F64
from embodichain.lab.sim.sensors.base import BaseSensor, as_tensor
from embodichain.utils.math import quat_conjugate, quat_rotate

__all__ = ["ImuSensor"]

_DOWN = np.array([0.0, 0.0, -1.0])


class ImuSensor(BaseSensor):
    """An inertial measurement unit without noise; its axes are the link's, turned by the config.

    Orientation and angular velocity are those of the present state. The specific force belongs to
    the acceleration stage: it is that of the last physics step, and after a reset that of the state
    that it left.
    """

    def read_orientation(self) -> F64:
        """(N, 4) wxyz: sensor axes in the world."""
        return self._now()[:, 0:4].copy()

    def read_angular_velocity(self) -> F64:
        """(N, 3) rad/s, sensor axes."""
        return self._now()[:, 4:7].copy()

    def read_acceleration(self) -> F64:
        """(N, 3) m/s^2 specific force (acceleration minus gravity's), sensor axes.

        At rest it is 9.81 upwards, in free fall 0.
        """
        return self._last()[:, 7:10].copy()

    def read_projected_gravity(self) -> F64:
        """(N, 3) unit vector that points down in the world, sensor axes; upright (0, 0, -1)."""
        quat = self.read_orientation()
        down: F64 = quat_rotate(quat_conjugate(quat), np.broadcast_to(_DOWN, (len(quat), 3)))
        return down

    def get_data(self) -> dict[str, torch.Tensor]:
        """Return the four readings.

        ``orientation`` (N, 4), ``angular_velocity``, ``acceleration`` and ``projected_gravity``
        (N, 3) each.
        """
        return {
            "orientation": as_tensor(self.read_orientation()),
            "angular_velocity": as_tensor(self.read_angular_velocity()),
            "acceleration": as_tensor(self.read_acceleration()),
            "projected_gravity": as_tensor(self.read_projected_gravity()),
        }

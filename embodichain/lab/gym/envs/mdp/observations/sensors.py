"""Observations of sensors: contacts, inertial measurements, forces at joints.

Sensors are declared under `sensors:`; their contact forces, specific forces and joint forces are
those of the last physics step. Noise and delay are the observation's own keys.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import NonNegative
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp import _sensors, _spatial

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = [
    "BodyIncomingWrench",
    "ContactForce",
    "ContactFound",
    "ImuAcceleration",
    "ImuAngularVelocity",
    "ImuOrientation",
    "ImuProjectedGravity",
]


class _Reading(Term):
    """What a sensor reads: subclasses define `read`."""

    def read(self) -> F64:
        """(N, ...) float64."""
        raise NotImplementedError

    def __call__(self, env: TermContext, obs: Any) -> torch.Tensor:
        """(N, ...) float32."""
        return _spatial.tensor(self.read())


@register_term("observation", name="contact_found")
class ContactFound(_Reading, _sensors.ReadsContact):
    """(N, n) 1 where a link of a contact sensor is touched, else 0.

    Args:
        sensor: A contact sensor.
        threshold: N; with it a link counts as touched where the length of its net force is above.

    Example:
        ``{func: contact_found, params: {sensor: contacts, threshold: 1.0}}``
    """

    def __init__(self, env: TermContext, sensor: str, threshold: NonNegative | None = None) -> None:
        self._sensor, self._threshold = _sensors.contact(env, sensor), threshold

    def read(self) -> F64:
        """(N, n) 0 or 1."""
        if self._threshold is None:
            return self._sensor.read_found().astype(np.float64)
        above = _sensors.magnitude(self._sensor.read_force()) > self._threshold
        return above.astype(np.float64)


@register_term("observation", name="contact_force")
class ContactForce(_Reading, _sensors.ReadsContact):
    """(N, n, 3) net contact force on each link of a contact sensor, N, world axes.

    Args:
        sensor: A contact sensor.
        norm: Whether to give lengths, (N, n), instead of vectors.

    Example:
        ``{func: contact_force, scale: 0.01, params: {sensor: contacts, norm: true}}``
    """

    def __init__(self, env: TermContext, sensor: str, norm: bool = False) -> None:
        self._sensor, self._norm = _sensors.contact(env, sensor), norm

    def read(self) -> F64:
        """(N, n, 3) or (N, n) N."""
        force = self._sensor.read_force()
        return _sensors.magnitude(force) if self._norm else force


@register_term("observation", name="imu_acceleration")
class ImuAcceleration(_Reading, _sensors.ReadsImu):
    """(N, 3) specific force that an IMU reads, m/s^2, its axes: 9.81 upwards at rest.

    Isaac Lab's `imu_lin_acc`.

    Args:
        sensor: An IMU.

    Example:
        ``{func: imu_acceleration, scale: 0.1, params: {sensor: imu}}``
    """

    def __init__(self, env: TermContext, sensor: str) -> None:
        self._sensor = _sensors.imu(env, sensor)

    def read(self) -> F64:
        """(N, 3) m/s^2."""
        return self._sensor.read_acceleration()


@register_term("observation", name="imu_angular_velocity")
class ImuAngularVelocity(_Reading, _sensors.ReadsImu):
    """(N, 3) angular velocity that an IMU reads, rad/s, its axes. Isaac Lab's `imu_ang_vel`.

    Args:
        sensor: An IMU.

    Example:
        ``{func: imu_angular_velocity, scale: 0.25, params: {sensor: imu}}``
    """

    def __init__(self, env: TermContext, sensor: str) -> None:
        self._sensor = _sensors.imu(env, sensor)

    def read(self) -> F64:
        """(N, 3) rad/s."""
        return self._sensor.read_angular_velocity()


@register_term("observation", name="imu_orientation")
class ImuOrientation(_Reading, _sensors.ReadsImu):
    """(N, 4) wxyz: an IMU's axes in the world. Isaac Lab's observation of the same name.

    Args:
        sensor: An IMU.

    Example:
        ``{func: imu_orientation, params: {sensor: imu}}``
    """

    def __init__(self, env: TermContext, sensor: str) -> None:
        self._sensor = _sensors.imu(env, sensor)

    def read(self) -> F64:
        """(N, 4) wxyz."""
        return self._sensor.read_orientation()


@register_term("observation", name="imu_projected_gravity")
class ImuProjectedGravity(_Reading, _sensors.ReadsImu):
    """(N, 3) the world's unit vector straight down, in an IMU's axes: (0, 0, -1) when upright.

    Isaac Lab's observation of the same name.

    Args:
        sensor: An IMU.

    Example:
        ``{func: imu_projected_gravity, params: {sensor: imu}}``
    """

    def __init__(self, env: TermContext, sensor: str) -> None:
        self._sensor = _sensors.imu(env, sensor)

    def read(self) -> F64:
        """(N, 3)."""
        return self._sensor.read_projected_gravity()


@register_term("observation", name="body_incoming_wrench")
class BodyIncomingWrench(_Reading, _sensors.ReadsForceTorque):
    """(N, 6 n) force in N, then torque in N m, of each link of a force-torque sensor, its axes.

    Isaac Lab's observation of the same name; the sign is the sensor's.

    Args:
        sensor: A force-torque sensor.

    Example:
        ``{func: body_incoming_wrench, scale: 0.01, params: {sensor: wrench}}``
    """

    def __init__(self, env: TermContext, sensor: str) -> None:
        self._sensor = _sensors.force_torque(env, sensor)

    def read(self) -> F64:
        """(N, 6 n)."""
        force, torque = self._sensor.read_force(), self._sensor.read_torque()
        wrench: F64 = np.concatenate([force, torque], axis=2).reshape(len(force), -1)
        return wrench

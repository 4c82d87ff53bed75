"""Quantities of sensors: contacts, inertial measurements, forces at joints, heights, any reading.

Sensors are declared under `sensors:`; contact forces, specific forces and joint forces are those of
the last physics step. Whether there is contact is asked of all physics steps of a control step
(``history_length`` of the sensor), as in Isaac Lab and mjlab: a contact may begin and end between
two observations. n is the number of links of a sensor.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import (
    ContactHistoryOf,
    ContactOf,
    ForceTorqueOf,
    HeightScanOf,
    ImuOf,
    NonNegative,
    PlanarCommand,
    SensorOf,
)
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.managers.terms.registry import quantity
from embodichain.lab.gym.envs.mdp._rows import norm, total
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.cfg import EnvCfg
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.configs.sensor_cfg import SensorCfg
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.utils.array_types import Floats

__all__ = [
    "FeetAirTime",
    "SensorReading",
    "body_incoming_wrench",
    "contact_force",
    "contact_found",
    "feet_slide",
    "height_scan",
    "imu_acceleration",
    "imu_angular_velocity",
    "imu_orientation",
    "imu_projected_gravity",
    "largest_contact_force",
]


def _lengths(forces: Floats) -> Floats:
    """(N, n) N: lengths of forces (N, n, 3)."""
    x, y, z = (forces[..., i] for i in range(3))
    return np.sqrt(x * x + y * y + z * z)


@quantity()
def contact_found(
    env: TermContext, sensor: ContactHistoryOf, threshold: NonNegative | None = None
) -> Floats:
    """(N, n) 1 where a link of a contact sensor was touched in a physics step, else 0.

    The physics steps are those of the control step (``history_length`` of the sensor).

    Args:
        threshold: N; if given, a link counts as touched where its net force is larger.

    Example:
        ``{func: contact_found, params: {sensor: contacts, threshold: 1.0}}``
    """
    if threshold is None:
        return sensor.read_touched().astype(np.float64)
    return (sensor.read_largest_force() > threshold).astype(np.float64)


@quantity()
def contact_force(env: TermContext, sensor: ContactOf, norm: bool = False) -> Floats:
    """(N, n, 3) net contact force on each link of a contact sensor, N, world axes.

    Args:
        norm: Whether to give lengths, (N, n), instead of vectors.

    Example:
        ``{func: contact_force, params: {sensor: contacts, norm: true}}``
    """
    force = sensor.read_force()
    return _lengths(force) if norm else force


@quantity()
def largest_contact_force(env: TermContext, sensor: ContactHistoryOf) -> Floats:
    """(N, n) N: largest net contact force on each link in the physics steps of a control step.

    The physics steps are those of ``history_length`` of the sensor.

    Example:
        ``{func: largest_contact_force, params: {sensor: contacts}}``
    """
    return sensor.read_largest_force()


@quantity("reward", "metric", name="feet_air_time")
class FeetAirTime(Term):
    """Sum over feet that land in this step of (time in the air - threshold), s: rewards long steps.

    0 where the commanded speed is less than `min_command`. Air time counts control steps, that of
    the landing included; the air time of feet that start in the air begins with the episode. A foot
    is in contact that is so in a physics step of the control step (``history_length`` of the
    sensor). Isaac Lab's reward of the same name.

    Args:
        sensor: A contact sensor on the feet.
        command_name: A command whose first two columns are vx and vy, m/s; None means no condition.
        threshold: Air time with reward 0, s; shorter steps give a negative one.
        min_command: m/s.
        force_threshold: Force above which a foot is in contact, N.

    Example:
        ``{func: feet_air_time, weight: 0.5, params: {sensor: contacts, command_name: velocity,
        threshold: 0.5}}``
    """

    saved = ("_air",)

    def __init__(
        self,
        env: TermContext,
        sensor: ContactHistoryOf,
        command_name: PlanarCommand | None = None,
        threshold: NonNegative = 0.5,
        min_command: NonNegative = 0.1,
        force_threshold: NonNegative = 1.0,
    ) -> None:
        self._sensor = sensor
        self._command = command_name
        self._force_threshold = force_threshold
        self._threshold = threshold
        self._min_command = min_command
        self._dt = env.step_dt
        # Seconds since each foot was touched, 0 while it is. Saved under this name.
        self._air: Floats = env.arrays.full((env.num_envs, len(sensor.names)), 0.0)

    def __call__(self) -> Floats:
        """(N,) s; the clocks of the feet advance by one control step."""
        is_touched = self._sensor.read_largest_force() > self._force_threshold
        air_time = self._air + self._dt
        has_landed = is_touched & (self._air > 0.0)
        self._air = np.where(is_touched, 0.0, air_time)
        reward = total(np.where(has_landed, air_time - self._threshold, 0.0))
        if self._command is None:
            return reward
        is_commanded = norm(self._command()[:, :2]) > self._min_command
        return np.where(is_commanded, reward, 0.0)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Set the clocks of these environments to 0."""
        self._air[slice(None) if env_ids is None else env_ids] = 0.0


@quantity("reward", "metric")
def feet_slide(env: TermContext, sensor: ContactHistoryOf, threshold: NonNegative = 1.0) -> Floats:
    """(N,) sum over touched feet of their speed in the plane, m/s. Isaac Lab's reward of the name.

    The speed is that of the origin of each link or geom after the last physics step. A foot is
    touched that is so in a physics step of the control step (``history_length`` of the sensor).

    Args:
        sensor: A contact sensor on the feet.
        threshold: Force above which a foot is in contact, N.

    Example:
        ``{func: feet_slide, weight: -0.1, params: {sensor: contacts}}``
    """
    linear, _ = sensor.frames.velocities(env.sim.engine)
    x = linear[..., 0]
    y = linear[..., 1]
    is_touched = sensor.read_largest_force() > threshold
    return total(np.where(is_touched, np.sqrt(x * x + y * y), 0.0))


@quantity()
def imu_acceleration(env: TermContext, sensor: ImuOf) -> Floats:
    """(N, 3) specific force that an IMU measures, m/s^2, in its axes: 9.81 upwards at rest.

    Isaac Lab's `imu_lin_acc`.

    Example:
        ``{func: imu_acceleration, params: {sensor: imu}}``
    """
    return sensor.read_acceleration()


@quantity()
def imu_angular_velocity(env: TermContext, sensor: ImuOf) -> Floats:
    """(N, 3) angular velocity that an IMU measures, rad/s, in its axes. Isaac Lab's `imu_ang_vel`.

    Example:
        ``{func: imu_angular_velocity, params: {sensor: imu}}``
    """
    return sensor.read_angular_velocity()


@quantity("observation")
def imu_orientation(env: TermContext, sensor: ImuOf) -> Floats:
    """(N, 4) orientation of an IMU in the world, wxyz. Isaac Lab's observation of the same name.

    Example:
        ``{func: imu_orientation, params: {sensor: imu}}``
    """
    return sensor.read_orientation()


@quantity()
def imu_projected_gravity(env: TermContext, sensor: ImuOf) -> Floats:
    """(N, 3) the unit vector of gravity in an IMU's axes: (0, 0, -1) when upright.

    It follows the scene's gravity, as `projected_gravity` does. Isaac Lab's observation of the same
    name.

    Example:
        ``{func: imu_projected_gravity, params: {sensor: imu}}``
    """
    return sensor.read_projected_gravity()


@quantity()
def body_incoming_wrench(env: TermContext, sensor: ForceTorqueOf) -> Floats:
    """(N, 6 n) force in N, then torque in N m, of each link of a force-torque sensor, in its axes.

    Isaac Lab's observation of the same name; the sign is the sensor's.

    Example:
        ``{func: body_incoming_wrench, params: {sensor: wrench}}``
    """
    force = sensor.read_force()
    wrench = np.concatenate([force, sensor.read_torque()], axis=2)
    return wrench.reshape(len(wrench), -1)


@quantity()
def height_scan(env: TermContext, sensor: HeightScanOf, offset: float = 0.5) -> Floats:
    """(N, R) m: heights of a height scan's origin above the surface, minus an offset.

    Isaac Lab's observation of the same name.

    Args:
        offset: m; the height at which the sensor usually is.

    Example:
        ``{func: height_scan, clip: [-1, 1], params: {sensor: scan, offset: 0.3}}``
    """
    return sensor.read_height() - offset


@quantity(name="sensor_reading")
class SensorReading(Term):
    """A reading of any sensor but a camera, (N, K).

    Distances of rays, the position of a frame, torques of joints.

    Args:
        reading: One of its readings, such as ``position`` of a frame; None is the first of them.

    Example:
        ``{func: sensor_reading, params: {sensor: load, reading: torque}}``
    """

    def __init__(self, env: TermContext, sensor: SensorOf, reading: str | None = None) -> None:
        problems = _check_reading(sensor.uid, sensor.cfg, reading)
        if problems:
            raise ConfigError(problems)
        self._env = env
        if reading is None:
            reading = sensor.reads[0]
        self._read = getattr(sensor, f"read_{reading}")

    @classmethod
    def check_task(
        cls, task: EnvCfg, params: Mapping[str, Any], allow_import: bool
    ) -> list[Problem]:
        """Return mistakes that depend on the whole task: whether the sensor has the reading."""
        cfg = task.sensors.get(params["sensor"])
        if cfg is None:
            return []  # added in Python, or reported as missing
        return _check_reading(params["sensor"], cfg, params.get("reading"))

    def __call__(self) -> Floats:
        """(N, K) the reading; its dimensions after the first are flattened."""
        values: Floats = self._env.arrays.of(self._read()).astype(np.float64, copy=False)
        return values.reshape(len(values), -1)


def _check_reading(sensor: str, cfg: SensorCfg, reading: str | None) -> list[Problem]:
    if cfg.reads_images:
        return [Problem("sensor", f"{sensor!r} is a camera: its images are not columns")]
    readings = cfg.readings()
    if reading is None or reading in readings:
        return []
    message = f"sensor {sensor!r} has no reading {reading!r}; it has: {', '.join(readings)}"
    return [Problem("reading", message, did_you_mean(reading, readings).strip())]

"""Sensors as terms read them: by name, of the kind that the term needs.

Lengths of forces are summed in a fixed order. What a sensor measures is `lab.sim.sensors`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.engine.base import F64
    from embodichain.lab.sim.sensors.contact import ContactSensor
    from embodichain.lab.sim.sensors.force_torque import ForceTorqueSensor
    from embodichain.lab.sim.sensors.imu import ImuSensor

__all__ = ["contact", "force_torque", "imu", "magnitude"]


def contact(env: BaseEnv, name: str) -> ContactSensor:
    """Return a contact sensor by name, for terms that are built with one.

    Raises:
        ConfigError: If there is none of that name, or it is another kind; lists those there are.
    """
    found: ContactSensor = _find(env, name, "contact", "read_force")
    return found


def imu(env: BaseEnv, name: str) -> ImuSensor:
    """Return an inertial measurement unit by name; see `contact`."""
    found: ImuSensor = _find(env, name, "imu", "read_acceleration")
    return found


def force_torque(env: BaseEnv, name: str) -> ForceTorqueSensor:
    """Return a force-torque sensor by name; see `contact`."""
    found: ForceTorqueSensor = _find(env, name, "force_torque", "read_torque")
    return found


def _find(env: BaseEnv, name: str, kind: str, method: str) -> Any:
    """A sensor that has what its kind reads by: subclasses of `BaseEnv` may bring their own."""
    there = [uid for uid, sensor in env.sensors.items() if hasattr(sensor, method)]
    if name in there:
        return env.sensors[name]
    what = f"{name!r} is no {kind} sensor" if name in env.sensors else f"no sensor {name!r}"
    message = f"{what}; {kind} sensors: {', '.join(there) or 'none'}"
    raise ConfigError([Problem("sensor", message, did_you_mean(name, there).strip())])


def magnitude(forces: F64) -> F64:
    """(N, n) N: lengths of forces (N, n, 3)."""
    x, y, z = forces[..., 0], forces[..., 1], forces[..., 2]
    found: F64 = np.sqrt(x * x + y * y + z * z)
    return found

"""Sensors as terms read them: by name, of the kind that the term needs.

A term that reads one has the kind's class (`ReadsContact`...) among its bases, so that a config
with another kind is found wrong before anything is built. Lengths of forces are summed in a fixed
order. What a sensor measures is `lab.sim.sensors`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.cfg import EnvCfg
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64
    from embodichain.lab.sim.sensors.contact import ContactSensor
    from embodichain.lab.sim.sensors.force_torque import ForceTorqueSensor
    from embodichain.lab.sim.sensors.imu import ImuSensor

__all__ = [
    "ReadsContact",
    "ReadsForceTorque",
    "ReadsImu",
    "contact",
    "force_torque",
    "imu",
    "magnitude",
]


class _Reads:
    """Base of terms whose parameter `sensor` names a sensor of one kind."""

    sensor_type: ClassVar[str]

    @classmethod
    def check_task(
        cls, task: EnvCfg, params: Mapping[str, Any], allow_import: bool
    ) -> list[Problem]:
        """Return what is wrong with the sensor's kind; that it exists is checked elsewhere."""
        name = params.get("sensor")
        types = {uid: cfg.sensor_type for uid, cfg in task.sensors.items()}
        if types.get(str(name), cls.sensor_type) == cls.sensor_type:
            return []
        there = [uid for uid, kind in types.items() if kind == cls.sensor_type]
        return [_another_kind(str(name), cls.sensor_type, there)]


class ReadsContact(_Reads):
    """Base of terms that read a contact sensor."""

    sensor_type = "contact"


class ReadsImu(_Reads):
    """Base of terms that read an inertial measurement unit."""

    sensor_type = "imu"


class ReadsForceTorque(_Reads):
    """Base of terms that read a force-torque sensor."""

    sensor_type = "force_torque"


def contact(env: TermContext, name: str) -> ContactSensor:
    """Return a contact sensor by name, for terms that are built with one.

    Raises:
        ConfigError: If there is none of that name, or it is another kind; lists those there are.
    """
    found: ContactSensor = _find(env, name, "contact", "read_force")
    return found


def imu(env: TermContext, name: str) -> ImuSensor:
    """Return an inertial measurement unit by name; see `contact`."""
    found: ImuSensor = _find(env, name, "imu", "read_acceleration")
    return found


def force_torque(env: TermContext, name: str) -> ForceTorqueSensor:
    """Return a force-torque sensor by name; see `contact`."""
    found: ForceTorqueSensor = _find(env, name, "force_torque", "read_torque")
    return found


def _find(env: TermContext, name: str, kind: str, method: str) -> Any:
    """A sensor that has what its kind reads by: subclasses of `BaseEnv` may bring their own."""
    there = [uid for uid, sensor in env.sensors.items() if hasattr(sensor, method)]
    if name in there:
        return env.sensors[name]
    if name in env.sensors:
        raise ConfigError([_another_kind(name, kind, there)])
    message = f"no sensor is called {name!r}; {kind} sensors: {', '.join(there) or 'none'}"
    raise ConfigError([Problem("sensor", message, did_you_mean(name, there).strip())])


def _another_kind(name: str, kind: str, there: Iterable[str]) -> Problem:
    """A sensor of the wrong kind."""
    message = f"{name!r} is no {kind} sensor; {kind} sensors: {', '.join(there) or 'none'}"
    return Problem("sensor", message)


def magnitude(forces: F64) -> F64:
    """(N, n) N: lengths of forces (N, n, 3)."""
    x, y, z = forces[..., 0], forces[..., 1], forces[..., 2]
    found: F64 = np.sqrt(x * x + y * y + z * z)
    return found

"""Sensors: contacts, inertial measurements, joint forces. Cameras have only configs so far."""

from typing import TYPE_CHECKING

import lazy_loader

from embodichain.lab.sim.sensors.cfg import (
    AnySensorCfg,
    CameraCfg,
    ContactSensorCfg,
    ForceTorqueSensorCfg,
    ImuSensorCfg,
    LinksCfg,
    SensorCfg,
    StereoCameraCfg,
)

if TYPE_CHECKING:
    from embodichain.lab.sim.sensors.sensor_handles import (
        BaseSensor,
        ContactSensor,
        ForceTorqueSensor,
        ImuSensor,
    )

# Handles import torch, configs do not.
__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "sensor_handles": ["BaseSensor", "ContactSensor", "ForceTorqueSensor", "ImuSensor"]
    },
)

__all__ = [
    "AnySensorCfg",
    "BaseSensor",
    "CameraCfg",
    "ContactSensor",
    "ContactSensorCfg",
    "ForceTorqueSensor",
    "ForceTorqueSensorCfg",
    "ImuSensor",
    "ImuSensorCfg",
    "LinksCfg",
    "SensorCfg",
    "StereoCameraCfg",
]

"""Sensors: contacts, inertial measurements, joint forces. Cameras have configs only."""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
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
    from embodichain.lab.sim.sensors.sensor_handles import (
        BaseSensor,
        ContactSensor,
        ForceTorqueSensor,
        ImuSensor,
    )

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "cfg": [
            "AnySensorCfg",
            "CameraCfg",
            "ContactSensorCfg",
            "ForceTorqueSensorCfg",
            "ImuSensorCfg",
            "LinksCfg",
            "SensorCfg",
            "StereoCameraCfg",
        ],
        "sensor_handles": ["BaseSensor", "ContactSensor", "ForceTorqueSensor", "ImuSensor"],
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

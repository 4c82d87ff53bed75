"""What a simulation can be asked about itself: contacts, inertial measurements, joint forces.

Configs are in `cfg` and `camera_cfg` (no torch), handles in the other modules. Cameras have configs
only.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from embodichain.lab.sim.sensors.base import BaseSensor
    from embodichain.lab.sim.sensors.camera_cfg import CameraCfg, StereoCameraCfg
    from embodichain.lab.sim.sensors.cfg import (
        AnySensorCfg,
        ContactSensorCfg,
        ForceTorqueSensorCfg,
        ImuSensorCfg,
        LinksCfg,
        SensorCfg,
    )
    from embodichain.lab.sim.sensors.contact import ContactSensor
    from embodichain.lab.sim.sensors.force_torque import ForceTorqueSensor
    from embodichain.lab.sim.sensors.imu import ImuSensor

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "base": ["BaseSensor"],
        "camera_cfg": ["CameraCfg", "StereoCameraCfg"],
        "cfg": [
            "AnySensorCfg",
            "ContactSensorCfg",
            "ForceTorqueSensorCfg",
            "ImuSensorCfg",
            "LinksCfg",
            "SensorCfg",
        ],
        "contact": ["ContactSensor"],
        "force_torque": ["ForceTorqueSensor"],
        "imu": ["ImuSensor"],
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

"""Sensors: contacts, inertial measurements, joint forces, cameras."""

from typing import TYPE_CHECKING

import lazy_loader

from embodichain.lab.sim.sensors.cfg import (
    AnySensorCfg,
    CameraCfg,
    ContactSensorCfg,
    ExtrinsicsCfg,
    ForceTorqueSensorCfg,
    ImuSensorCfg,
    LinksCfg,
    OffsetCfg,
    SensorCfg,
    StereoCameraCfg,
)

if TYPE_CHECKING:
    from embodichain.lab.sim.sensors.camera import Camera, StereoCamera
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
        "camera": ["Camera", "StereoCamera"],
        "sensor_handles": ["BaseSensor", "ContactSensor", "ForceTorqueSensor", "ImuSensor"],
    },
)

__all__ = [
    "AnySensorCfg",
    "BaseSensor",
    "Camera",
    "CameraCfg",
    "ContactSensor",
    "ContactSensorCfg",
    "ExtrinsicsCfg",
    "ForceTorqueSensor",
    "ForceTorqueSensorCfg",
    "ImuSensor",
    "ImuSensorCfg",
    "LinksCfg",
    "OffsetCfg",
    "SensorCfg",
    "StereoCamera",
    "StereoCameraCfg",
]

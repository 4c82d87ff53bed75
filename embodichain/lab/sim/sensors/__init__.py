"""Sensors: contacts, inertial measurements, forces at joints, poses, rays."""

from typing import TYPE_CHECKING

import lazy_loader

from embodichain.lab.sim.sensors.cfg import (
    AnySensorCfg,
    CameraCfg,
    ContactSensorCfg,
    ForceTorqueSensorCfg,
    FramePoseSensorCfg,
    HeightScanSensorCfg,
    ImuSensorCfg,
    JointsCfg,
    JointTorqueSensorCfg,
    LinksCfg,
    RayFanCfg,
    RayGridCfg,
    RayPatternCfg,
    RaySensorCfg,
    SensorCfg,
    StereoCameraCfg,
)

if TYPE_CHECKING:
    from embodichain.lab.sim.sensors.ray_sensors import HeightScanSensor, RaySensor
    from embodichain.lab.sim.sensors.sensor_handles import (
        BaseSensor,
        ContactSensor,
        ForceTorqueSensor,
        FramePoseSensor,
        ImuSensor,
        JointTorqueSensor,
    )

# Handles import torch, configs do not.
__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "ray_sensors": ["HeightScanSensor", "RaySensor"],
        "sensor_handles": [
            "BaseSensor",
            "ContactSensor",
            "ForceTorqueSensor",
            "FramePoseSensor",
            "ImuSensor",
            "JointTorqueSensor",
        ],
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
    "FramePoseSensor",
    "FramePoseSensorCfg",
    "HeightScanSensor",
    "HeightScanSensorCfg",
    "ImuSensor",
    "ImuSensorCfg",
    "JointTorqueSensor",
    "JointTorqueSensorCfg",
    "JointsCfg",
    "LinksCfg",
    "RayFanCfg",
    "RayGridCfg",
    "RayPatternCfg",
    "RaySensor",
    "RaySensorCfg",
    "SensorCfg",
    "StereoCameraCfg",
]

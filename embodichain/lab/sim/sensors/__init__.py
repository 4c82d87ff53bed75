"""Sensors: contacts, inertial measurements, forces, poses of frames, rays, cameras."""

from typing import TYPE_CHECKING

import lazy_loader

from embodichain.lab.sim.configs.sensor_cfg import (
    AnySensorCfg,
    CameraCfg,
    ContactSensorCfg,
    ExtrinsicsCfg,
    ForceTorqueSensorCfg,
    FramePoseSensorCfg,
    HeightScanSensorCfg,
    ImuSensorCfg,
    JointsCfg,
    JointTorqueSensorCfg,
    LinksCfg,
    OffsetCfg,
    RayFanCfg,
    RayGridCfg,
    RayPatternCfg,
    RaySensorCfg,
    SensorCfg,
    StereoCameraCfg,
)

if TYPE_CHECKING:
    from embodichain.lab.sim.sensors.camera import Camera, StereoCamera
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
        "camera": ["Camera", "StereoCamera"],
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
    "Camera",
    "CameraCfg",
    "ContactSensor",
    "ContactSensorCfg",
    "ExtrinsicsCfg",
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
    "OffsetCfg",
    "RayFanCfg",
    "RayGridCfg",
    "RayPatternCfg",
    "RaySensor",
    "RaySensorCfg",
    "SensorCfg",
    "StereoCamera",
    "StereoCameraCfg",
]

"""Sensors: contacts, inertial measurements, forces, poses of frames, rays, cameras.

A type of sensor is one file, registered with `register_sensor` (docs/extending.md).
"""

from typing import TYPE_CHECKING

import lazy_loader

from embodichain.lab.sim.compiler.sensing.frame_sensors import add_frame_sensors
from embodichain.lab.sim.configs.references import JointsCfg, LinksCfg
from embodichain.lab.sim.configs.sensor_cfg import SENSORS, AnySensorCfg, SensorCfg

if TYPE_CHECKING:
    from embodichain.lab.sim.sensors.base_sensor import (
        BaseSensor,
        LastStepSensor,
        register_sensor,
    )
    from embodichain.lab.sim.sensors.camera import Camera, StereoCamera
    from embodichain.lab.sim.sensors.camera_cfg import (
        CAMERA_IMAGES,
        CameraCfg,
        ExtrinsicsCfg,
        OffsetCfg,
        StereoCameraCfg,
    )
    from embodichain.lab.sim.sensors.contact import ContactSensor, ContactSensorCfg
    from embodichain.lab.sim.sensors.force_torque import ForceTorqueSensor, ForceTorqueSensorCfg
    from embodichain.lab.sim.sensors.frame_pose import FramePoseSensor, FramePoseSensorCfg
    from embodichain.lab.sim.sensors.imu import ImuSensor, ImuSensorCfg
    from embodichain.lab.sim.sensors.joint_torque import JointTorqueSensor, JointTorqueSensorCfg
    from embodichain.lab.sim.sensors.ray_patterns import RayFanCfg, RayGridCfg, RayPatternCfg
    from embodichain.lab.sim.sensors.ray_sensors import (
        HeightScanSensor,
        HeightScanSensorCfg,
        RayCastCfg,
        RaySensor,
        RaySensorCfg,
    )

# Sensors are imported when they are asked for, or by the register at its first look-up.
__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "base_sensor": ["BaseSensor", "LastStepSensor", "register_sensor"],
        "camera": ["Camera", "StereoCamera"],
        "camera_cfg": [
            "CAMERA_IMAGES",
            "CameraCfg",
            "ExtrinsicsCfg",
            "OffsetCfg",
            "StereoCameraCfg",
        ],
        "contact": ["ContactSensor", "ContactSensorCfg"],
        "force_torque": ["ForceTorqueSensor", "ForceTorqueSensorCfg"],
        "frame_pose": ["FramePoseSensor", "FramePoseSensorCfg"],
        "imu": ["ImuSensor", "ImuSensorCfg"],
        "joint_torque": ["JointTorqueSensor", "JointTorqueSensorCfg"],
        "ray_patterns": ["RayFanCfg", "RayGridCfg", "RayPatternCfg"],
        "ray_sensors": [
            "HeightScanSensor",
            "HeightScanSensorCfg",
            "RayCastCfg",
            "RaySensor",
            "RaySensorCfg",
        ],
    },
)

__all__ = [
    "CAMERA_IMAGES",
    "SENSORS",
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
    "LastStepSensor",
    "LinksCfg",
    "OffsetCfg",
    "RayCastCfg",
    "RayFanCfg",
    "RayGridCfg",
    "RayPatternCfg",
    "RaySensor",
    "RaySensorCfg",
    "SensorCfg",
    "StereoCamera",
    "StereoCameraCfg",
    "add_frame_sensors",
    "register_sensor",
]

"""Sensors for the UR10 scene of the tests, and parameters of every built-in term that reads one."""

from typing import Any

from embodichain.lab.gym.envs.cfg import ObservationCfg
from embodichain.lab.sim.sensors import (
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
    RayGridCfg,
    RayPatternCfg,
    RaySensorCfg,
)

SENSORS = {
    "contacts": ContactSensorCfg(entity_cfg=LinksCfg(uid="cube")),
    "pinch": ContactSensorCfg(
        entity_cfg=LinksCfg(uid="ur10", link_names=["forearm_link", "wrist_3_link"])
    ),
    "imu": ImuSensorCfg(entity_cfg=LinksCfg(uid="ur10", link_names="ee_link")),
    "wrench": ForceTorqueSensorCfg(entity_cfg=LinksCfg(uid="ur10", link_names="wrist_3_link")),
    "front": CameraCfg(
        width=16,
        height=12,
        data_types=["color", "mask", "position"],
        extrinsics=ExtrinsicsCfg(eye=(2, -2, 2), target=(0.5, 0, 0.5)),
    ),
    "scan": HeightScanSensorCfg(
        entity_cfg=LinksCfg(uid="ur10", link_names="ee_link"),
        pattern=RayPatternCfg(grid=RayGridCfg(size=(0.2, 0.2), resolution=0.1)),
        rate=10.0,
    ),
    "ray": RaySensorCfg(
        entity_cfg=LinksCfg(uid="ur10", link_names="ee_link"),
        pattern=RayPatternCfg(directions=[(1, 0, 0), (0, 1, -1), (0, 0, -1)]),
    ),
    "frame": FramePoseSensorCfg(
        entity_cfg=LinksCfg(uid="cube"), relative_to=LinksCfg(uid="ur10", link_names="ee_link")
    ),
    "torque": JointTorqueSensorCfg(entity_cfg=JointsCfg(uid="ur10"), rate=12.0),
}
READ = {
    "contact_found": "contacts",
    "contact_force": "contacts",
    "largest_contact_force": "contacts",
    "grasped": "pinch",
    "imu_acceleration": "imu",
    "imu_angular_velocity": "imu",
    "imu_orientation": "imu",
    "imu_projected_gravity": "imu",
    "body_incoming_wrench": "wrench",
    "height_scan": "scan",
    "sensor_reading": "ray",
}
OBSERVATIONS = {
    name: ObservationCfg(func=name, params={"sensor": sensor}) for name, sensor in READ.items()
} | {
    f"{sensor}_{reading}": ObservationCfg(
        func="sensor_reading", params={"sensor": sensor, "reading": reading}
    )
    for sensor, reading in (
        ("frame", "position"),
        ("frame", "linear_velocity"),
        ("torque", "torque"),
    )
}
OBSERVATIONS |= {
    "camera_image": ObservationCfg(func="camera_image", params={"sensor": "front"}, group="seen"),
    "camera_mask": ObservationCfg(
        func="camera_mask", params={"sensor": "front", "entity_cfg": {"uid": "cube"}}, group="seen"
    ),
    "camera_points": ObservationCfg(func="camera_points", params={"sensor": "front", "every": 4}),
    "camera_pose": ObservationCfg(func="camera_pose", params={"sensor": "front"}),
    "camera_intrinsics": ObservationCfg(func="camera_intrinsics", params={"sensor": "front"}),
}
TOUCH = {"sensor": "contacts", "threshold": 1.0}
REWARDS: dict[str, dict[str, Any]] = {
    "undesired_contacts": TOUCH,
    "desired_contacts": TOUCH,
    "contact_forces": TOUCH,
    "feet_slide": TOUCH,
    "feet_air_time": {"sensor": "contacts", "command_name": "velocity", "threshold": 0.1},
    "feet_gait": {
        "sensor": "contacts",
        "command_name": "velocity",
        "period_s": 0.5,
        "offsets": [0],
    },
}
TERMINATIONS: dict[str, dict[str, Any]] = {
    "illegal_contact": {"sensor": "contacts", "threshold": 1e9},
}

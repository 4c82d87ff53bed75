"""Configs of sensors: pure data. Cameras are accepted, and refused when a scene is built."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from embodichain.lab.sim.cfg import Four, ObjectBaseCfg, Quat, Vec3
from embodichain.utils.configclass import configclass
from embodichain.utils.type_errors import from_dict, member_from_dict

__all__ = [
    "AnySensorCfg",
    "CameraCfg",
    "ContactSensorCfg",
    "ForceTorqueSensorCfg",
    "ImuSensorCfg",
    "LinksCfg",
    "SensorCfg",
    "StereoCameraCfg",
    "no_camera",
    "readings",
]


@configclass
class LinksCfg:
    """An entity and, optionally, some of its links.

    Links are in the entity's order, or with `preserve_order` in the order of the patterns.
    """

    uid: str = ""
    link_names: str | list[str] | None = None
    """Names or regexes, matched in full."""
    preserve_order: bool = False


@configclass
class SensorCfg:
    """Base of all sensors; `sensor_type` names the concrete one."""

    sensor_type: str = ""
    uid: str | None = None
    """Its key in a task."""
    entity_cfg: LinksCfg = LinksCfg()
    """The links it is fixed on."""
    observe: bool = False
    """Whether ``obs["sensor"][uid]`` contains its data; terms can read it in either case."""
    rate: float | None = None
    """Hz of simulated time; between measurements, reads return the last one. None measures at every
    read. A reset measures anew."""

    @classmethod
    def from_dict(cls, init_dict: dict[str, Any]) -> SensorCfg:
        """Build the sensor that ``init_dict["sensor_type"]`` names.

        Raises:
            ConfigError: If the type or a key is unknown; lists what exists.
        """
        built: SensorCfg = (
            from_dict(cls, init_dict)
            if cls is not SensorCfg
            else member_from_dict(_SENSORS, "sensor_type", init_dict)
        )
        return built


@configclass
class ContactSensorCfg(SensorCfg):
    """Contact of links: whether each is touched, and the net contact force on it."""

    sensor_type: Literal["contact"] = "contact"
    against: LinksCfg | None = None
    """Count contacts with this entity (or links of it, or ``default_plane``) only."""


@configclass
class ImuSensorCfg(SensorCfg):
    """An inertial measurement unit on one link (without `link_names`, on the root)."""

    sensor_type: Literal["imu"] = "imu"
    pos: Vec3 = (0.0, 0.0, 0.0)
    """Its position, metres in the link's frame."""
    quat: Quat = (1.0, 0.0, 0.0, 0.0)
    """Its orientation, wxyz in the link's frame."""


@configclass
class ForceTorqueSensorCfg(SensorCfg):
    """Force and torque that parents exert on links."""

    sensor_type: Literal["force_torque"] = "force_torque"


_SENSORS: dict[str, type[SensorCfg]] = {
    "contact": ContactSensorCfg,
    "imu": ImuSensorCfg,
    "force_torque": ForceTorqueSensorCfg,
}

_READINGS = {
    "contact": ("found", "force"),
    "imu": ("orientation", "angular_velocity", "acceleration", "projected_gravity"),
    "force_torque": ("force", "torque"),
}


def readings(cfg: SensorCfg) -> tuple[str, ...]:
    """Return the names of the entries of a sensor's `get_data`."""
    return _READINGS.get(cfg.sensor_type, ())


AnySensorCfg = Annotated[
    ContactSensorCfg | ImuSensorCfg | ForceTorqueSensorCfg, Field(discriminator="sensor_type")
]
"""The union that YAML is checked against; `sensor_type` selects the member."""


@configclass
class _OffsetCfg:
    """A pose in the frame of a link, or without one in the environment's frame."""

    pos: Vec3 = (0.0, 0.0, 0.0)
    quat: Quat = (1.0, 0.0, 0.0, 0.0)
    """wxyz."""
    parent: str | None = None
    """A link of the robot."""


@configclass
class _ExtrinsicsCfg(_OffsetCfg):
    """Pose of a camera, given directly or by eye and target points."""

    eye: Vec3 | None = None
    target: Vec3 | None = None
    up: Vec3 | None = None


@configclass
class CameraCfg(ObjectBaseCfg):
    """A camera. No camera is built yet: building one raises NotImplementedError."""

    OffsetCfg = _OffsetCfg
    ExtrinsicsCfg = _ExtrinsicsCfg

    sensor_type: str = "Camera"
    width: int = 640
    """Pixels."""
    height: int = 480
    near: float = 0.005
    """Metres."""
    far: float = 100.0
    intrinsics: Four = (600.0, 600.0, 320.0, 240.0)
    """fx, fy, cx, cy in pixels."""
    extrinsics: _ExtrinsicsCfg = _ExtrinsicsCfg()
    enable_color: bool = True
    enable_depth: bool = False
    enable_mask: bool = False
    enable_normal: bool = False
    enable_position: bool = False


@configclass
class StereoCameraCfg(CameraCfg):
    """Two cameras side by side; see `CameraCfg`."""

    sensor_type: str = "StereoCamera"
    intrinsics_right: Four = (600.0, 600.0, 320.0, 240.0)
    left_to_right_pos: Vec3 = (0.05, 0.0, 0.0)
    """Metres."""
    left_to_right_rot: Vec3 = (0.0, 0.0, 0.0)
    """Degrees."""
    enable_disparity: bool = False


def no_camera(cfg: Any) -> NotImplementedError:
    """Return the error for building a camera."""
    return NotImplementedError(
        f"sensor {cfg.uid!r}: cameras are not available yet ({type(cfg).__name__}); leave it out. "
        "Pictures: SimulationManager.render, the event record_camera_data"
    )

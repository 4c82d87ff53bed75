"""Configs of sensors: pure data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import Field

from embodichain.lab.sim.configs.references import OF, JointsCfg, LinksCfg
from embodichain.lab.sim.configs.scene_cfg import Four, Quat, Vec3
from embodichain.utils.configclass import configclass
from embodichain.utils.fields.type_errors import from_dict, member_from_dict

__all__ = [
    "CAMERA_IMAGES",
    "AnySensorCfg",
    "CameraCfg",
    "ContactSensorCfg",
    "ExtrinsicsCfg",
    "ForceTorqueSensorCfg",
    "FramePoseSensorCfg",
    "HeightScanSensorCfg",
    "ImuSensorCfg",
    "JointTorqueSensorCfg",
    "JointsCfg",
    "LinksCfg",
    "OffsetCfg",
    "RayCastCfg",
    "RayFanCfg",
    "RayGridCfg",
    "RayPatternCfg",
    "RaySensorCfg",
    "SensorCfg",
    "StereoCameraCfg",
    "readings",
]

_Pair = Annotated[Sequence[float], Field(min_length=2, max_length=2)]


@configclass
class SensorCfg:
    """Base of all sensors; `sensor_type` names the concrete one."""

    other_names: ClassVar[dict[str, str]] = {"entity_cfg": "of"}
    """Other names of keys -> the keys."""
    sensor_type: str = ""
    uid: str | None = None
    """Its key in a task."""
    of: Annotated[LinksCfg, OF] = LinksCfg()
    """The links, sites or geoms it is fixed on."""
    observe: bool = False
    """Whether ``obs["sensor"][uid]`` contains its data; terms can read it in either case."""
    rate: float | None = None
    """Hz of simulated time; between measurements, reads return the last one. None measures at every
    read. A reset measures anew."""

    @property
    def entity_cfg(self) -> LinksCfg:
        """Another name of `of`."""
        return self.of

    @entity_cfg.setter
    def entity_cfg(self, reference: LinksCfg) -> None:
        self.of = reference

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
    """Contact of links or geoms: whether each is touched, and the net contact force on it."""

    sensor_type: Literal["contact"] = "contact"
    against: LinksCfg | None = None
    """Count contacts with this entity (or links or geoms of it, or ``default_plane``) only."""
    history_length: Annotated[int, Field(ge=1)] | None = None
    """Number of last physics steps of which terms that ask whether there is contact
    (`contact_found`, `feet_air_time`) take the largest force; None is those of a control step.
    Readings of the sensor are those of the last one."""


@configclass
class ImuSensorCfg(SensorCfg):
    """An inertial measurement unit on one link, site or geom; by default on the root."""

    sensor_type: Literal["imu"] = "imu"
    pos: Vec3 = (0.0, 0.0, 0.0)
    """Its position, metres in the frame of that link, site or geom."""
    quat: Quat = (1.0, 0.0, 0.0, 0.0)
    """Its orientation, wxyz in that frame."""


@configclass
class ForceTorqueSensorCfg(SensorCfg):
    """Force and torque that parents exert on links: at their origins, or at sites or geoms."""

    sensor_type: Literal["force_torque"] = "force_torque"


@configclass
class FramePoseSensorCfg(SensorCfg):
    """Pose and velocity of a frame: of one link (by default the root), site or geom."""

    sensor_type: Literal["frame_pose"] = "frame_pose"
    site: str | None = None
    """A site: the same as ``of.site``."""
    pos: Vec3 = (0.0, 0.0, 0.0)
    """The frame's origin, metres in the frame of that link, site or geom."""
    quat: Quat = (1.0, 0.0, 0.0, 0.0)
    """The frame's orientation, wxyz in that frame."""
    relative_to: LinksCfg | None = None
    """A link (by default the root), site or geom in whose frame to measure; None is the world."""


@configclass
class JointTorqueSensorCfg(SensorCfg):
    """Generalized forces at joints: N m of hinges, N of slides."""

    sensor_type: Literal["joint_torque"] = "joint_torque"
    of: Annotated[JointsCfg, OF] = JointsCfg()
    """The joints."""


@configclass
class RayGridCfg:
    """Parallel rays that start on a grid in the x-y plane, centred on the origin."""

    size: _Pair
    """Lengths along x and y, metres."""
    resolution: float
    """Distance between neighbours, metres."""
    direction: Vec3 = (0.0, 0.0, -1.0)


@configclass
class RayFanCfg:
    """Rays from the origin at even angles: of a planar or rotating range finder."""

    horizontal_range: _Pair = (-math.pi, math.pi)
    """Lowest and highest azimuth, rad from x towards y. A full turn has no ray twice."""
    horizontal_count: int = 36
    vertical_range: _Pair = (0.0, 0.0)
    """Lowest and highest elevation, rad from the x-y plane towards z."""
    vertical_count: int = 1


@configclass
class RayPatternCfg:
    """Rays in a sensor's frame; exactly one of the keys."""

    grid: RayGridCfg | None = None
    fan: RayFanCfg | None = None
    directions: list[Vec3] | None = None
    """Of rays from the origin; any length but zero."""


@configclass
class RayCastCfg(SensorCfg):
    """Rays from one link (by default the root), site or geom; without `uid` from a fixed place."""

    pattern: RayPatternCfg = RayPatternCfg()
    pos: Vec3 = (0.0, 0.0, 0.0)
    """The sensor's origin, metres in the frame that `alignment` chooses."""
    quat: Quat = (1.0, 0.0, 0.0, 0.0)
    """The sensor's orientation in that frame, wxyz."""
    alignment: Literal["base", "yaw", "world"] = "base"
    """Axes at that origin: of the link, site or geom, of its heading (z up), or of the world."""
    max_range: float = 10.0
    """Metres; surfaces further away count as not hit."""
    no_hit: Literal["max", "inf", "zero"] = "max"
    """Reading of a ray that hits nothing: as at `max_range`, infinity or 0."""
    hit: list[str] | None = None
    """Uids of the entities that rays can hit (or ``default_plane``); None is everything."""
    exclude: list[str] | None = None
    """Uids of entities that rays pass through; None is the entity that the sensor is fixed on."""
    geom_groups: list[int] = [0, 1, 2]
    """Groups of geoms that rays can hit: 0 to 2 are drawn, collision geoms are often in 3."""


RayReading = Literal["distance", "position", "normal"]


@configclass
class RaySensorCfg(RayCastCfg):
    """A range finder: distances along rays."""

    sensor_type: Literal["ray"] = "ray"
    data_types: list[RayReading] = ["distance"]
    """Entries of `get_data`."""


@configclass
class HeightScanSensorCfg(RayCastCfg):
    """Heights of the sensor above the surface below it, on a grid."""

    sensor_type: Literal["height_scan"] = "height_scan"
    pattern: RayPatternCfg = RayPatternCfg(grid=RayGridCfg(size=(1.6, 1.0), resolution=0.1))
    alignment: Literal["base", "yaw", "world"] = "yaw"
    start_height: float = 1.0
    """Metres above the sensor where rays start, so that higher ground beside it is found."""


CameraData = Literal["color", "depth", "distance", "mask", "normal", "position", "disparity"]
CAMERA_IMAGES: tuple[str, ...] = get_args(CameraData)
"""All names of images."""
_IMAGES: tuple[CameraData, ...] = ("color", "depth", "distance", "mask", "normal", "position")


@configclass
class OffsetCfg:
    """A pose in the frame of a link, site or geom, or without one in the environment's frame."""

    pos: Vec3 = (0.0, 0.0, 0.0)
    """Metres."""
    quat: Quat = (1.0, 0.0, 0.0, 0.0)
    """wxyz; see `CameraCfg.convention`."""
    parent: str | None = None
    """A link, site or geom: of the only robot, or ``UID/NAME``. `CameraCfg.of` names one as
    well."""


@configclass
class ExtrinsicsCfg(OffsetCfg):
    """Pose of a camera: `pos` and `quat`, or `eye` and `target`."""

    eye: Vec3 | None = None
    """Its position, metres."""
    target: Vec3 | None = None
    """The point in the middle of the picture, in the same frame."""
    up: Vec3 | None = None
    """The direction that is up in the picture; None is z."""


_Extrinsics = ExtrinsicsCfg  # the name is also that of an attribute below


@configclass
class CameraCfg(SensorCfg):
    """A pinhole camera. Its pose is in the frame of the link, site or geom that it is fixed on.

    It is compiled into the model as a camera of its name.
    """

    OffsetCfg: ClassVar[type] = OffsetCfg
    ExtrinsicsCfg: ClassVar[type] = ExtrinsicsCfg

    sensor_type: Literal["camera", "Camera"] = "camera"
    width: int = 640
    """Pixels."""
    height: int = 480
    """Pixels."""
    near: float = 0.005
    """Metres along the axis: nothing nearer is drawn."""
    far: float = 100.0
    """Metres along the axis: nothing farther is drawn."""
    fovy: float | None = None
    """Vertical field of view in degrees; pixels are square and the axis is in the middle."""
    intrinsics: Four | None = None
    """fx, fy, cx, cy in pixels, from the top left corner, instead of `fovy`. With neither, fx and
    fy are 1.25 heights and the axis is in the middle."""
    camera: str | None = None
    """A camera of an entity's file, ``UID/NAME``, or a view of the task, with the pose and the lens
    that it has there."""
    extrinsics: _Extrinsics = _Extrinsics()
    convention: Literal["opengl", "ros"] | None = None
    """Axes of `extrinsics.quat`. opengl: x right, y up, view along -z. ros: x right, y down, view
    along z. None is opengl."""
    data_types: list[CameraData] | None = None
    """The images; None is ``[color]``."""
    no_hit: Literal["zero", "far", "inf"] = "zero"
    """Depth and distance where nothing is drawn: 0, `far`, or infinity."""
    look: Literal["fast", "full"] = "fast"
    """fast: for observations. full: with shadows, highlights and smooth edges."""
    enable_color: bool = True
    """Has no effect if `data_types` is given."""
    enable_depth: bool = False
    """Adds to `data_types`, as do the following."""
    enable_mask: bool = False
    enable_normal: bool = False
    enable_position: bool = False

    def get_data_types(self) -> list[str]:
        """Return the names of its images."""
        wanted = set(self.data_types if self.data_types is not None else ())
        wanted |= {name for name in _IMAGES if getattr(self, f"enable_{name}", False)}
        if self.data_types is not None and "color" not in self.data_types:
            wanted.discard("color")
        return [name for name in _IMAGES if name in wanted]


@configclass
class StereoCameraCfg(CameraCfg):
    """Two cameras; `extrinsics` is the pose of the point halfway between them."""

    sensor_type: Literal["stereo_camera", "StereoCamera"] = "stereo_camera"  # type: ignore[assignment]
    intrinsics_right: Four | None = None
    """Those of the right camera; None is the left one's."""
    left_to_right_pos: Vec3 = (0.05, 0.0, 0.0)
    """From the left to the right camera: metres, along the camera's axes."""
    left_to_right_rot: Vec3 = (0.0, 0.0, 0.0)
    """Orientation of the right camera in the left one's axes: Euler angles in degrees, intrinsic
    XYZ."""
    enable_disparity: bool = False

    def get_data_types(self) -> list[str]:
        """Return the names of its images: ``NAME``, ``NAME_right``, and ``disparity``."""
        images = super().get_data_types()
        found = [name + side for name in images for side in ("", "_right")]
        asked = self.data_types is not None and "disparity" in self.data_types
        return [*found, "disparity"] if asked or self.enable_disparity else found


_SENSORS: dict[str, type[SensorCfg]] = {
    "contact": ContactSensorCfg,
    "imu": ImuSensorCfg,
    "force_torque": ForceTorqueSensorCfg,
    "frame_pose": FramePoseSensorCfg,
    "joint_torque": JointTorqueSensorCfg,
    "ray": RaySensorCfg,
    "height_scan": HeightScanSensorCfg,
    "camera": CameraCfg,
    "stereo_camera": StereoCameraCfg,
    # EmbodiChain's names
    "Camera": CameraCfg,
    "StereoCamera": StereoCameraCfg,
}

_READINGS: dict[str, tuple[str, ...]] = {
    "contact": ("found", "force"),
    "imu": ("orientation", "angular_velocity", "acceleration", "projected_gravity"),
    "force_torque": ("force", "torque"),
    "frame_pose": ("position", "orientation", "linear_velocity", "angular_velocity"),
    "joint_torque": ("torque", "actuator", "passive", "constraint"),
    "height_scan": ("height",),
}


def readings(cfg: SensorCfg) -> tuple[str, ...]:
    """Return the names of the entries of a sensor's `get_data`."""
    if isinstance(cfg, RaySensorCfg):
        return tuple(cfg.data_types)
    if isinstance(cfg, CameraCfg):
        return tuple(cfg.get_data_types())
    return _READINGS.get(cfg.sensor_type, ())


AnySensorCfg = Annotated[
    ContactSensorCfg
    | ImuSensorCfg
    | ForceTorqueSensorCfg
    | FramePoseSensorCfg
    | JointTorqueSensorCfg
    | RaySensorCfg
    | HeightScanSensorCfg
    | CameraCfg
    | StereoCameraCfg,
    Field(discriminator="sensor_type"),
]
"""The union that YAML is checked against; `sensor_type` selects the member."""

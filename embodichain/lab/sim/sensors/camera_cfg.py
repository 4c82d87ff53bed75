"""Configs of cameras, and their checks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, get_args

import numpy as np
from pydantic import Field

from embodichain.lab.sim.configs.references import LinksCfg
from embodichain.lab.sim.configs.scene_cfg import Vec3
from embodichain.lab.sim.configs.sensor_cfg import SensorCfg
from embodichain.utils.configclass import configclass
from embodichain.utils.errors import Problem
from embodichain.utils.fields.value_checks import are_finite, is_positive, require
from embodichain.utils.math import look_at
from embodichain.utils.system import platforms

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.index import F64

__all__ = [
    "CAMERA_IMAGES",
    "HAS_ITS_OWN",
    "SAID_BY_EYE",
    "CameraCfg",
    "ExtrinsicsCfg",
    "OffsetCfg",
    "StereoCameraCfg",
    "check_camera",
    "look_points",
]

HAS_ITS_OWN = "camera {!r} has its own: leave it out"
SAID_BY_EYE = "eye and target are given as well: leave one of them out"
_LARGEST = 16384
"""Pixels; the largest texture of common OpenGL drivers."""
_BYTES = {"color": 4, "normal": 12, "position": 12}
"""Bytes of a pixel of an image; 4 for the others."""

_Pixels = Annotated[
    int,
    require(
        f"must be within 1 and {_LARGEST} pixels, got {{}}", lambda pixels: 1 <= pixels <= _LARGEST
    ),
]
_Finite3 = Annotated[
    Sequence[float],
    Field(min_length=3, max_length=3),
    require("must be finite, got {}", are_finite),
]
_Orientation = Annotated[
    Sequence[float],
    Field(min_length=4, max_length=4),
    require("must be finite, got {}", are_finite),
    require("must not be zero: it is a rotation, wxyz", any),
]
_Lens = Annotated[
    Sequence[float],
    Field(min_length=4, max_length=4),
    require(
        "fx, fy, cx, cy in pixels, finite, fx and fy positive; got {}",
        lambda lens: are_finite(lens) and min(lens[:2]) > 0,
    ),
]
_Offset = Annotated[
    Sequence[float],
    Field(min_length=3, max_length=3),
    require(
        "must be finite and not zero, metres, got {}", lambda pos: are_finite(pos) and any(pos)
    ),
]
CameraData = Literal["color", "depth", "distance", "mask", "normal", "position", "disparity"]
CAMERA_IMAGES: tuple[str, ...] = get_args(CameraData)
"""All names of images."""
_IMAGES: tuple[CameraData, ...] = ("color", "depth", "distance", "mask", "normal", "position")


@configclass
class OffsetCfg:
    """A pose in the frame of a link, site or geom, or without one in the environment's frame."""

    pos: _Finite3 = (0.0, 0.0, 0.0)
    """Metres."""
    quat: _Orientation = (1.0, 0.0, 0.0, 0.0)
    """wxyz; see `CameraCfg.convention`."""
    parent: str | None = None
    """A link, site or geom: of the only robot, or ``UID/NAME``. `CameraCfg.of` names one as
    well."""


@configclass
class ExtrinsicsCfg(OffsetCfg):
    """Pose of a camera: `pos` and `quat`, or `eye` and `target`."""

    eye: _Finite3 | None = None
    """Its position, metres."""
    target: _Finite3 | None = None
    """The point in the middle of the picture, in the same frame."""
    up: _Finite3 | None = None
    """The direction that is up in the picture; None is z."""


_Extrinsics = ExtrinsicsCfg  # the name is also that of an attribute below


@configclass
class CameraCfg(SensorCfg):
    """A pinhole camera. Its pose is in the frame of the link, site or geom that it is fixed on.

    It is compiled into the model as a camera of its name.
    """

    reads_images: ClassVar[bool] = True

    OffsetCfg: ClassVar[type] = OffsetCfg
    ExtrinsicsCfg: ClassVar[type] = ExtrinsicsCfg

    sensor_type: Literal["camera", "Camera"] = "camera"
    width: _Pixels = 640
    """Pixels."""
    height: _Pixels = 480
    """Pixels."""
    near: Annotated[float, require("must be positive, metres, got {}", is_positive)] = 0.005
    """Metres along the axis: nothing nearer is drawn."""
    far: Annotated[float, require("must be finite, metres, got {}", math.isfinite)] = 100.0
    """Metres along the axis: nothing farther is drawn."""
    fovy: (
        Annotated[
            float,
            require(
                "must be greater than 0 and less than 180 degrees, got {}",
                lambda fovy: 0 < fovy < 180,
            ),
        ]
        | None
    ) = None
    """Vertical field of view in degrees; pixels are square and the axis is in the middle."""
    intrinsics: _Lens | None = None
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

    def readings(self) -> tuple[str, ...]:
        """Return the names of its images."""
        return tuple(self.get_data_types())

    def check(self) -> list[Problem]:
        """Check that its lens, its images, its pose and its camera of a file go together."""
        return check_camera(self)

    def check_memory(self, num_envs: int) -> list[Problem]:
        """Return a problem if its images of all N environments exceed the memory."""
        return _check_memory(self, num_envs)

    def get_data_types(self) -> list[str]:
        """Return the names of its images."""
        names = set(self.data_types or ())
        names |= {name for name in _IMAGES if getattr(self, f"enable_{name}", False)}
        if self.data_types is not None and "color" not in self.data_types:
            names.discard("color")
        return [name for name in _IMAGES if name in names]


@configclass
class StereoCameraCfg(CameraCfg):
    """Two cameras; `extrinsics` is the pose of the point halfway between them."""

    sensor_type: Literal["stereo_camera", "StereoCamera"] = "stereo_camera"  # type: ignore[assignment]
    intrinsics_right: _Lens | None = None
    """Those of the right camera; None is the left one's."""
    left_to_right_pos: _Offset = (0.05, 0.0, 0.0)
    """From the left to the right camera: metres, along the camera's axes."""
    left_to_right_rot: Vec3 = (0.0, 0.0, 0.0)
    """Orientation of the right camera in the left one's axes: Euler angles in degrees, intrinsic
    XYZ."""
    enable_disparity: bool = False

    def get_data_types(self) -> list[str]:
        """Return the names of its images: ``NAME``, ``NAME_right``, and ``disparity``."""
        names: list[str] = []
        for name in super().get_data_types():
            names += [name, f"{name}_right"]
        if self.enable_disparity or "disparity" in (self.data_types or ()):
            names.append("disparity")
        return names


# -- checks ----------------------------------------------------------------------------------------


def check_camera(cfg: CameraCfg) -> list[Problem]:
    """Return the mistakes in a camera's config that it alone shows, with paths below it."""
    problems: list[Problem] = []
    if cfg.fovy is not None and cfg.intrinsics is not None:
        problems.append(Problem("intrinsics", "fovy is given as well: leave one of them out"))
    if not cfg.near < cfg.far:
        problems.append(Problem("far", f"must be greater than near, {cfg.near} m, got {cfg.far}"))
    is_stereo = isinstance(cfg, StereoCameraCfg)
    if not is_stereo and "disparity" in (cfg.data_types or ()):
        problems.append(Problem("data_types", "disparity is an image of a stereo_camera"))
    elif not cfg.get_data_types():
        problems.append(Problem("data_types", "names no image; leave it out for [color]"))
    has_reference = cfg.of != LinksCfg(preserve_order=cfg.of.preserve_order)
    if has_reference and not cfg.of.uid:
        message = "missing: the entity that has the links, sites or geoms"
        problems.append(Problem("of.uid", message))
    if cfg.camera is None:
        return problems + _check_extrinsics(cfg.extrinsics)
    if is_stereo:
        problems.append(Problem("camera", "a stereo_camera has two cameras: leave it out"))
    # What the camera of a file has already.
    values = {
        "fovy": cfg.fovy,
        "intrinsics": cfg.intrinsics,
        "of": cfg.of.uid,
        "convention": cfg.convention,
        "extrinsics": cfg.extrinsics != ExtrinsicsCfg(),
    }
    message = HAS_ITS_OWN.format(cfg.camera)
    return problems + [Problem(key, message) for key, value in values.items() if value]


def _check_extrinsics(cfg: ExtrinsicsCfg) -> list[Problem]:
    problems: list[Problem] = []
    if cfg.eye is None and cfg.target is None:
        if cfg.up is not None:
            problems.append(Problem("extrinsics.up", "belongs to eye and target"))
        return problems
    for key, other in (("eye", "target"), ("target", "eye")):
        if getattr(cfg, key) is None:
            message = f"missing: {other} is given, and the pose needs both"
            problems.append(Problem(f"extrinsics.{key}", message))
    default = ExtrinsicsCfg()
    for key in ("pos", "quat"):
        if list(getattr(cfg, key)) != list(getattr(default, key)):
            problems.append(Problem(f"extrinsics.{key}", SAID_BY_EYE))
    if not problems:
        try:
            look_at(*look_points(cfg))
        except ValueError as error:
            problems.append(Problem("extrinsics.target", str(error)))
    return problems


def _check_memory(cfg: CameraCfg, num_envs: int) -> list[Problem]:
    """Return a problem if a camera's images of all N environments exceed the memory."""
    limit = platforms.memory_bytes()
    images = cfg.get_data_types()
    each = sum(_BYTES.get(name.removesuffix("_right"), 4) for name in images)
    needed = each * cfg.width * cfg.height * num_envs
    if needed <= limit:
        return []
    message = (
        f"{num_envs} environments x {cfg.width} x {cfg.height} pixels of "
        f"{', '.join(images)} need {needed / 2**30:.1f} GiB; there are {limit / 2**30:.1f}"
    )
    return [Problem("width", message)]


def look_points(cfg: ExtrinsicsCfg) -> tuple[F64, F64, F64]:
    """Return eye, target and the direction that is up, (3,) each."""
    up = (0.0, 0.0, 1.0) if cfg.up is None else cfg.up
    eye, target, above = (np.asarray(v, np.float64) for v in (cfg.eye, cfg.target, up))
    return eye, target, above

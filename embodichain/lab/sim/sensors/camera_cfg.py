"""Configs of EmbodiChain's cameras: accepted everywhere, refused when a scene is built of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import Field

from embodichain.lab.sim.cfg import ObjectBaseCfg, Vec3
from embodichain.utils.configclass import configclass

__all__ = ["CameraCfg", "StereoCameraCfg", "no_camera"]

_Intrinsics = Annotated[Sequence[float], Field(min_length=4, max_length=4)]


@configclass
class _OffsetCfg:
    """A pose in the frame of a link, or of the environment without one."""

    pos: Vec3 = (0.0, 0.0, 0.0)
    quat: Annotated[Sequence[float], Field(min_length=4, max_length=4)] = (1.0, 0.0, 0.0, 0.0)
    """wxyz."""
    parent: str | None = None
    """A link of the robot."""


@configclass
class _ExtrinsicsCfg(_OffsetCfg):
    """Where a camera is: a pose, or the point it looks at."""

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
    intrinsics: _Intrinsics = (600.0, 600.0, 320.0, 240.0)
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
    intrinsics_right: _Intrinsics = (600.0, 600.0, 320.0, 240.0)
    left_to_right_pos: Vec3 = (0.05, 0.0, 0.0)
    """Metres."""
    left_to_right_rot: Vec3 = (0.0, 0.0, 0.0)
    """Degrees."""
    enable_disparity: bool = False


def no_camera(cfg: Any) -> NotImplementedError:
    """Return the error of a camera that is to be built."""
    return NotImplementedError(
        f"sensor {cfg.uid!r}: cameras are not available yet ({type(cfg).__name__}); leave it out. "
        "Pictures: SimulationManager.render, the event record_camera_data"
    )

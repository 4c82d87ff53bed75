"""Quantities of cameras: images for networks, points, poses and lenses.

Cameras are declared under `sensors:`. Images have channels first, as networks for images take them;
observations contain them as they are and never in a flat vector.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from embodichain.lab.gym.envs.managers.param_types import CameraOf, Positive, Whole
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.managers.terms.registry import quantity
from embodichain.utils.arrays import contiguous
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.sensors.camera import Camera
    from embodichain.utils.array_types import Floats

__all__ = ["CameraImage", "CameraMask", "CameraPoints", "camera_intrinsics", "camera_pose"]

Side = Literal["left", "right"]


def _image_name(sensor: Camera, kind: str, side: Side, key: str) -> str:
    """Return the name of a camera's image.

    Args:
        sensor: The camera.
        kind: What is drawn, such as ``color``.
        side: The eye.
        key: The parameter that asks for the image, for the message.

    Raises:
        ConfigError: If the camera's config does not ask for this image.
    """
    name = kind if side == "left" else f"{kind}_right"
    if name not in sensor.reads:
        data_types = ", ".join(sensor.reads)
        message = f"sensor {sensor.uid!r} has no image {name!r}; its data_types: {data_types}"
        raise ConfigError([Problem(key, message, did_you_mean(name, sensor.reads).strip())])
    return name


@quantity("observation", name="camera_image")
class CameraImage(Term):
    """(N, C, H, W) an image of a camera: uint8 RGB, float32 or uint8 depth, int32 masks.

    With `history_length` K it is (N, K C, H, W), the oldest image first; noise on integers is
    rounded and clipped to their type.

    Args:
        sensor: A camera.
        channels: ``color`` (3 channels), ``depth`` in metres, or ``mask`` with the numbers of
            entities (1 channel each).
        max_depth: Metres; if given, depth is uint8: 255 at this depth and beyond. Images of uint8
            are what Stable-Baselines3 gives to convolutions.
        side: ``right`` is a stereo camera's other eye.

    Example:
        ``{func: camera_image, params: {sensor: front, channels: color}, delay: [1, 2]}``
    """

    reads_images = True

    def __init__(
        self,
        env: TermContext,
        sensor: CameraOf,
        channels: Literal["color", "depth", "mask"] = "color",
        max_depth: Positive | None = None,
        side: Side = "left",
    ) -> None:
        if max_depth is not None and channels != "depth":
            raise ConfigError([Problem("max_depth", f"belongs to depth, not to {channels}")])
        self._sensor = sensor
        self._max_depth = max_depth
        self._is_color = channels == "color"
        self._name = _image_name(sensor, channels, side, "channels")

    def __call__(self) -> NDArray[Any]:
        """(N, C, H, W)."""
        image = self._sensor.read(self._name)
        if self._is_color:
            return contiguous(np.moveaxis(image[..., :3], 3, 1))
        if self._max_depth is not None:
            share = np.minimum(image / np.float32(self._max_depth), np.float32(1.0))
            image = np.rint(share * np.float32(255.0)).astype(np.uint8)
        return image[:, None]


@quantity("observation", name="camera_mask")
class CameraMask(Term):
    """(N, 1, H, W) uint8: 255 where a camera sees an entity, else 0.

    Args:
        sensor: A camera with ``mask`` among its `data_types`.
        entity_cfg: The entity.
        side: ``right`` is a stereo camera's other eye.

    Example:
        ``{func: camera_mask, params: {sensor: front, of: {uid: cube}}}``
    """

    reads_images = True

    def __init__(
        self, env: TermContext, sensor: CameraOf, entity_cfg: Whole, side: Side = "left"
    ) -> None:
        self._sensor = sensor
        self._name = _image_name(sensor, "mask", side, "sensor")
        self._number = entity_cfg.asset.index.root_body_id

    def __call__(self) -> NDArray[np.uint8]:
        """(N, 1, H, W)."""
        is_visible = self._sensor.read(self._name) == self._number
        mask = is_visible.astype(np.uint8) * np.uint8(255)
        return mask[:, None]


@quantity("observation", name="camera_points")
class CameraPoints(Term):
    """(N, K, 3) points that a camera sees, m, environment's frame; 0 where nothing is drawn.

    Args:
        sensor: A camera with ``position`` among its `data_types`.
        every: Every how many rows and columns of pixels there is a point: K = ceil(H / every) x
            ceil(W / every).
        side: ``right`` is a stereo camera's other eye.

    Example:
        ``{func: camera_points, params: {sensor: front, every: 4}}``
    """

    def __init__(
        self,
        env: TermContext,
        sensor: CameraOf,
        every: Annotated[int, Field(ge=1)] = 1,
        side: Side = "left",
    ) -> None:
        self._sensor = sensor
        self._every = every
        self._name = _image_name(sensor, "position", side, "sensor")

    def __call__(self) -> NDArray[np.float32]:
        """(N, K, 3)."""
        points = self._sensor.read(self._name)[:, :: self._every, :: self._every]
        return points.reshape(len(points), -1, 3)


@quantity("observation")
def camera_pose(env: TermContext, sensor: CameraOf) -> Floats:
    """(N, 7) pose of a camera in the environment's frame: x, y, z in m, wxyz with OpenGL's axes.

    Args:
        sensor: A camera; of a stereo camera, the point halfway between its eyes.

    Example:
        ``{func: camera_pose, params: {sensor: wrist}}``
    """
    return np.concatenate(sensor.read_pose(), axis=1)


@quantity("observation")
def camera_intrinsics(env: TermContext, sensor: CameraOf, side: Side = "left") -> Floats:
    """(N, 4) fx, fy, cx, cy of a camera, pixels from the picture's top left corner.

    Args:
        sensor: A camera.
        side: ``right`` is a stereo camera's other eye.

    Example:
        ``{func: camera_intrinsics, params: {sensor: front}}``
    """
    eye = 1 if side == "right" else 0
    return sensor.read_intrinsics(eye)

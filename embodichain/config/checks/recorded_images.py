"""`check_images`: whether the cameras of `record.images` exist and can be recorded as wanted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import mujoco

from embodichain.lab.sim.drawing.views import camera_size
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean

__all__ = ["ImageChoice", "check_images"]

_KEY = "record.images"


class ImageChoice(Protocol):
    """The keys of `record.images` that depend on the scene."""

    @property
    def cameras(self) -> Sequence[str] | None:
        """Names of cameras; None is all camera sensors."""

    @property
    def format(self) -> str:
        """``h264``, ``jpeg`` or ``png``."""

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height in pixels; None is that of each camera."""


def check_images(
    chosen: ImageChoice,
    model: mujoco.MjModel,
    sensors: Mapping[str, tuple[int, tuple[int, int]]],
) -> list[Problem]:
    """Return a problem for each camera that cannot be recorded.

    Args:
        chosen: What is to be recorded.
        model: The compiled scene.
        sensors: Name of each picture of camera sensors to the id of the camera, and its size.
    """
    cameras = {model.camera(i).name: (i, camera_size(model, i)) for i in range(model.ncam)}
    cameras |= sensors
    listed = f"Cameras: {', '.join(cameras) or 'none'}"
    if chosen.cameras is None and not sensors:
        message = f"the task has no camera sensors: name cameras. {listed}"
        return [Problem(f"{_KEY}.cameras", message)]
    if chosen.cameras is not None and not chosen.cameras:
        message = f"names no camera; leave it out for all camera sensors. {listed}"
        return [Problem(f"{_KEY}.cameras", message)]
    problems: list[Problem] = []
    for index, name in enumerate(sensors if chosen.cameras is None else chosen.cameras):
        key = f"{_KEY}.cameras"
        if chosen.cameras is not None:
            key += f".{index}"
        if name not in cameras:
            hint = did_you_mean(name, cameras).strip()
            problems.append(Problem(key, f"no camera {name!r}. {listed}", hint))
            continue
        camera, camera_pixels = cameras[name]
        if model.cam_projection[camera] != int(mujoco.mjtProjection.mjPROJ_PERSPECTIVE):
            message = f"camera {name!r} is orthographic: only pinhole cameras can be drawn"
            problems.append(Problem(key, message))
        width, height = chosen.size or camera_pixels
        if chosen.format == "h264" and (width % 2 or height % 2):
            size = f"{name} has {width} x {height} pixels"
            message = f"h264 needs even widths and heights; {size}: set a size, or format: jpeg"
            problems.append(Problem(f"{_KEY}.size", message))
    return problems

"""`frames`: pictures of one recorded environment, several control steps in a call.

`cameras_of` finds the cameras of a log.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.configs.sensor_cfg import SensorCfg
from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.lab.sim.drawing.states import StoredStates
from embodichain.lab.sim.drawing.views import Look, View, Viewpoint, camera_size, view_of
from embodichain.lab.sim.sensors.camera_cfg import CameraCfg
from embodichain.lab.sim.sensors.camera_model import picture_names
from embodichain.recording.read.api import Log
from embodichain.recording.read.playback import Playback, Span
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

__all__ = ["FilmCamera", "Frame", "Placed", "cameras_of", "frames"]

_PIXELS = 200_000
"""Pixels of a call of the renderer; with more, a picture does not become cheaper."""


class FilmCamera(NamedTuple):
    """What films an environment.

    Attributes:
        camera: Name of a camera of the scene, a viewpoint, or a view.
        size: Width and height in pixels.
        look: ``fast`` or ``full``.
        near: Metres along the axis; None is the scene's.
        far: Likewise.
        marks: Whether it shows halos, what is reached, and commands, for people.
    """

    camera: str | Viewpoint | View
    size: tuple[int, int]
    look: Look = "full"
    near: float | None = None
    far: float | None = None
    marks: bool = False


class Placed(NamedTuple):
    """Where a camera is in a control step.

    Attributes:
        position: (3,) in metres.
        axes: (3, 3) rotation matrix: columns are right, up and backwards.
        lens: (4,) fx, fy, cx, cy in pixels.
    """

    position: NDArray[np.float64]
    axes: NDArray[np.float64]
    lens: NDArray[np.float64]


class Frame(NamedTuple):
    """The pictures of a control step.

    Attributes:
        step: The control step.
        pictures: (height, width, 3) RGB of each camera.
        cameras: Where each camera is.
    """

    step: int
    pictures: list[NDArray[np.uint8]]
    cameras: list[Placed]


def frames(
    renderer: OffscreenRenderer,
    playback: Playback,
    cameras: Sequence[FilmCamera],
    span: Span,
    every: int = 1,
) -> Iterator[Frame]:
    """Draw the environment at each step.

    Args:
        renderer: Of the playback's scene.
        playback: The environment, at its start.
        cameras: What films it.
        span: The control steps.
        every: Draw every `every`-th step, beginning with the first.

    Raises:
        LogError: See `Playback.steps`.
        RenderError: If colour cannot be drawn here.
        ValueError: If there is no such camera, or it is not a pinhole camera.
    """
    pixels_per_step = sum(math.prod(camera.size) for camera in cameras)
    steps_per_call = max(1, _PIXELS // pixels_per_step)
    states = StoredStates(playback.engine.model)
    steps: list[int] = []

    def draw() -> Iterator[Frame]:
        views = [_view(states, camera) for camera in cameras]
        colors = [pictures["color"][..., :3] for pictures in renderer.draw(states, views)]
        for row, step in enumerate(steps):
            yield Frame(
                step=step,
                pictures=[color[row] for color in colors],
                cameras=[_placed(view, row) for view in views],
            )
        states.clear()
        steps.clear()

    for step in playback.steps(span, every):
        states.append(playback.engine)
        steps.append(step)
        if len(steps) == steps_per_call:
            yield from draw()
    if steps:
        yield from draw()


def _placed(view: View, row: int) -> Placed:
    return Placed(
        position=_row_of(view.position, row),
        axes=_row_of(view.axes, row),
        lens=_row_of(view.lens, row),
    )


def _row_of(rows: Any, row: int) -> NDArray[np.float64]:
    """The values of a row; those that do not change between steps have only one."""
    return np.asarray(rows[min(row, len(rows) - 1)])


def _view(states: StoredStates, camera: FilmCamera) -> View:
    if isinstance(camera.camera, View):
        return camera.camera
    width, height = camera.size
    return view_of(
        states,
        camera.camera,
        width,
        height,
        near=camera.near,
        far=camera.far,
        look=camera.look,
        marks=camera.marks,
    )


def cameras_of(
    log: Log, names: Sequence[str] | None = None, size: tuple[int, int] | None = None
) -> dict[str, FilmCamera]:
    """Cameras of a log's task by name, to be drawn from states.

    Args:
        log: The log.
        names: Camera sensors, drawn in their look, or cameras of the scene, in full look; None is
            all camera sensors.
        size: Width and height in pixels; None is that of the sensor, or of the scene's camera.

    Raises:
        ConfigError: If there is no such camera.
    """
    sensors = _camera_sensors(log)
    model = log.model
    scene_sizes = {model.camera(i).name: camera_size(model, i) for i in range(model.ncam)}
    available = [*scene_sizes, *(name for name in sensors if name not in scene_sizes)]
    cameras = {}
    for name in sensors if names is None else dict.fromkeys(names):
        if name not in available:
            hint = did_you_mean(name, available)
            raise ConfigError(
                f"no camera {name!r}.{hint} Cameras: {', '.join(available) or 'none'}"
            )
        if name in sensors:
            camera, cfg = sensors[name]
            cameras[name] = FilmCamera(
                camera=camera,
                size=size or (cfg.width, cfg.height),
                look=cfg.look,
                near=cfg.near,
                far=cfg.far,
            )
        else:
            cameras[name] = FilmCamera(name, size or scene_sizes[name])
    return cameras


def _camera_sensors(log: Log) -> dict[str, tuple[str, CameraCfg]]:
    """Name of each picture of a log's camera sensors to the camera in the model, and the config."""
    task = log.config.get("task")
    if not isinstance(task, dict):
        return {}
    sensors: dict[str, tuple[str, CameraCfg]] = {}
    for uid, values in (task.get("sensors") or {}).items():
        cfg = SensorCfg.from_dict(values)
        if isinstance(cfg, CameraCfg):
            for name, camera in picture_names(uid, cfg).items():
                sensors[name] = (camera, cfg)
    return sensors

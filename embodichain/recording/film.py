"""`film_log`: renders a recorded environment to an MP4; needs the extra `video` and OpenGL (EGL).

It draws the recorded states; only states between keyframes are simulated.
"""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from embodichain.lab.sim.rendering import SceneRenderer, View
from embodichain.recording.api import Log
from embodichain.recording.playback import Playback, span_of
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean
from embodichain.utils.video import VideoFile, need_encoder

__all__ = ["FASTEST", "Filmed", "film_log"]

FASTEST = 60.0
"""Largest frame rate (1/s); above it, control steps are skipped."""
_CAMERA = "default"
_SHADOW = 2048
"""Maximum width of a shadow map in pixels; enough for a film."""
_FRONT = (1.0, -0.8, 0.6)
"""Direction from the scene's centre to the eye if the scene has no camera."""


@dataclass(frozen=True, slots=True)
class Filmed:
    """Result or progress of a film.

    Attributes:
        pictures: Number of pictures in the file.
        step: Control step of the last picture; -1 if there is none.
        whole: Whether all requested steps were drawn.
    """

    pictures: int
    step: int
    whole: bool


def film_log(
    log: Log | str | Path,
    out: str | Path,
    env: int = 0,
    episode: int | None = None,
    first: int | None = None,
    last: int | None = None,
    speed: float = 1.0,
    size: tuple[int, int] = (640, 480),
    camera: str | None = None,
    progress: Callable[[Filmed], None] | None = None,
    stop: Callable[[], bool] | None = None,
) -> Filmed:
    """Render an environment of a log to an MP4 with one picture for each control step.

    Args:
        log: A log, its file, or the folder of a run.
        out: A new file; it gets this name when it is complete.
        env: The environment.
        episode: One of its episodes; None is all.
        first: First control step, counted from the start of the log; None is the first.
        last: Last control step, included; None is the last.
        speed: Multiple of simulated time. If that gives more than `FASTEST` pictures per second,
            only every second step is drawn, or every third, and so on.
        size: Width and height in pixels, both even.
        camera: A camera of the scene; None is its ``default`` if it exists, else a front view.
        progress: Called after each picture.
        stop: Called before each picture; if it returns True, the film ends there and is saved.

    Returns:
        What was drawn; without pictures, no file was written.

    Raises:
        ConfigError: If the file exists; if the environment, episode, steps or camera do not exist;
            if a number is out of range; or if the encoder is not installed.
        LogError: If the log has no states, or its model cannot be loaded.
        RenderError: If no OpenGL library works here.
    """
    need_encoder()
    if not isinstance(log, Log):
        with Log(log) as opened:
            part = env, episode, first, last
            return film_log(opened, out, *part, speed, size, camera, progress, stop)
    out = Path(out)
    if os.path.lexists(out):
        raise ConfigError(f"{out} exists; it is never replaced")
    if not (math.isfinite(speed) and speed > 0):
        raise ConfigError(f"a film's speed must be positive, got {speed}")
    if min(size) < 16 or any(length % 2 for length in size):
        raise ConfigError(f"a film's width and height must be even, 16 or more, got {size}")
    span = span_of(log, env, episode, first, last)
    playback = Playback(log, env)
    look = _look(log.model, camera)
    rate = speed / log.dt
    every = max(1, math.ceil(rate / FASTEST - 1e-9))
    filmed = Filmed(0, -1, whole=False)
    with ExitStack() as stack:
        renderer = SceneRenderer(_quick(log.model), *size)
        stack.callback(renderer.close)
        video = None
        for step in playback.steps(span, every):
            if stop is not None and stop():
                return filmed
            if video is None:
                video = stack.enter_context(VideoFile(out, size, rate / every))
            video.write(renderer.draw(playback.engine, 0, look))
            filmed = Filmed(filmed.pictures + 1, step, whole=False)
            if progress is not None:
                progress(filmed)
        if video is None:
            raise ConfigError(f"{log.path} has no such steps: there is nothing to film")
        return replace(filmed, whole=True)


def _quick(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy with smaller shadow maps, which take half of the rendering time without a GPU."""
    model = copy.copy(model)
    model.vis.quality.shadowsize = min(model.vis.quality.shadowsize, _SHADOW)
    return model


def _look(model: mujoco.MjModel, camera: str | None) -> str | View:
    """The camera or view to render.

    Raises:
        ConfigError: If there is no such camera.
    """
    known = [model.camera(i).name for i in range(model.ncam)]
    if camera is None and _CAMERA in known:
        return _CAMERA
    if camera is None:
        middle, extent = np.asarray(model.stat.center), float(model.stat.extent)
        eye = middle + 1.2 * extent * np.asarray(_FRONT)
        return View.look_at(eye.tolist(), middle.tolist(), (0.0, 0.0, 1.0), 45.0)
    if camera not in known:
        there = ", ".join(known) or "none"
        raise ConfigError(f"no camera {camera!r}.{did_you_mean(camera, known)} Cameras: {there}")
    return camera

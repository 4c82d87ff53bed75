"""`film_log`: renders a recorded environment to a film; needs OpenGL (EGL), MP4 the extra `video`.

It draws the recorded states; only states between keyframes are simulated.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.lab.sim.drawing.views import Viewpoint
from embodichain.recording.film.frames import FilmCamera, cameras_of, frames
from embodichain.recording.read.api import Log
from embodichain.recording.read.playback import Playback, Span, Stretch
from embodichain.recording.read.recorded_log import RecordedLog
from embodichain.recording.shards import joining
from embodichain.utils.errors import ConfigError
from embodichain.utils.system.video import GIF, Film, film_file, need_encoder

__all__ = ["FASTEST", "FilmStyle", "Filmed", "default_camera", "film_log"]

FASTEST = 60.0
"""Largest frame rate (1/s) that is chosen; above it, control steps are skipped."""
_FASTEST_GIF = 25.0
"""The same for a GIF, whose pictures are hardly compressed."""
_DEFAULT_CAMERA = "default"
_FRONT = (1.0, -0.8, 0.6)
"""Direction from the scene's centre to the eye if the scene has no camera."""


@dataclass(frozen=True, slots=True)
class FilmStyle:
    """How a log is filmed.

    Attributes:
        speed: Multiple of simulated time.
        size: Width and height in pixels, both even.
        camera: A camera of the scene; None is its ``default`` if it exists, else a front view.
        every: Draw every `every`-th control step. None is the least that gives at most `FASTEST`
            pictures per second, 25 in a GIF.
        max_seconds: Length of the film in seconds, at most; None means no limit.

    Raises:
        ConfigError: If a number is out of range.
    """

    speed: float = 1.0
    size: tuple[int, int] = (640, 480)
    camera: str | None = None
    every: int | None = None
    max_seconds: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        if not (math.isfinite(self.speed) and self.speed > 0):
            raise ConfigError(f"a film's speed must be positive, got {self.speed}")
        if min(self.size) < 16 or any(length % 2 for length in self.size):
            raise ConfigError(
                f"a film's width and height must be even, 16 or more, got {self.size}"
            )

    def steps_per_picture(self, control_dt: float, is_gif: bool) -> int:
        """Number of control steps from one picture to the next."""
        if self.every:
            return self.every
        fastest = _FASTEST_GIF if is_gif else FASTEST
        return max(1, math.ceil(self.speed / control_dt / fastest - 1e-9))

    def most_pictures(self, rate: float) -> float:
        """Largest number of pictures of a film with a frame rate in 1/s."""
        if self.max_seconds is None:
            return math.inf
        return max(1, math.floor(self.max_seconds * rate + 1e-9))


@dataclass(frozen=True, slots=True)
class Filmed:
    """Result or progress of a film.

    Attributes:
        pictures: Number of pictures in the file.
        step: Control step of the last picture; -1 if there is none.
        whole: Whether all requested steps were drawn.
        total: Number of pictures of the whole film.
    """

    pictures: int
    step: int
    whole: bool
    total: int = 0


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
    every: int | None = None,
    max_seconds: float | None = None,
) -> Filmed:
    """Render an environment of a log to an MP4 or a GIF, one picture for each control step.

    Args:
        log: A log, its file, or the folder of a run.
        out: A new file, ``.gif`` or MP4; it gets this name when it is complete.
        env: The environment.
        episode: One of its episodes; None is all.
        first: First control step, counted from the start of the log; None is the first.
        last: Last control step, included; None is the last.
        speed: Multiple of simulated time.
        size: Width and height in pixels, both even.
        camera: A camera of the scene; None is its ``default`` if it exists, else a front view.
        progress: Called after each picture.
        stop: Called before each picture; if it returns True, the film ends there and is saved.
        every: Draw every `every`-th control step. None is the least that gives at most `FASTEST`
            pictures per second, 25 in a GIF.
        max_seconds: Length of the film in seconds, at most; None means no limit.

    Returns:
        What was drawn; without pictures, no file was written.

    Raises:
        ConfigError: If the file exists; if the environment, episode, steps or camera do not exist;
            if a number is out of range; or if the encoder is not installed.
        LogError: If the log has no states, or its model cannot be loaded.
        RenderError: If no OpenGL library works here.
    """
    out = Path(out)
    need_encoder(out.suffix, instead=f"{out.stem}.gif")
    stretch = Stretch(env, episode, first, last)
    style = FilmStyle(speed, size, camera=camera, every=every, max_seconds=max_seconds)
    if os.path.lexists(out):
        raise ConfigError(f"{out} exists; it is never replaced")
    if isinstance(log, Log):
        return _film(log, out, stretch, style, progress=progress, stop=stop)
    with joining.open(log) as opened:
        return _film(opened, out, stretch, style, progress=progress, stop=stop)


def _film(
    log: Log,
    out: Path,
    stretch: Stretch,
    style: FilmStyle,
    progress: Callable[[Filmed], None] | None,
    stop: Callable[[], bool] | None,
) -> Filmed:
    """Render an open log: see `film_log`."""
    is_stopped = stop or (lambda: False)
    span = stretch.span_in(log)
    playback = Playback(log, stretch.env)
    camera = _camera_of(log, style)
    every = style.steps_per_picture(log.dt, is_gif=out.suffix == GIF)
    frame_rate = style.speed / log.dt / every
    total = _count_pictures(
        log, stretch.env, span, every, style.most_pictures(frame_rate), is_stopped
    )
    if not total:
        raise ConfigError(f"{log.path} has no such steps: there is nothing to film")
    filmed = Filmed(pictures=0, step=-1, whole=False, total=total)
    if is_stopped():
        return filmed
    with ExitStack() as stack:
        renderer = stack.enter_context(closing(OffscreenRenderer(playback.engine.model)))
        film: Film | None = None
        for frame in islice(frames(renderer, playback, [camera], span, every), total):
            if is_stopped():
                return filmed
            if film is None:  # not before there is a picture: an empty film would leave a file
                film = stack.enter_context(film_file(out, style.size, frame_rate))
            film.write(frame.pictures[0])
            filmed = replace(filmed, pictures=filmed.pictures + 1, step=frame.step)
            if progress is not None:
                progress(filmed)
    return replace(filmed, whole=True)


def _count_pictures(
    log: Log, env: int, span: Span, every: int, most: float, is_stopped: Callable[[], bool]
) -> int:
    """How many pictures the steps of a log give, up to `most`; fewer if it is stopped."""
    steps = 0
    end = None if span.last is None else span.last + 1
    for part in log.parts("rewards", env, start=span.first, stop=end):
        steps += len(part)
        if steps >= most * every or is_stopped():
            break
    return int(min(most, math.ceil(steps / every)))


def _camera_of(log: Log, style: FilmStyle) -> FilmCamera:
    """The camera that films; one of a sensor in the look of films.

    Raises:
        ConfigError: If there is no such camera.
    """
    name = style.camera
    camera = default_camera(log) if name is None else cameras_of(log, [name])[name].camera
    return FilmCamera(camera, style.size, marks=True)


def default_camera(log: RecordedLog) -> str | Viewpoint:
    """The camera of a log's films: ``default`` of its scene if it exists, else a front view."""
    model = log.model
    if _DEFAULT_CAMERA in [model.camera(i).name for i in range(model.ncam)]:
        return _DEFAULT_CAMERA
    center = np.asarray(model.stat.center)
    distance = 1.2 * float(model.stat.extent)
    eye = center + distance * np.asarray(_FRONT)
    return Viewpoint.look_at(eye.tolist(), center.tolist())

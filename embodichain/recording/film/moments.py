"""`draw_moments`: single pictures of a log, of any environments and control steps."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.lab.sim.drawing.states import StoredStates
from embodichain.recording.film.filming import default_camera
from embodichain.recording.read.api import Log
from embodichain.recording.read.playback import Playback, Span

__all__ = ["Moment", "draw_moments"]

_PICTURES_AT_ONCE = 4


@dataclass(frozen=True, slots=True)
class Moment:
    """An environment before the physics of a control step.

    Attributes:
        env: The environment.
        step: The control step, counted from the start of the recording, as in `LogEpisode`.
    """

    env: int
    step: int


def draw_moments(
    log: Log, moments: Sequence[Moment], size: tuple[int, int]
) -> list[NDArray[np.uint8] | None]:
    """Draw moments of a log with the camera of its films.

    A log's index leads to each step, so the time depends on the number of pictures, not on the
    length of the log.

    Args:
        log: An open log with states.
        moments: The moments, in any order.
        size: Width and height in pixels.

    Returns:
        (height, width, 3) RGB of each moment; None where the log does not have the step, as of an
        episode that `record.every` left out.

    Raises:
        ConfigError: If there is no such environment.
        LogError: If the log has no states, is damaged, or its model cannot be loaded.
        RenderError: If colour cannot be drawn here.
    """
    states = StoredStates(log.model)
    drawn: list[int] = []
    pictures: list[NDArray[np.uint8] | None] = [None] * len(moments)
    camera = default_camera(log)
    with closing(OffscreenRenderer(log.model)) as renderer:

        def draw() -> None:
            for index, picture in zip(drawn, renderer.pictures(states, camera, size), strict=True):
                pictures[index] = picture
            states.clear()
            drawn.clear()

        for index, moment in enumerate(moments):
            playback = Playback(log, moment.env)
            step = next(playback.steps(Span(moment.step, moment.step)), None)
            if step != moment.step:
                continue
            states.append(playback.engine)
            drawn.append(index)
            if len(drawn) == _PICTURES_AT_ONCE:
                draw()
        if drawn:
            draw()
    return pictures

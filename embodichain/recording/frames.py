"""`frames`: pictures of one recorded environment, several control steps in a call."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.lab.sim.drawing.states import StoredStates
from embodichain.lab.sim.drawing.views import View, Viewpoint, view_of
from embodichain.recording.playback import Playback, Span

__all__ = ["FilmCamera", "Frame", "frames"]

_PIXELS = 200_000
"""Pixels of a call: more control steps at once are not cheaper per picture."""


class FilmCamera(NamedTuple):
    """What films an environment.

    Attributes:
        camera: Name of a camera of the scene, a viewpoint, or a view.
        size: Width and height in pixels.
    """

    camera: str | Viewpoint | View
    size: tuple[int, int]


class Frame(NamedTuple):
    """The pictures of a control step.

    Attributes:
        step: The control step.
        pictures: (height, width, 3) RGB of each camera.
    """

    step: int
    pictures: list[NDArray[np.uint8]]


def frames(
    renderer: OffscreenRenderer,
    playback: Playback,
    cameras: Sequence[FilmCamera],
    span: Span,
    every: int = 1,
) -> Iterator[Frame]:
    """Draw the environment at each step, in full look.

    Args:
        renderer: Of the playback's scene.
        playback: The environment, at its start.
        cameras: What films it.
        span: The control steps.
        every: Draw every `every`-th step, beginning with the first.

    Raises:
        LogError: See `Playback.steps`.
        RenderError: If colour cannot be drawn here.
        ValueError: If there is no such camera, or it is no pinhole camera.
    """
    most = max(1, _PIXELS // sum(width * height for _, (width, height) in cameras))
    states, steps = StoredStates(playback.engine.model), list[int]()

    def drawn() -> Iterator[Frame]:
        views = [_view(states, camera) for camera in cameras]
        colors = [found["color"][..., :3] for found in renderer.draw(states, views)]
        for row, step in enumerate(steps):
            yield Frame(step, [color[row] for color in colors])
        states.clear()
        steps.clear()

    for step in playback.steps(span, every):
        states.append(playback.engine)
        steps.append(step)
        if len(steps) == most:
            yield from drawn()
    if steps:
        yield from drawn()


def _view(states: StoredStates, camera: FilmCamera) -> View:
    if isinstance(camera.camera, View):
        return camera.camera
    return view_of(states, camera.camera, *camera.size, look="full")

"""`OffscreenRenderer`: draws a scene with the best renderer that works here, from any thread."""

from __future__ import annotations

import atexit
import logging
import os
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.gl import VARIABLE, hint
from embodichain.lab.sim.drawing.marks import MarkedState, marks_of
from embodichain.lab.sim.drawing.renderer_register import RENDERERS
from embodichain.lab.sim.drawing.thread import render_thread
from embodichain.lab.sim.drawing.views import (
    DrawnState,
    Pictures,
    Renderer,
    View,
    Viewpoint,
    view_of,
)
from embodichain.utils.errors import ConfigError, Problem, RenderError
from embodichain.utils.short_repr import short_repr

__all__ = ["OffscreenRenderer", "hint_at_colors", "need_colors"]

_log = logging.getLogger(__name__)


class OffscreenRenderer:
    """Draws a scene; all drawing of a process happens in one thread.

    The one of `RENDERERS` that the environment variable EMBODICHAIN_RENDERER names is used, or the
    first of these that works:

    - ``layered``: `BatchRenderer`, for OpenGL with layered rendering;
    - ``classic``: `ClassicRenderer`, for any other OpenGL;
    - ``rays``: `RayRenderer`, depth and masks only, without OpenGL.

    Args:
        model: The compiled scene.

    Attributes:
        kind: Which one is used.
        about: OpenGL's renderer and version as the driver says, or what draws instead.
        outputs: What it can draw, of ``color``, ``depth`` and ``mask``.

    Raises:
        ConfigError: If EMBODICHAIN_RENDERER names no renderer.
        RenderError: If none works here, or this process was forked from one that draws.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        kinds = _kinds()
        self._thread = render_thread()
        self._marks = marks_of(model)
        opened, self._better_failed = self._thread.call(partial(_open, model, kinds))
        self._renderer = opened.renderer
        self.kind = opened.kind
        self.about = opened.renderer.about
        self.outputs = RENDERERS[opened.kind].outputs
        self._forget = weakref.finalize(self, self._thread.call_later, self._renderer.close)
        self._forget.atexit = False
        _opened.add(self)
        _close_at_exit()

    def __repr__(self) -> str:
        """Return which renderer draws, and with what."""
        return short_repr(self, kind=self.kind, about=self.about, outputs=list(self.outputs))

    def draw(
        self, state: DrawnState, views: Sequence[View], envs: NDArray[np.int64] | None = None
    ) -> list[Pictures]:
        """Draw every view of n environments; see `Renderer`."""
        self._check_outputs(views)
        # Poses are computed in this thread: an engine may have to recompute constants for them,
        # and calls its listeners then.
        state.derived("geom_xpos")
        if not self._marks and not state.commands:
            return self._draw_all(state, views, envs)
        has_marks = [view.marks and "color" in view.outputs for view in views]
        for_people = [view for view, marked in zip(views, has_marks, strict=True) if marked]
        plain = [view for view, marked in zip(views, has_marks, strict=True) if not marked]
        with_marks: list[Pictures] = []
        without: list[Pictures] = []
        if for_people:
            state.derived("xpos")
            with_marks = self._draw_all(MarkedState(state, self._marks), for_people, envs)
        if plain:
            without = self._draw_all(state, plain, envs)
        drawn = {True: iter(with_marks), False: iter(without)}
        return [next(drawn[marked]) for marked in has_marks]

    def _draw_all(
        self, state: DrawnState, views: Sequence[View], envs: NDArray[np.int64] | None
    ) -> list[Pictures]:
        """Draw views of one state."""
        try:
            drawn = self._thread.call(partial(self._renderer.draw, state, views, envs))
        except RenderError as error:
            if "color" in self.outputs:
                raise
            raise RenderError(f"{error}; {self._better_failed or hint_at_colors()}") from error
        if self._better_failed is not None:
            _say_once(f"pictures are drawn by the renderer {self.kind!r}: {self._better_failed}")
        return drawn

    def _check_outputs(self, views: Sequence[View]) -> None:
        """Raise `RenderError` if a view has an output that the renderer cannot draw."""
        wanted = {output for view in views for output in view.outputs}
        missing = wanted.difference(self.outputs)
        message = f"the renderer {self.kind!r} draws {' and '.join(self.outputs)} only"
        if "color" in missing:
            advice = self._better_failed or hint_at_colors()
            raise RenderError(f"colours need OpenGL, and {message}; {advice}")
        if missing:
            raise RenderError(f"{message}, not {' and '.join(sorted(missing))}: unset {VARIABLE}")

    def pictures(
        self,
        state: DrawnState,
        camera: str | int | Viewpoint,
        size: tuple[int, int],
        envs: NDArray[np.int64] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw n environments in full look, (n, height, width, 3) RGB.

        Args:
            state: The environments.
            camera: Name or index of a camera, or a viewpoint.
            size: Width and height in pixels.
            envs: (n,) indices of the environments; None is all.

        Raises:
            RenderError: If colour cannot be drawn here; names the packages to install.
            ValueError: If there is no such camera, or it is not a pinhole camera.
        """
        width, height = size
        view = view_of(state, camera, width, height, look="full", marks=True)
        color: NDArray[np.uint8] = self.draw(state, [view], envs)[0]["color"]
        return np.ascontiguousarray(color[..., :3])

    def close(self) -> None:
        """Free the renderer's memory; does nothing the second time or in a forked process."""
        if self._forget.detach() is not None and not self._thread.forked:
            self._thread.call(self._renderer.close)


_opened: weakref.WeakSet[OffscreenRenderer] = weakref.WeakSet()


@cache
def _close_at_exit() -> None:
    """Close what is open when the process ends, before the drivers that are loaded by now."""

    def close() -> None:
        for renderer in list(_opened):
            renderer.close()
        thread = render_thread()
        if not thread.forked:
            thread.call(lambda: None)  # what is to be called later is called before

    atexit.register(close)


def need_colors(*keys: str) -> None:
    """Check that EMBODICHAIN_RENDERER names a renderer, and that colours can be drawn here.

    Args:
        keys: What the colours are for, named in the message; if empty, nothing is drawn.

    Raises:
        ConfigError: If EMBODICHAIN_RENDERER names no renderer.
        RenderError: If they cannot be drawn; names the packages to install.
    """
    kinds = [kind for kind in _kinds() if "color" in RENDERERS[kind].outputs]
    if not keys:
        return
    thread = render_thread()
    try:
        if not kinds:
            raise RenderError(f"colours need OpenGL; {hint_at_colors()}")
        opened, _ = thread.call(partial(_open, mujoco.MjSpec().compile(), kinds))
    except RenderError as error:
        raise RenderError(f"{', '.join(keys)}: {error}") from error
    thread.call(opened.renderer.close)


def hint_at_colors() -> str:
    """What to do where the renderer draws no colours."""
    named = os.environ.get(VARIABLE)
    if named and named in RENDERERS and "color" not in RENDERERS[named].outputs:
        return f"{VARIABLE} is {named!r}: unset it; {hint()}"
    return hint()


@dataclass(frozen=True)
class _Opened:
    """A renderer that works here.

    Attributes:
        kind: Its name in `RENDERERS`.
        renderer: The renderer.
    """

    kind: str
    renderer: Renderer


def _kinds() -> list[str]:
    """Names of the renderers to try, the best first.

    Raises:
        ConfigError: If EMBODICHAIN_RENDERER names no renderer.
    """
    named = os.environ.get(VARIABLE)
    if not named:
        return [name for name, kind in RENDERERS.items() if kind.is_tried]
    if named not in RENDERERS:
        problem = Problem(VARIABLE, RENDERERS.unknown(named))
        raise ConfigError([problem.at("environment variable")])
    return [named]


def _open(model: mujoco.MjModel, kinds: Sequence[str]) -> tuple[_Opened, str | None]:
    """The first renderer of `kinds` that works here, and why the first of all does not.

    Called in the render thread.
    """
    first_error: RenderError | None = None
    for kind in kinds:
        try:
            opened = _Opened(kind, RENDERERS[kind].open(model))
        except RenderError as error:
            first_error = first_error or error
        else:
            return opened, None if first_error is None else str(first_error)
    raise first_error or RenderError("there is no renderer")


@cache
def _say_once(message: str) -> None:
    _log.warning(message)

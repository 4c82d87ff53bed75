"""`Screen`: what `log_player` plays a log on; `WebPage` is one, and MuJoCo's own window here."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from embodichain.lab.sim.viewer import NativeViewer
from embodichain.recording.viewers.controls import Facts

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.base import F64
    from embodichain.lab.sim.engine.cpu import CpuEngine

__all__ = ["NativeScreen", "Screen"]

_SPACE = 32
_NAP = 0.02


class Screen(Protocol):
    """Where a log is shown."""

    @property
    def env_id(self) -> int:
        """The chosen environment."""

    @property
    def is_open(self) -> bool:
        """Whether it makes sense to go on."""

    @property
    def watched(self) -> bool:
        """Whether it is looked at now."""

    def begin(self, engine: CpuEngine) -> None:
        """Show this engine's environment from now on, as its model looks now."""

    def show(self, row: F64, facts: Facts) -> None:
        """Show the engine's state, (nstate,)."""

    def pace(self, seconds: float) -> None:
        """Wait for the next step, and while paused."""

    def close(self) -> None:
        """Show nothing any more."""


class NativeScreen:
    """MuJoCo's window; the space bar pauses, and lets go on.

    Args:
        env_id: The environment, for the log.
        stopped: Whether to wait no longer.
    """

    def __init__(self, env_id: int, stopped: Callable[[], bool] = lambda: False) -> None:
        self.env_id = env_id
        self._stopped = stopped
        self._window: NativeViewer | None = None
        self._paused = False
        self._due = time.monotonic()

    @property
    def is_open(self) -> bool:
        """Whether the window was not closed."""
        return self._window is None or self._window.is_running

    @property
    def watched(self) -> bool:
        """A window is always looked at."""
        return True

    def begin(self, engine: CpuEngine) -> None:
        """Open the window; its model stays the first one.

        Raises:
            RenderError: If there is no display.
        """
        if self._window is None:
            self._window = NativeViewer(engine, 0, self._on_key)
        self._window.follow(engine)

    def show(self, row: F64, facts: Facts) -> None:
        """Show the engine's state."""
        if self._window is not None:
            self._window.sync()

    def pace(self, seconds: float) -> None:
        """Wait for the clock, and while it is paused."""
        self._due = max(self._due + seconds, time.monotonic())
        while self.is_open and not self._stopped():
            left = self._due - time.monotonic()
            if left <= 0 and not self._paused:
                return
            time.sleep(_NAP if self._paused else min(left, _NAP))

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            self._window.close()

    def _on_key(self, key: int) -> None:
        if key == _SPACE:
            self._paused = not self._paused

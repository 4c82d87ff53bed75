"""`NativeView`: MuJoCo's own window, kept up to date by an environment's steps.

The window itself is `lab.sim.viewer`; needs a display.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from embodichain.lab.gym.envs.observers import StepObserver, StepRecord
from embodichain.lab.sim.engine.base import EnvIndex
from embodichain.lab.sim.viewer import NativeViewer

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv

__all__ = ["NativeView"]


class NativeView(StepObserver):
    """Shows one environment; attach it with `env.add_observer`.

    Args:
        env: The environment.
        env_id: Which of the N to show.
        fps: Pictures a second of wall-clock time, at most.
        realtime: Whether to slow the simulation down to wall-clock time.

    Raises:
        RenderError: If there is no display.
    """

    def __init__(
        self, env: ObservedEnv, env_id: int = 0, fps: float = 30.0, realtime: bool = True
    ) -> None:
        self._window = NativeViewer(env.sim.engine, env_id)
        self._env_id = env_id
        self._interval = 1.0 / fps
        self._step_dt = float(env.step_dt) if realtime else 0.0
        self._shown = self._stepped = time.monotonic()

    @property
    def is_open(self) -> bool:
        """Whether the user has the window open."""
        return self._window.is_running

    def on_reset(self, env: ObservedEnv, env_ids: EnvIndex) -> None:
        """Show the new episode's first state."""
        if self._env_id in env_ids:
            self._window.sync()

    def on_step(self, env: ObservedEnv, step: StepRecord) -> None:
        """Show the new state, if a picture is due; wait for the clock."""
        if not self._window.is_running:
            return
        now = time.monotonic()
        if now - self._shown >= self._interval:
            self._window.sync()
            self._shown = now
        ahead = self._step_dt - (time.monotonic() - self._stepped)
        if ahead > 0:
            time.sleep(ahead)
        self._stepped = time.monotonic()

    def on_close(self, env: ObservedEnv) -> None:
        """Close the window."""
        self._window.close()

"""`play_log`: recorded states on a screen, in real time: MuJoCo's window here, or a `WebPage`."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from embodichain.lab.sim.viewer import NativeViewer
from embodichain.recording.api import Log
from embodichain.recording.playback import Playback, Span, span_of
from embodichain.recording.viewers.controls import Facts
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.api import F64
    from embodichain.lab.sim.engine.cpu import CpuEngine

__all__ = ["NativeScreen", "Screen", "play_log"]

_NAP, _TICK = 0.05, 0.02
_AT_THE_END = 1.0
"""Seconds until it starts again."""
_SPACE = 32


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
            time.sleep(_TICK if self._paused else min(left, _TICK))

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            self._window.close()

    def _on_key(self, key: int) -> None:
        if key == _SPACE:
            self._paused = not self._paused


def play_log(
    log: Log,
    screen: Screen,
    episode: int | None = None,
    first: int | None = None,
    last: int | None = None,
    speed: float = 1.0,
    stopped: Callable[[], bool] = lambda: False,
) -> None:
    """Play a log until the screen is closed or `stopped` says so; starts again at the end.

    It waits while the screen is not watched. When another environment is chosen, it continues with
    that one, at the same step.

    Args:
        log: The log.
        screen: Where to show it; says which environment.
        episode: One of the environment's episodes; None is all. Of other environments all is shown.
        first: First control step; None is the first.
        last: Last control step, included; None is the last.
        speed: 2 is twice as fast as it was simulated.
        stopped: Asked all the time.

    Raises:
        ConfigError: If there is no such environment, episode or step.
        LogError: If the log has no states, or is damaged.
    """
    env = screen.env_id
    span = span_of(log, env, episode, first, last)
    at = span.first
    while screen.is_open and not stopped():
        player = _Player(log, screen, env, speed, stopped)
        reached = player.play(Span(at, span.last))
        if reached is None and at == span.first:
            raise ConfigError(f"{log.path} has no such steps: there is nothing to show")
        if screen.env_id != env:
            env, at = screen.env_id, span.first if reached is None else reached
            span = span_of(log, env, None, first, last)
        else:
            at = span.first
            _wait(_AT_THE_END, screen, stopped)


class _Player:
    """One environment, from a step on."""

    def __init__(
        self, log: Log, screen: Screen, env: int, speed: float, stopped: Callable[[], bool]
    ) -> None:
        self._log, self._screen, self._env, self._stopped = log, screen, env, stopped
        self._seconds = log.dt / speed
        data = log.read(["rewards", "episodes"], env=env)
        self._rewards = dict(zip(data.steps.tolist(), data["rewards"][:, 0], strict=True))
        self._episodes = dict(zip(data.steps.tolist(), data["episodes"][:, 0], strict=True))
        self._terms = _sampled(log, env, "reward_")
        self._sums = _sampled(log, env, "sum_")

    def play(self, span: Span) -> int | None:
        """Play; returns the step that was reached, None if there was none."""
        screen, playback = self._screen, Playback(self._log, self._env)
        seen, reached = -1, None
        for step in playback.steps(span):
            if not screen.watched:
                _wait(None, screen, self._stopped)
            if self._stopped() or not screen.is_open or screen.env_id != self._env:
                return reached if reached is not None else step
            if playback.changes != seen:
                seen = playback.changes
                screen.begin(playback.engine)
            screen.show(playback.engine.rows[0], self._facts(step))
            screen.pace(self._seconds)
            reached = step
        return reached

    def _facts(self, step: int) -> Facts:
        lines = (
            ("episode", str(int(self._episodes.get(step, 0)))),
            ("reward", f"{float(self._rewards.get(step, 0.0)):+.4g}"),
        )
        terms, sums = self._terms.get(step, {}), self._sums.get(step, {})
        return Facts(step, step * self._log.dt, lines, terms, sums)


def _sampled(log: Log, env: int, prefix: str) -> dict[int, dict[str, float]]:
    """Numbers of each reward term in the sampled steps; none if it was not viewed."""
    if env not in log.header.view_envs:
        return {}
    steps, values = log.metrics(env)
    terms = {k.removeprefix(prefix): v for k, v in values.items() if k.startswith(prefix)}
    rows = enumerate(steps.tolist())
    return {step: {name: float(v[row]) for name, v in terms.items()} for row, step in rows}


def _wait(seconds: float | None, screen: Screen, stopped: Callable[[], bool]) -> None:
    """Wait for a while, or with None until the screen is watched."""
    end = None if seconds is None else time.monotonic() + seconds
    while screen.is_open and not stopped():
        if screen.watched if end is None else time.monotonic() >= end:
            return
        time.sleep(_NAP)

"""`play_log`: plays recorded states in real time, in MuJoCo's window or on a `WebPage`."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Protocol

import numpy as np

from embodichain.lab.sim.viewer import NativeViewer
from embodichain.recording.read.api import Log
from embodichain.recording.read.playback import Playback, Span, span_of
from embodichain.recording.viewers.page.web_page import Facts
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.api import F64, Engine

__all__ = ["NativeScreen", "Screen", "play_log"]

_NAP, _TICK = 0.05, 0.02
_AT_THE_END = 1.0
"""Pause in seconds at the end, before playing starts again."""
_SPACE = 32


class Screen(Protocol):
    """Where a log is shown."""

    @property
    def env_id(self) -> int:
        """The chosen environment."""

    @property
    def is_open(self) -> bool:
        """Whether the screen was not closed."""

    @property
    def watched(self) -> bool:
        """Whether anything displays the screen now."""

    def begin(self, engine: Engine) -> None:
        """Show this engine's environment from now on, with its current model."""

    def show(self, row: F64, facts: Facts) -> None:
        """Show the engine's state, (nstate,)."""

    def pace(self, seconds: float) -> None:
        """Wait for the next step, and while paused."""

    def close(self) -> None:
        """Stop showing anything."""


class NativeScreen:
    """MuJoCo's window; the space bar pauses and resumes.

    Args:
        env_id: The environment of the log.
        stopped: Whether to end all waiting.
    """

    watched = True

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

    def begin(self, engine: Engine) -> None:
        """Open the window; its model is not replaced later. RenderError without a display."""
        if self._window is None:
            self._window = NativeViewer(engine, 0, self._on_key)
        self._window.follow(engine)

    def show(self, row: F64, facts: Facts) -> None:
        """Show the engine's state."""
        if self._window is not None:
            self._window.sync()

    def pace(self, seconds: float) -> None:
        """Wait for the next step, and while paused."""
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
    """Play a log until the screen is closed or `stopped` returns True; start again at the end.

    Playing pauses while the screen is not watched. When another environment is chosen, it
    continues with that one, at the same step.

    Args:
        log: The log.
        screen: The screen, with the environment to show.
        episode: One of the environment's episodes; None is all. Other environments show all.
        first: First control step; None is the first.
        last: Last control step, included; None is the last.
        speed: Multiple of simulated time.
        stopped: Called often; True ends playing.

    Raises:
        ConfigError: If there is no such environment, episode or step.
        LogError: If the log has no states, or is damaged.
    """
    env = screen.env_id
    span = span_of(log, env, episode, first, last)
    at = span.first
    while screen.is_open and not stopped():
        reached = _play(log, screen, Span(at, span.last), log.dt / speed, stopped)
        if reached is None and at == span.first:
            raise ConfigError(f"{log.path} has no such steps: there is nothing to show")
        if screen.env_id != env:
            env, at = screen.env_id, span.first if reached is None else reached
            span = span_of(log, env, None, first, last)
        else:
            at = span.first
            again = time.monotonic() + _AT_THE_END
            _wait(partial(_is_past, again), screen, stopped)


def _play(
    log: Log, screen: Screen, span: Span, seconds: float, stopped: Callable[[], bool]
) -> int | None:
    """Play the screen's environment; return the last step shown, None if there was none."""
    env, playback = screen.env_id, Playback(log, screen.env_id)
    facts = _facts_of(log, env)
    seen, reached = -1, None
    for step in playback.steps(span):
        _wait(lambda: screen.watched, screen, stopped)
        if stopped() or not screen.is_open or screen.env_id != env:
            return reached if reached is not None else step
        if playback.changes != seen:
            seen = playback.changes
            screen.begin(playback.engine)
        screen.show(playback.engine.rows[0], facts(step))
        screen.pace(seconds)
        reached = step
    return reached


def _facts_of(log: Log, env: int) -> Callable[[int], Facts]:
    """Return the facts of an environment by step; terms are known only if it was viewed."""
    data = log.read(["rewards", "episodes"], env=env)
    rows = {step: row for row, step in enumerate(data.steps.tolist())}
    is_viewed = env in log.header.view_envs
    steps, values = log.metrics(env) if is_viewed else (np.zeros(0, np.int64), {})
    samples = {step: row for row, step in enumerate(steps.tolist())}

    def terms(step: int, prefix: str) -> dict[str, float]:
        row = samples.get(step)
        if row is None:
            return {}
        named = {name: v for name, v in values.items() if name.startswith(prefix)}
        return {name.removeprefix(prefix): float(v[row]) for name, v in named.items()}

    def facts(step: int) -> Facts:
        row = rows.get(step)
        episode = 0 if row is None else int(data["episodes"][row, 0])
        reward = 0.0 if row is None else float(data["rewards"][row, 0])
        lines = ("episode", str(episode)), ("reward", f"{reward:+.4g}")
        return Facts(step, step * log.dt, lines, terms(step, "reward_"), terms(step, "sum_"))

    return facts


def _is_past(moment: float) -> bool:
    return time.monotonic() >= moment


def _wait(condition: Callable[[], bool], screen: Screen, stopped: Callable[[], bool]) -> None:
    """Wait until a condition is true, or playing ends."""
    while not condition() and screen.is_open and not stopped():
        time.sleep(_NAP)

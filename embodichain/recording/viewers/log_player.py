"""`play_log`: recorded states on a screen, at the speed of the clock, again and again."""

from __future__ import annotations

import time
from collections.abc import Callable

from embodichain.recording.api import Log
from embodichain.recording.playback import Playback, Span, span_of
from embodichain.recording.viewers.controls import Facts
from embodichain.recording.viewers.log_screens import Screen
from embodichain.utils.errors import ConfigError

__all__ = ["play_log"]

_NAP = 0.05
_AT_THE_END = 1.0
"""Seconds until it begins again."""


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

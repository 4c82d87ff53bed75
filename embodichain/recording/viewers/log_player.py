"""`play_log`: plays recorded states in real time, in MuJoCo's window or on a `WebPage`."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from numpy.typing import NDArray

from embodichain.lab.sim.viewer import NativeViewer
from embodichain.recording.read.api import Log
from embodichain.recording.read.playback import Playback, Span, Stretch
from embodichain.recording.viewers.page.web_page import Facts
from embodichain.utils.errors import ConfigError
from embodichain.utils.number_text import signed_number

if TYPE_CHECKING:
    from embodichain.lab.sim.drawing.commands import ShownCommand
    from embodichain.lab.sim.engine.api import F64, Engine

__all__ = ["NativeScreen", "Screen", "play_log"]

_POLL_SECONDS = 0.05
_PACE_SECONDS = 0.02
"""Longest wait in seconds before keys and the end of the run are looked at again."""
_AT_THE_END = 1.0
"""Pause in seconds at the end, before playing starts again."""
_SPACE = 32
"""GLFW's code of the space bar."""


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

    def show(self, row: F64, facts: Facts, commands: Sequence[ShownCommand]) -> None:
        """Show the engine's state, (nstate,), and the commands in force."""

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
        self._next_step = time.monotonic()

    @property
    def is_open(self) -> bool:
        """Whether the window was not closed."""
        return self._window is None or self._window.is_running

    def begin(self, engine: Engine) -> None:
        """Open the window; its model is not replaced later.

        Raises:
            RenderError: If there is no display.
        """
        if self._window is None:
            self._window = NativeViewer(engine, 0, self._on_key)
        self._window.follow(engine)

    def show(self, row: F64, facts: Facts, commands: Sequence[ShownCommand]) -> None:
        """Show the engine's state, with its commands."""
        if self._window is not None:
            self._window.sync()

    def pace(self, seconds: float) -> None:
        """Wait for the next step, and while paused."""
        self._next_step = max(self._next_step + seconds, time.monotonic())
        while self.is_open and not self._stopped():
            if self._paused:
                time.sleep(_PACE_SECONDS)
                continue
            remaining = self._next_step - time.monotonic()
            if remaining <= 0:
                return
            time.sleep(min(remaining, _PACE_SECONDS))

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
    repeats: bool = True,
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
        repeats: Whether it starts again at the end.

    Raises:
        ConfigError: If there is no such environment, episode or step.
        LogError: If the log has no states, or is damaged.
    """
    env = screen.env_id
    span = Stretch(env=env, episode=episode, first=first, last=last).span_in(log)
    start = span.first
    while screen.is_open and not stopped():
        last_shown = _play(log, screen, Span(start, span.last), log.dt / speed, stopped)
        if last_shown is None and start == span.first:
            raise ConfigError(f"{log.path} has no such steps: there is nothing to show")
        if screen.env_id != env:
            env = screen.env_id
            start = span.first if last_shown is None else last_shown
            span = Stretch(env=env, first=first, last=last).span_in(log)
        elif not repeats:
            return
        else:
            start = span.first
            restart = time.monotonic() + _AT_THE_END
            _wait(partial(_is_past, restart), screen, stopped)


def _play(
    log: Log, screen: Screen, span: Span, seconds: float, stopped: Callable[[], bool]
) -> int | None:
    """Play the screen's environment; return the last step shown, None if there was none."""
    env = screen.env_id
    playback = Playback(log, env)
    facts = _StepFacts(log, env)
    changes = -1  # so that the first step shows the model
    last_shown: int | None = None
    for step in playback.steps(span):
        _wait(lambda: screen.watched, screen, stopped)
        if stopped() or not screen.is_open or screen.env_id != env:
            return step if last_shown is None else last_shown
        if playback.changes != changes:
            changes = playback.changes
            screen.begin(playback.engine)
        screen.show(playback.engine.rows[0], facts.at(step), playback.engine.commands)
        screen.pace(seconds)
        last_shown = step
    return last_shown


class _StepFacts:
    """The facts of one environment by step; terms are known only if it was viewed.

    Args:
        log: The log.
        env: The environment.
    """

    def __init__(self, log: Log, env: int) -> None:
        self._dt = log.dt
        self._data = log.read(["rewards", "episodes"], env=env)
        self._rows = {step: row for row, step in enumerate(self._data.steps.tolist())}
        self._metrics: Mapping[str, NDArray[Any]] = {}
        self._metric_rows: dict[int, int] = {}
        if env in log.header.view_envs:
            steps, self._metrics = log.metrics(env)
            self._metric_rows = {step: row for row, step in enumerate(steps.tolist())}

    def at(self, step: int) -> Facts:
        """The facts of a step."""
        episode = 0
        reward = 0.0
        row = self._rows.get(step)
        if row is not None:
            episode = int(self._data["episodes"][row, 0])
            reward = float(self._data["rewards"][row, 0])
        return Facts(
            step=step,
            seconds=step * self._dt,
            lines=(("episode", str(episode)), ("reward", signed_number(reward))),
            rewards=self._terms(step, "reward_"),
            sums=self._terms(step, "sum_"),
        )

    def _terms(self, step: int, prefix: str) -> dict[str, float]:
        """Values of the metrics that begin with a prefix, without it."""
        row = self._metric_rows.get(step)
        if row is None:
            return {}
        return {
            name.removeprefix(prefix): float(values[row])
            for name, values in self._metrics.items()
            if name.startswith(prefix)
        }


def _is_past(moment: float) -> bool:
    return time.monotonic() >= moment


def _wait(condition: Callable[[], bool], screen: Screen, stopped: Callable[[], bool]) -> None:
    """Wait until a condition is true, or playing ends."""
    while not condition() and screen.is_open and not stopped():
        time.sleep(_POLL_SECONDS)

"""`Playback`: one environment of a log, step after step, on an engine of its own.

Recorded rows are shown as they are, on the model as the environment had it; only what lies between
keyframes is simulated.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from embodichain.lab.sim.engine.cpu import CpuEngine
from embodichain.recording.episodes import episode_of
from embodichain.recording.recorded_log import RecordedLog
from embodichain.recording.simulation import Simulation, always, never
from embodichain.recording.trajectory import Span, follow
from embodichain.utils.errors import ConfigError

__all__ = ["Playback", "Span", "follower_of", "span_of"]


def span_of(
    log: RecordedLog,
    env: int,
    episode: int | None = None,
    first: int | None = None,
    last: int | None = None,
) -> Span:
    """The control steps that are meant.

    Args:
        log: The log.
        env: The environment.
        episode: One of its episodes; None is all.
        first: First control step, counted from the start of the log; None is the first.
        last: Last control step, included; None is the last.

    Raises:
        ConfigError: If the environment or the episode does not exist, or the range is none.
    """
    log.header.check_env(env)
    start, end = first or 0, last
    if episode is not None:
        found = episode_of(log.episodes, env, episode)
        start = max(start, found.first_step)
        end = found.last_step if end is None else min(end, found.last_step)
    if start < 0 or (end is not None and end < start):
        raise ConfigError(f"no control steps from {start} to {end}")
    return Span(start, end)


def follower_of(log: RecordedLog, env: int) -> Simulation:
    """One environment of a log on an engine, which simulates only what is between keyframes.

    Raises:
        ConfigError: If there is no such environment.
        LogError: If the log has no states, or its model cannot be loaded.
    """
    log.header.check_env(env)
    log.header.require_states(log.path)
    simulates = log.header.keyframe_every > 0
    model = log.model_to_simulate if simulates else log.model
    active = always(1) if simulates else never(1)
    return Simulation(log.reader, model, np.array([env], np.int64), active, num_threads=1)


class Playback:
    """One environment as it was recorded.

    Args:
        log: The log; it must have states.
        env: The environment.

    Attributes:
        engine: Has the state of the step that was last reached: one environment, number 0.

    Raises:
        ConfigError: If there is no such environment.
        LogError: If the log has no states, or its model cannot be loaded.
    """

    def __init__(self, log: RecordedLog, env: int) -> None:
        self.log = log
        self.env = env
        self._simulation = follower_of(log, env)
        self.engine: CpuEngine = self._simulation.engine

    @property
    def changes(self) -> int:
        """How often the environment's model was written to so far."""
        return self._simulation.changes

    def steps(self, span: Span, every: int = 1) -> Iterator[int]:
        """Yield control steps; the engine then has what physics received in them.

        Can be called once.

        Args:
            span: Which steps.
            every: 2 leaves out every second, and so on; the first is always there.

        Raises:
            LogError: If a message is damaged, or does not fit the model, or the log does not
                simulate to what it says.
        """
        for run, t in follow(self.log.reader, self._simulation, span):
            step = run.first + t
            if not (step - span.first) % every:
                yield step

"""`Playback`: one environment of a log, step after step, on a separate engine.

The engine has the recorded rows and model fields; only states between keyframes are simulated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from embodichain.lab.sim.engine.api import Engine
from embodichain.recording.read.commands import RecordedCommands
from embodichain.recording.read.episodes import episode_of
from embodichain.recording.read.recorded_log import RecordedLog
from embodichain.recording.read.simulation import Simulation, always, never
from embodichain.recording.read.trajectory import Span, follow
from embodichain.utils.errors import ConfigError

__all__ = ["Playback", "Span", "Stretch", "follower_of", "span_of"]


@dataclass(frozen=True, slots=True)
class Stretch:
    """Which part of a log is played.

    Attributes:
        env: The environment.
        episode: One of its episodes; None is all.
        first: First control step, counted from the start of the log; None is the first.
        last: Last control step, included; None is the last.
    """

    env: int = 0
    episode: int | None = None
    first: int | None = None
    last: int | None = None

    def span_in(self, log: RecordedLog) -> Span:
        """The control steps of this stretch in a log.

        Raises:
            ConfigError: If the environment or the episode does not exist, or the range is empty.
        """
        log.header.check_env(self.env)
        first = 0 if self.first is None else self.first
        last = self.last
        if self.episode is not None:
            episode = episode_of(log.episodes, self.env, self.episode)
            first = max(first, episode.first_step)
            if last is None or last > episode.last_step:
                last = episode.last_step
        if first < 0 or (last is not None and last < first):
            raise ConfigError(f"no control steps from {first} to {last}")
        return Span(first, last)


def span_of(
    log: RecordedLog,
    env: int,
    episode: int | None = None,
    first: int | None = None,
    last: int | None = None,
) -> Span:
    """The control steps of a `Stretch`, given by its attributes."""
    return Stretch(env, episode, first, last).span_in(log)


def follower_of(log: RecordedLog, env: int) -> Simulation:
    """One environment of a log on an engine, which simulates only states between keyframes.

    Raises:
        ConfigError: If there is no such environment.
        LogError: If the log has no states, or its model cannot be loaded.
    """
    log.header.check_env(env)
    log, env = log.part_of(env)
    log.header.require_states(log.path)
    if log.header.keyframe_every > 0:
        model = log.model_to_simulate
        active = always(1)
    else:
        model = log.model
        active = never(1)
    env_ids = np.array([env], np.int64)
    return Simulation(log.reader, model, env_ids=env_ids, active=active, num_threads=1)


class Playback:
    """Plays back one recorded environment.

    Args:
        log: The log; it must have states.
        env: The environment.

    Attributes:
        engine: The engine with the state of the current step, and with the commands that were in
            force, if the environment was viewed; it has one environment, 0.

    Raises:
        ConfigError: If there is no such environment.
        LogError: If the log has no states, or its model cannot be loaded.
    """

    def __init__(self, log: RecordedLog, env: int) -> None:
        log.header.check_env(env)
        self.log, self.env = log.part_of(env)
        self._simulation = follower_of(self.log, self.env)
        self.engine: Engine = self._simulation.engine

    @property
    def changes(self) -> int:
        """Number of writes to the environment's model so far."""
        return self._simulation.changes

    def steps(self, span: Span, every: int = 1) -> Iterator[int]:
        """Yield control steps; at each, the engine has the input state of its physics.

        Can be called once.

        Args:
            span: The control steps.
            every: Yield every `every`-th step, beginning with the first.

        Raises:
            LogError: If a message is damaged or does not match the model, or simulating between
                keyframes does not give the recorded states.
        """
        task = self.log.config.get("task")
        commands = RecordedCommands(
            self.log.reader,
            task if isinstance(task, dict) else {},
            self.engine.model,
            env=self.env,
            span=span,
        )
        for run, t in follow(self.log.reader, self._simulation, span):
            step = run.first + t
            if (step - span.first) % every == 0:
                self.engine.commands = commands.at(step)
                yield step

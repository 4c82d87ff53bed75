"""`StepObservation`: the observation of a step, made before judging where that takes it.

Interval events and commands come after judging. What they change is observed once more, as if the
first observation had not been made: noise, delays and histories advance once in a step.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from embodichain.utils.arrays import is_host

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.drawing import CommandManager, EventManager
    from embodichain.lab.gym.envs.managers.observation_manager import ObservationManager
    from embodichain.lab.gym.envs.observation import Observation
    from embodichain.lab.gym.envs.step.episodes import Episodes
    from embodichain.lab.gym.envs.step.observation_buffer import ObservationBuffer
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.types import EnvObs
    from embodichain.utils.arrays import Arrays
    from embodichain.utils.random import RandomStreams

__all__ = ["ObservingEnv", "StepObservation", "observe"]

Changed = Sequence["EnvIndex | None"]


class ObservingEnv(Protocol):
    """What `StepObservation` uses of an environment."""

    episodes: Episodes
    streams: RandomStreams
    observation_buffer: ObservationBuffer
    observation_manager: ObservationManager
    event_manager: EventManager
    command_manager: CommandManager

    @property
    def num_envs(self) -> int:
        """N."""

    @property
    def arrays(self) -> Arrays:
        """Makes arrays."""

    def get_obs(self, **kwargs: Any) -> EnvObs:
        """Observe all environments."""


def observe(env: ObservingEnv, kwargs: dict[str, Any], stepped: EnvIndex | None) -> Observation:
    """Observe all environments.

    Args:
        env: The environment.
        kwargs: Those of `step`, or the options of `reset`.
        stepped: (n,) environments that stepped or were reset, None for all: their noise, delays and
            histories advance.
    """
    env.observation_manager.stepped = stepped
    return env.observation_buffer.complete(env.get_obs(**kwargs))


class StepObservation:
    """Makes the observation of a step.

    Args:
        env: The environment.
    """

    def __init__(self, env: ObservingEnv) -> None:
        self._env = env
        self._before: tuple[Any, Any, Any] | None = None

    def to_judge(self, kwargs: dict[str, Any], stepped: EnvIndex | None) -> Observation:
        """Observe before judging.

        Args:
            kwargs: Those of `step`.
            stepped: (n,) environments that stepped, None for all.
        """
        env, self._before = self._env, None
        if not (env.event_manager.acts_in_steps or env.command_manager.acts_in_steps):
            return self._observe(kwargs, stepped)
        memory, counters = env.observation_manager.memory(), env.streams.save_counters()
        seen = self._observe(kwargs, stepped)
        self._before = memory, counters, env.streams.save_counters()
        return seen

    def to_return(
        self,
        seen: Observation | None,
        changed: Changed,
        kwargs: dict[str, Any],
        stepped: EnvIndex | None,
    ) -> Observation:
        """Observe after events and commands.

        Args:
            seen: The result of `to_judge` in this step, or None.
            changed: Environments of each event that fired and each new command; None is all. Their
                rows are observed once more, the others are those seen.
            kwargs: Those of `step`.
            stepped: (n,) environments that stepped, None for all.
        """
        if seen is None:
            return self._observe(kwargs, stepped)
        before, self._before = self._before, None
        if before is None or not changed:
            return seen
        env = self._env
        memory, *counters = before
        env.observation_manager.recall(memory)
        env.streams.take_back(*counters)
        again = self._observe(kwargs, stepped)
        rows: NDArray[np.bool_] = env.arrays.full(env.num_envs, False, np.bool_)
        for ids in changed:
            rows[slice(None) if ids is None else ids] = True
        if is_host(rows) and rows.all():
            return again
        return again.with_rows(np.where(rows[:, None], again.rows, seen.rows))

    def _observe(self, kwargs: dict[str, Any], stepped: EnvIndex | None) -> Observation:
        # Hooks that observe do not count the present step, as in EmbodiChain; terms do.
        with self._env.episodes.counting(present=False):
            return observe(self._env, kwargs, stepped)

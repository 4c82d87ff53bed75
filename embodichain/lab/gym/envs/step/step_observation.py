"""`StepObservation`: the observation of a step, made before judging where that takes it.

Interval events and commands come after judging. What they change is observed once more, as if the
first observation had not been made: noise, delays and histories advance once in a step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.utils.arrays import is_host

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.gym.envs.managers.observation_manager import ObservationManager
    from embodichain.lab.gym.envs.managers.random_managers import CommandManager, EventManager
    from embodichain.lab.gym.envs.observation import Observation
    from embodichain.lab.gym.envs.step.episodes import Episodes
    from embodichain.lab.gym.envs.step.observation_buffer import ObservationBuffer
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.types import EnvObs

__all__ = ["StepObservation"]

Changed = Sequence["EnvIndex | None"]


@dataclass(frozen=True, slots=True, eq=False)
class _BeforeJudging:
    """What an observation before judging advances, from which it can be made once more.

    Attributes:
        memory: Noise, delays, histories and states of terms before it.
        counters: Counters of the random streams before it.
        counters_after: Those after it.
    """

    memory: Any
    counters: Any
    counters_after: Any


class StepObservation:
    """Makes the observation of a step, or after a reset.

    Args:
        env: The environment.
        get_obs: Its hook, which observes all environments.
        hooks_observe: Whether the class overrides it, or a hook that it calls.
        buffer: Makes observations.
        episodes: Counters of the episodes.
        observations: The observation manager.
        events: The event manager.
        commands: The command manager.
    """

    def __init__(
        self,
        env: TermContext,
        get_obs: Callable[..., EnvObs],
        buffer: ObservationBuffer,
        *,
        hooks_observe: bool,
        episodes: Episodes,
        observations: ObservationManager,
        events: EventManager,
        commands: CommandManager,
    ) -> None:
        self._env = env
        self._get_obs = get_obs
        self._hooks_observe = hooks_observe
        self._buffer = buffer
        self._episodes = episodes
        self._observations = observations
        self._events = events
        self._commands = commands
        self._before: _BeforeJudging | None = None

    def after_reset(self, options: dict[str, Any], were_reset: EnvIndex | None) -> Observation:
        """Observe all environments after a reset.

        Args:
            options: Those of `reset`.
            were_reset: Environments that were reset: only their noise, delays and histories
                advance. None is all.
        """
        return self._observe(options, were_reset)

    def to_judge(self, kwargs: dict[str, Any], stepped: EnvIndex | None) -> Observation:
        """Observe before judging.

        Args:
            kwargs: Those of `step`.
            stepped: Environments that stepped, None for all.
        """
        self._before = None
        if not (self._events.acts_in_steps or self._commands.acts_in_steps):
            return self._observe_step(kwargs, stepped)
        streams = self._env.streams
        memory = self._observations.memory()
        counters = streams.save_counters()
        judged_obs = self._observe_step(kwargs, stepped)
        self._before = _BeforeJudging(memory, counters, streams.save_counters())
        return judged_obs

    def to_return(
        self,
        judged_obs: Observation | None,
        changed: Changed,
        kwargs: dict[str, Any],
        stepped: EnvIndex | None,
    ) -> Observation:
        """Observe after events and commands.

        Args:
            judged_obs: The result of `to_judge` in this step, or None.
            changed: Environments of each event that fired and each new command; None is all. Their
                rows are observed once more, the others are those of `judged_obs`.
            kwargs: Those of `step`.
            stepped: Environments that stepped, None for all.
        """
        if judged_obs is None:
            return self._observe_step(kwargs, stepped)
        before = self._before
        self._before = None
        if before is None or not changed:
            return judged_obs
        env = self._env
        # So that it is made with the same noise, and delays and histories advance once.
        self._observations.recall(before.memory)
        env.streams.take_back(before.counters, before.counters_after)
        again = self._observe_step(kwargs, stepped)
        rows: NDArray[np.bool_] = env.arrays.full(env.num_envs, False, np.bool_)
        for ids in changed:
            rows[slice(None) if ids is None else ids] = True
        if is_host(rows) and rows.all():
            return again
        return again.with_rows(np.where(rows[:, None], again.rows, judged_obs.rows))

    def _observe_step(self, kwargs: dict[str, Any], stepped: EnvIndex | None) -> Observation:
        if not self._hooks_observe:
            return self._observe(kwargs, stepped)
        # Hooks that observe do not count the present step, as in EmbodiChain; terms do.
        with self._episodes.counting(present=False):
            return self._observe(kwargs, stepped)

    def _observe(self, kwargs: dict[str, Any], stepped: EnvIndex | None) -> Observation:
        """Observe; the noise, delays and histories of environments `stepped` advance."""
        self._observations.stepped = stepped
        return self._buffer.complete(self._get_obs(**kwargs))

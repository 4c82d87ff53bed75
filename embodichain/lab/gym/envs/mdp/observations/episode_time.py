"""Observations of time: how long the episode has lasted, how long it may, and a clock that cycles.

Time is the simulation's own, from the first observation of the episode on; physics steps within
reset events (waiting until objects lie still) do not count.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from embodichain.lab.gym.envs.managers.param_types import Finite, Positive
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.mdp.observations._computed import Computed
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["CurrentTime", "ElapsedFraction", "Phase", "RemainingTime"]

_NEVER = 2**31 - 1


class _Clock(Computed):
    """Seconds since each episode's first observation."""

    def __init__(self, env: TermContext) -> None:
        self._env = env
        self._start: F64 = np.zeros(env.num_envs)
        self._fresh: NDArray[np.bool_] = np.ones(env.num_envs, np.bool_)

    def seconds(self) -> F64:
        """(N,) s."""
        now = self._env.sim.engine.state("time")[:, 0]
        if self._fresh.any():
            self._start = np.where(self._fresh, now, self._start)
            self._fresh = np.zeros_like(self._fresh)
        return now - self._start

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Time begins anew with the next observation."""
        self._fresh[slice(None) if env_ids is None else env_ids] = True

    def state_dict(self) -> dict[str, Any]:
        """When episodes began (copies)."""
        return {"start": self._start.copy(), "fresh": self._fresh.copy()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._start, self._fresh = state["start"].copy(), state["fresh"].copy()


@register_term("observation", name="current_time_s")
class CurrentTime(_Clock):
    """(N, 1) seconds the episode has lasted; 0 right after a reset. Isaac Lab's name.

    Example:
        ``{func: current_time_s}``
    """

    def value(self) -> F64:
        """(N, 1)."""
        return self.seconds()[:, None]


class _Limited(_Clock):
    """A clock of episodes that end."""

    def __init__(self, env: TermContext) -> None:
        super().__init__(env)
        if env.max_episode_steps == _NEVER:
            message = "the task has no time limit (max_episode_steps: -1): nothing remains"
            raise ConfigError([Problem("", message)])

    def limit(self) -> float:
        """Seconds an episode lasts at most."""
        return self._env.max_episode_steps * self._env.step_dt


@register_term("observation", name="remaining_time_s")
class RemainingTime(_Limited):
    """(N, 1) seconds until the episode is truncated by ``max_episode_steps``. Isaac Lab's name.

    Example:
        ``{func: remaining_time_s}``
    """

    def value(self) -> F64:
        """(N, 1)."""
        return (self.limit() - self.seconds())[:, None]


@register_term("observation", name="elapsed_fraction")
class ElapsedFraction(_Limited):
    """(N, 1) share of the longest episode (``max_episode_steps``) that is over: from 0 to 1.

    With it a value function can know when a time limit strikes (Pardo et al., "Time limits in
    reinforcement learning", ICML 2018).

    Example:
        ``{func: elapsed_fraction}``
    """

    def value(self) -> F64:
        """(N, 1)."""
        return (self.seconds() / self.limit())[:, None]


@register_term("observation", name="phase")
class Phase(_Clock):
    """(N, 2 K) sine and cosine of 2 pi (t / period + offset), t the episode's time; K offsets.

    A clock for gaits and other cycles: sin, cos of the first offset, then of the second...

    Example:
        ``{func: phase, params: {period_s: 0.8, offsets: [0.0, 0.5]}}``

    Args:
        period_s: Seconds a cycle.
        offsets: Where cycles stand at t = 0, in periods, one for each pair of numbers.
    """

    def __init__(
        self,
        env: TermContext,
        period_s: Positive,
        offsets: Annotated[Sequence[Finite], Field(min_length=1)] = (0.0,),
    ) -> None:
        super().__init__(env)
        self._period, self._offsets = float(period_s), [float(offset) for offset in offsets]

    def value(self) -> F64:
        """(N, 2 K)."""
        cycles = self.seconds() / self._period
        columns = []
        for offset in self._offsets:
            angle = 2.0 * np.pi * (cycles + offset)
            columns += [np.sin(angle), np.cos(angle)]
        return np.stack(columns, axis=1)

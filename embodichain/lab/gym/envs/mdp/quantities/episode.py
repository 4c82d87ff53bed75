"""Quantities of the episode and of the step: success, termination, time, actions; and a constant.

Time is simulation time from the first observation of the episode; physics steps in reset events
(waiting until objects are at rest) do not count.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from embodichain.lab.gym.envs.cfg import NO_LIMIT
from embodichain.lab.gym.envs.managers.param_types import Finite, Positive
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.managers.terms.registry import quantity
from embodichain.lab.gym.envs.mdp._rows import action_rows
from embodichain.utils.arrays import may_be_set
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.utils.array_types import Floats

    Mask = NDArray[np.bool_]

__all__ = [
    "CurrentTime",
    "ElapsedFraction",
    "LastAction",
    "Phase",
    "RemainingTime",
    "action_",
    "constant",
    "is_alive",
    "is_terminated",
    "success_reward",
    "time_out",
]

Info = dict[str, Any]


@quantity(name="action")
def action_(env: TermContext, action: Any) -> Floats:
    """(N, A) the action as given to `step` (after `_preprocess_action`), in the action's units.

    The corresponding observation is `last_action`.

    Example:
        ``{func: action, shape: l2, weight: -0.01}``
    """
    return action_rows(env, action)


@quantity("reward", "metric")
def constant(env: TermContext, value: float = 1.0) -> Floats:
    """(N,) the same number in every step: a cost of time, or an offset.

    Args:
        value: The number.

    Example:
        ``{func: constant, weight: -0.01}``
    """
    return env.arrays.full(env.num_envs, float(value))


@quantity("reward", "metric")
def success_reward(env: TermContext, info: Info) -> Floats:
    """(N,) 1 where the task succeeds in this step, else 0. EmbodiChain's reward of the same name.

    Success is the metric `success` above 0; in a task without one, a termination of kind success or
    the environment's `evaluate`.

    Example:
        ``{func: success_reward, weight: 10.0}``
    """
    return env.arrays.of(info["success"]).astype(np.float64)


@quantity("reward", "metric")
def is_terminated(env: TermContext, info: Info) -> Floats:
    """(N,) 1 where a termination of kind success or fail ends the episode, else 0.

    A time-out is a truncation, not a termination. The reward of an environment that diverges is 0.
    Isaac Lab's reward of the same name: give it a negative weight.

    Example:
        ``{func: is_terminated, weight: -200.0}``
    """
    return _read_terminated(env, info).astype(np.float64)


@quantity("reward", "metric")
def is_alive(env: TermContext, info: Info) -> Floats:
    """(N,) 1 where `is_terminated` is 0, and 0 where it is 1. Isaac Lab's reward of the same name.

    Example:
        ``{func: is_alive, weight: 1.0}``
    """
    return (~_read_terminated(env, info)).astype(np.float64)


def _read_terminated(env: TermContext, info: Info) -> Mask:
    """(N,) where a termination of kind success or fail ends the episode."""
    if env.cfg.ignore_terminations:
        return env.arrays.full(env.num_envs, False, np.bool_)
    return env.arrays.of(info["success_terminated"] | info["fail"])


@quantity("termination", "metric")
def time_out(env: TermContext, time_limit_s: Positive) -> Mask:
    """True once an episode has lasted a given time, this step included.

    As a termination it truncates: its kind is ``time_out`` unless another one is written.

    Args:
        time_limit_s: Seconds of simulated time, rounded to control steps.

    Example:
        ``{func: time_out, params: {time_limit_s: 5.0}}``
    """
    steps = max(1, round(time_limit_s / env.step_dt))
    return env.read_elapsed_steps() >= steps


class _Clock(Term):
    """Seconds since each episode's first observation."""

    # `_start` is what the simulation's time was, `_fresh` where the next reading starts the clock.
    saved = ("_start", "_fresh")

    def __init__(self, env: TermContext) -> None:
        self._env = env
        self._start: Floats = env.arrays.full(env.num_envs, 0.0)
        self._fresh: Mask = env.arrays.full(env.num_envs, True, np.bool_)

    def read(self) -> Floats:
        """Read the clock, (N,) s; it starts at its first reading in an episode."""
        now = self._env.sim.engine.state("time")[:, 0]
        if may_be_set(self._fresh):
            self._start = np.where(self._fresh, now, self._start)
            self._fresh = np.zeros_like(self._fresh)
        return now - self._start

    def limit(self) -> float:
        """Longest duration of an episode in seconds.

        Raises:
            ConfigError: If the task has no limit.
        """
        if self._env.max_episode_steps == NO_LIMIT:
            message = "the task has no time limit (max_episode_steps: -1): nothing remains"
            raise ConfigError([Problem("", message)])
        return self._env.max_episode_steps * self._env.step_dt

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Restart the time of these environments at the next observation."""
        self._fresh[slice(None) if env_ids is None else env_ids] = True


@quantity("observation", name="current_time_s")
class CurrentTime(_Clock):
    """(N,) seconds since the episode began; 0 right after a reset. Isaac Lab's name.

    Example:
        ``{func: current_time_s}``
    """

    def __call__(self) -> Floats:
        """(N,)."""
        return self.read()


@quantity("observation", name="remaining_time_s")
class RemainingTime(_Clock):
    """(N,) seconds until the episode is truncated by ``max_episode_steps``. Isaac Lab's name.

    Example:
        ``{func: remaining_time_s}``
    """

    def __init__(self, env: TermContext) -> None:
        super().__init__(env)
        self.limit()

    def __call__(self) -> Floats:
        """(N,)."""
        return self.limit() - self.read()


@quantity("observation", name="elapsed_fraction")
class ElapsedFraction(RemainingTime):
    """(N,) elapsed fraction of the longest episode (``max_episode_steps``), from 0 to 1.

    With it a value function can predict the time limit (Pardo et al., "Time limits in
    reinforcement learning", ICML 2018).

    Example:
        ``{func: elapsed_fraction}``
    """

    def __call__(self) -> Floats:
        """(N,)."""
        return self.read() / self.limit()


@quantity("observation", name="phase")
class Phase(_Clock):
    """(N, 2 K) sine and cosine of 2 pi (t / period + offset), t the episode's time; K offsets.

    A clock for gaits and other cycles: sin, cos of the first offset, then of the second...

    Args:
        period_s: Seconds per cycle.
        offsets: Phases at t = 0, in periods, one for each pair of columns.

    Example:
        ``{func: phase, params: {period_s: 0.8, offsets: [0.0, 0.5]}}``
    """

    def __init__(
        self,
        env: TermContext,
        period_s: Positive,
        offsets: Annotated[Sequence[Finite], Field(min_length=1)] = (0.0,),
    ) -> None:
        super().__init__(env)
        self._period = float(period_s)
        self._offsets = [float(offset) for offset in offsets]

    def __call__(self) -> Floats:
        """(N, 2 K)."""
        cycles = self.read() / self._period
        columns = np.empty_like(cycles, shape=(len(cycles), 2 * len(self._offsets)))
        for i, offset in enumerate(self._offsets):
            angle = 2.0 * np.pi * (cycles + offset)
            columns[:, 2 * i] = np.sin(angle)
            columns[:, 2 * i + 1] = np.cos(angle)
        return columns


@quantity("observation", name="last_action")
class LastAction(Term):
    """(N, A) the action of the last step, as given: before clip, delay and noise.

    Zeros after a reset. Isaac Lab's and mjlab's observation of the same name.

    Args:
        action_name: An action term, to observe only its slice; None is the whole action.

    Example:
        ``{func: last_action}``
    """

    def __init__(self, env: TermContext, action_name: str | None = None) -> None:
        declared = env.cfg.actions
        if action_name is not None and action_name not in declared:
            names = ", ".join(declared) or "none"
            message = f"no action term is called {action_name!r}; there are: {names}"
            hint = did_you_mean(action_name, declared).strip()
            raise ConfigError([Problem("action_name", message, hint)])
        self._env = env
        self._name = action_name

    @property
    def column_names(self) -> tuple[str, ...]:
        """Name of each column: ``TERM/JOINT``."""
        manager = self._env.action_manager
        if self._name is None:
            return manager.names
        return manager.names[manager.slices[self._name]]

    def __call__(self) -> Floats:
        """(N, A)."""
        action = self._env.read_last_action()
        if self._name is None:
            return action
        return action[:, self._env.action_manager.slices[self._name]]

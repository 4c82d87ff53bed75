"""The loop of `run`: act, step, count, show; ends when every environment has had its episodes.

Building the environment, logs and folders happen elsewhere: this only plays.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from embodichain.cli.progress import ProgressDisplay
from embodichain.cli.stopping import StopFlag
from embodichain.learning.episode_statistics import (
    EpisodeStatistics,
    ended_values,
)

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.policies import Policy

__all__ = ["Outcome", "play"]

Status = Literal["finished", "max_steps", "interrupted"]


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a rollout ended.

    Attributes:
        status: ``finished``: every environment had its episodes; ``max_steps``: the limit came
            first; ``interrupted``: a signal did.
        statistics: What was counted.
        seconds: Wall time of the loop.
        signal: The signal's name, when interrupted.
    """

    status: Status
    statistics: EpisodeStatistics
    seconds: float
    signal: str | None = None

    @property
    def fps(self) -> float:
        """Environment steps a second: control steps times environments."""
        steps = self.statistics.steps * self.statistics.num_envs
        return steps / self.seconds if self.seconds > 0 else 0.0


def play(
    env: BaseEnv,
    policy: Policy,
    obs: Any,
    *,
    episodes: int,
    max_steps: int | None,
    display: ProgressDisplay,
    stop: StopFlag,
) -> Outcome:
    """Step `env` with `policy` from `obs` until something ends it; no faster than a window shows.

    Args:
        env: A batched environment that was just reset; it resets its environments itself.
        policy: Acts; told when environments begin a new episode.
        obs: What the reset returned.
        episodes: How many count for each environment.
        max_steps: Most control steps, None for no limit.
        display: Shows how far it is.
        stop: Its flag ends the loop after a whole step.
    """
    statistics = EpisodeStatistics(env.num_envs, episodes)
    has_success = env.judges_success
    limit = float("inf") if max_steps is None else max_steps
    start = time.perf_counter()
    status: Status = "finished"
    while not statistics.complete:
        if stop.stopped is not None or statistics.steps >= limit:
            status = "interrupted" if stop.stopped is not None else "max_steps"
            break
        obs, reward, terminated, truncated, info = env.step(policy(obs, env))
        done = _array(terminated) | _array(truncated)
        ended = bool(done.any())
        kept = ended_values(info, _array(terminated), has_success) if ended else {}
        statistics.add(_array(reward), done, kept)
        if ended:
            policy.reset(np.flatnonzero(done))
        if env.sim.is_window_open:  # for people who look on
            time.sleep(max(0.0, start + statistics.steps * env.step_dt - time.perf_counter()))
        if display.due:
            display.show(*_progress(statistics, max_steps, time.perf_counter() - start))
    seconds = time.perf_counter() - start
    display.show(*_progress(statistics, max_steps, seconds))
    return Outcome(status, statistics, seconds, stop.stopped)


def _array(value: Any) -> NDArray[Any]:
    """A tensor of the environment as numpy."""
    array: NDArray[Any] = value.numpy(force=True)
    return array


def _progress(
    statistics: EpisodeStatistics, max_steps: int | None, seconds: float
) -> tuple[int, dict[str, str]]:
    """How many episodes are done, and the facts beside the bar."""
    rate = statistics.steps * statistics.num_envs / seconds if seconds > 0 else 0.0
    steps = f"{statistics.steps}/{max_steps}" if max_steps is not None else f"{statistics.steps}"
    facts = {"step": steps, "FPS": f"{rate:,.0f}"}
    mean_return, success = statistics.mean("return"), statistics.mean("success")
    if mean_return:  # not 0 all along: the task pays something
        facts["return"] = f"{mean_return:.3g}"
    if success is not None:
        facts["success"] = f"{success:.0%}"
    return statistics.episodes, facts

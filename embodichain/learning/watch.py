"""`Watch`: the callback that counts, logs, writes checkpoints and stops on rollout boundaries.

`TimeSplit` divides the wall time of a training into physics, environment, policy and update.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from embodichain.learning.episodes import TrainStatistics
from embodichain.learning.train_logs import log_curriculum, log_episode, log_fractions
from embodichain.learning.vec_env import SB3VecEnv

__all__ = ["PARTS", "Progress", "TimeSplit", "Watch"]

Progress = Callable[[TrainStatistics], None]
"""Is called after every control step. KeyboardInterrupt stops at the next rollout boundary."""


class Watch(BaseCallback):
    """Counts steps and episodes; acts where a rollout begins, after the update of the last one.

    Args:
        env: What is learned in, without wrappers.
        statistics: Where to count.
        progress: Called after every control step.
        on_boundary: Called as each rollout begins.

    Attributes:
        stopped: What `progress` raised to stop the training; None while it goes on.
    """

    def __init__(
        self,
        env: SB3VecEnv,
        statistics: TrainStatistics,
        progress: Progress | None,
        on_boundary: Callable[[], None],
    ) -> None:
        super().__init__()
        self.stopped: KeyboardInterrupt | None = None
        self._env = env
        self._split = TimeSplit()
        self._statistics = statistics
        self._progress = progress
        self._on_boundary = on_boundary

    def _on_rollout_start(self) -> None:
        self._on_boundary()
        self._split.rollout_begins(self._env)
        if self.stopped is not None:
            raise self.stopped

    def _on_step(self) -> bool:
        statistics = self._statistics
        statistics.env_steps = self.num_timesteps
        infos = self.locals["infos"]
        for i in np.flatnonzero(self.locals["dones"]).tolist():
            statistics.add(infos[i])
            log_episode(self.logger, infos[i])
        if self._progress is not None and self.stopped is None:
            try:
                self._progress(statistics)
            except KeyboardInterrupt as error:
                self.stopped = error  # the rollout and its update come first: nothing is lost
        return True

    def _on_rollout_end(self) -> None:
        self._split.rollout_ends(self._env)
        self._statistics.fractions = self._split.fractions
        log_fractions(self.logger, self._split.fractions)
        log_curriculum(self.logger, self._env.base.curriculum_manager.values)

    def end(self) -> None:
        """Learning ended, in whatever way: what came after the last rollout counts."""
        self._split.end()
        self._statistics.fractions = self._split.fractions


PARTS = ("physics", "environment", "policy", "update")
"""Physics steps; what else `env.step` does (observations, rewards, resets); what else a rollout
does (actions of the policy, buffers, statistics); what lies between two rollouts (the algorithm's
update, logs, checkpoints)."""


@dataclasses.dataclass
class TimeSplit:
    """Seconds by part, told where rollouts begin and end.

    Attributes:
        physics: See `PARTS`.
        environment: Likewise.
        policy: Likewise.
        update: Likewise.
    """

    physics: float = 0.0
    environment: float = 0.0
    policy: float = 0.0
    update: float = 0.0
    _mark: float | None = None
    _before: tuple[float, float] = (0.0, 0.0)

    @property
    def seconds(self) -> dict[str, float]:
        """Seconds of each part so far."""
        return {name: getattr(self, name) for name in PARTS}

    @property
    def fractions(self) -> dict[str, float]:
        """Share of each part in all of them, 0 to 1; empty before the end of the first rollout."""
        total = sum(self.seconds.values())
        return {name: value / total for name, value in self.seconds.items()} if total > 0 else {}

    def rollout_begins(self, env: SB3VecEnv) -> None:
        """A rollout begins: what lay between the last one and this is the update's."""
        self.update += self._lap()
        self._before = _spent(env)

    def rollout_ends(self, env: SB3VecEnv) -> None:
        """A rollout ended, and the algorithm's update begins."""
        whole, (physics, steps) = self._lap(), _spent(env)
        physics, steps = physics - self._before[0], steps - self._before[1]
        self.physics += physics
        self.environment += steps - physics
        self.policy += whole - steps

    def end(self) -> None:
        """Learning ends: what came after the last rollout is the update's."""
        self.update += self._lap()
        self._mark = None

    def _lap(self) -> float:
        """Seconds since the last call; 0 in the first."""
        before, self._mark = self._mark, time.perf_counter()
        return 0.0 if before is None else self._mark - before


def _spent(env: SB3VecEnv) -> tuple[float, float]:
    return env.base.sim.physics_seconds, env.step_seconds

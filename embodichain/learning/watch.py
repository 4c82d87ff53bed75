"""`Watch`: the callback that counts, logs, writes checkpoints and stops on rollout boundaries.

What is counted is in `episodes.py` and `time_split.py`, what is logged in `train_logs.py`, what is
written in `checkpoint.py`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from embodichain.learning.episodes import TrainStatistics
from embodichain.learning.time_split import TimeSplit
from embodichain.learning.train_logs import log_curriculum, log_episode, log_fractions
from embodichain.learning.vec_env import SB3VecEnv

__all__ = ["Progress", "Watch"]

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

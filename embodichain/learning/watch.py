"""`Watch`: the callback that counts, logs, writes checkpoints and stops on rollout boundaries.

What is counted is in `episodes.py`, what is written in `checkpoint.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from embodichain.learning.episodes import TrainStatistics
from embodichain.learning.vec_env import ENDS

__all__ = ["Progress", "Watch"]

Progress = Callable[[TrainStatistics], None]
"""Is called after every control step. KeyboardInterrupt stops at the next rollout boundary."""


class Watch(BaseCallback):
    """Counts steps and episodes; acts where a rollout begins, after the update of the last one.

    Args:
        statistics: Where to count.
        progress: Called after every control step.
        on_boundary: Called as each rollout begins.

    Attributes:
        stopped: What `progress` raised to stop the training; None while it goes on.
    """

    def __init__(
        self,
        statistics: TrainStatistics,
        progress: Progress | None,
        on_boundary: Callable[[], None],
    ) -> None:
        super().__init__()
        self.stopped: KeyboardInterrupt | None = None
        self._statistics = statistics
        self._progress = progress
        self._on_boundary = on_boundary

    def _on_rollout_start(self) -> None:
        self._on_boundary()
        if self.stopped is not None:
            raise self.stopped

    def _on_step(self) -> bool:
        statistics = self._statistics
        statistics.env_steps = self.num_timesteps
        infos = self.locals["infos"]
        for i in np.flatnonzero(self.locals["dones"]).tolist():
            statistics.add(infos[i])
            self._log(infos[i])
        if self._progress is not None and self.stopped is None:
            try:
                self._progress(statistics)
            except KeyboardInterrupt as error:
                self.stopped = error  # the rollout and its update come first: nothing is lost
        return True

    def _log(self, info: dict[str, Any]) -> None:
        """Sums of reward terms and what ended the episode, averaged until they are written."""
        for name, value in info["reward_sums"].items():
            self.logger.record_mean(f"Episode_Reward/{name}", value)
        for kind in ENDS:
            self.logger.record_mean(f"Episode_Termination/{kind}", float(info["ended_by"] == kind))

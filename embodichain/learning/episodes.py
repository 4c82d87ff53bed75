"""`TrainStatistics`: how a training goes, counted while it runs, and the callback that counts.

What is kept of it in files is in `train.py`; how people see it, in the command line.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

__all__ = ["EPISODE_WINDOW", "Progress", "TrainStatistics", "Watch"]

EPISODE_WINDOW = 200
"""Episodes that `mean_return` and `success_rate` look back."""


class TrainStatistics:
    """What a training has done so far.

    Args:
        total_timesteps: Environment steps wanted, summed over environments.

    Attributes:
        env_steps: Environment steps taken.
        episodes: Episodes finished.
    """

    def __init__(self, total_timesteps: int) -> None:
        self.total_timesteps = total_timesteps
        self.env_steps = 0
        self.episodes = 0
        self._returns: deque[float] = deque(maxlen=EPISODE_WINDOW)
        self._successes: deque[bool] = deque(maxlen=EPISODE_WINDOW)
        self._start = time.perf_counter()
        self._end: float | None = None

    def add(self, info: dict[str, Any]) -> None:
        """Count an episode that ended, from its info."""
        self.episodes += 1
        self._returns.append(info["episode"]["r"])
        if "is_success" in info:
            self._successes.append(info["is_success"])

    def begin(self) -> None:
        """Start the clock."""
        self._start, self._end = time.perf_counter(), None

    def end(self) -> None:
        """Stop the clock."""
        self._end = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Wall time of learning."""
        return (self._end if self._end is not None else time.perf_counter()) - self._start

    @property
    def env_steps_per_second(self) -> float:
        """Environment steps a second, learning included."""
        return self.env_steps / self.seconds if self.seconds > 0 else 0.0

    @property
    def mean_return(self) -> float | None:
        """Mean over the last episodes; None before the first."""
        return float(np.mean(self._returns)) if self._returns else None

    @property
    def success_rate(self) -> float | None:
        """Share of the last episodes; None before the first, or for a task without success."""
        return float(np.mean(self._successes)) if self._successes else None


Progress = Callable[[TrainStatistics], None]
"""Is called after every control step; what it raises ends the training."""


class Watch(BaseCallback):
    """Counts steps and episodes for `TrainStatistics`.

    Args:
        statistics: Where to.
        progress: Called after every control step.
    """

    def __init__(self, statistics: TrainStatistics, progress: Progress | None) -> None:
        super().__init__()
        self._statistics = statistics
        self._progress = progress

    def _on_step(self) -> bool:
        statistics = self._statistics
        statistics.env_steps = self.num_timesteps
        infos = self.locals["infos"]
        for i in np.flatnonzero(self.locals["dones"]).tolist():
            statistics.add(infos[i])
        if self._progress is not None:
            self._progress(statistics)
        return True

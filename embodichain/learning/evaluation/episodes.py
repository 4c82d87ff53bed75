"""`TrainStatistics`: statistics of a training while it runs."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["EPISODE_WINDOW", "TrainStatistics"]

EPISODE_WINDOW = 200
"""Number of last episodes that `mean_return` and `success_rate` are taken over by default."""


class TrainStatistics:
    """The progress of a training.

    Args:
        total_timesteps: Length of the training in environment steps, summed over environments.
        window: Number of last episodes that means are taken over.

    Attributes:
        env_steps: Environment steps taken.
        episodes: Episodes finished.
        fractions: Share of the wall time by part (`TimeSplit.fractions`); empty at first.
        best: Environment steps and score of the best checkpoint; None before the first.
        next_checkpoint: Environment steps at which a checkpoint is due; None before the first
            rollout.
    """

    def __init__(self, total_timesteps: int, window: int = EPISODE_WINDOW) -> None:
        self.total_timesteps = total_timesteps
        self.env_steps = 0
        self.episodes = 0
        self.fractions: dict[str, float] = {}
        self.best: tuple[int, tuple[float, float]] | None = None
        self.next_checkpoint: int | None = None
        self._returns: deque[float] = deque(maxlen=window)
        self._lengths: deque[int] = deque(maxlen=window)
        self._successes: deque[bool] = deque(maxlen=window)
        self._before = 0.0
        self._start = time.perf_counter()
        self._end: float | None = None

    def add(self, info: dict[str, Any]) -> None:
        """Count an episode that ended, from its info."""
        self.episodes += 1
        self._returns.append(info["episode"]["r"])
        self._lengths.append(info["episode"]["l"])
        if "is_success" in info:
            self._successes.append(info["is_success"])

    def extend(
        self, returns: ArrayLike, lengths: ArrayLike, successes: ArrayLike | None = None
    ) -> None:
        """Count episodes that ended, (E,) each; without successes if success is undefined."""
        self.episodes += len(np.asarray(returns))
        self._returns.extend(np.asarray(returns).tolist())
        self._lengths.extend(np.asarray(lengths, np.int64).tolist())
        if successes is not None:
            self._successes.extend(np.asarray(successes, np.bool_).tolist())

    def begin(self) -> None:
        """Start the clock."""
        self._start = time.perf_counter()
        self._end = None

    def end(self) -> None:
        """Stop the clock."""
        self._end = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Wall time of learning."""
        end = self._end if self._end is not None else time.perf_counter()
        return self._before + end - self._start

    @property
    def env_steps_per_second(self) -> float:
        """Environment steps per second, learning included."""
        if self.seconds <= 0:
            return 0.0
        return self.env_steps / self.seconds

    @property
    def mean_return(self) -> float | None:
        """Mean over the last episodes; None before the first."""
        return _mean(self._returns)

    @property
    def mean_length(self) -> float | None:
        """Mean control steps of the last episodes; None before the first."""
        return _mean(self._lengths)

    @property
    def success_rate(self) -> float | None:
        """Success rate of the last episodes; None before the first, or if success is undefined."""
        return _mean(self._successes)

    def state_dict(self) -> dict[str, Any]:
        """Return the statistics, for resuming the training."""
        return {
            "episodes": self.episodes,
            "returns": list(self._returns),
            "lengths": list(self._lengths),
            "successes": list(self._successes),
            "seconds": self.seconds,
            "best": self.best,
            "next_checkpoint": self.next_checkpoint,
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from saved statistics, including the seconds of learning."""
        self.episodes = saved["episodes"]
        self._returns.extend(saved["returns"])
        self._lengths.extend(saved["lengths"])
        self._successes.extend(saved["successes"])
        self._before = saved["seconds"]
        self.best = saved["best"]
        self.next_checkpoint = saved["next_checkpoint"]

    @property
    def score(self) -> tuple[float, float] | None:
        """Score of a checkpoint: success rate, then mean return; None before the first episode."""
        mean_return = self.mean_return
        if mean_return is None:
            return None
        success_rate = self.success_rate
        if success_rate is None:  # success is undefined: the return decides alone
            success_rate = 0.0
        return success_rate, mean_return


def _mean(values: deque[Any]) -> float | None:
    """Return the mean of some values; None without any."""
    if not values:
        return None
    return float(np.mean(values))

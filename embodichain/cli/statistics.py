"""Episodes counted over a batch: returns, lengths, successes of the first few of each environment.

Numpy only; knows neither environments nor terminals.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["EpisodeStatistics"]

Flags = NDArray[np.bool_]


class EpisodeStatistics:
    """Counts what N environments finish.

    Args:
        num_envs: N.
        quota: Episodes that count for each environment; later ones are ignored, so that
            environments with short episodes do not weigh more.
    """

    def __init__(self, num_envs: int, quota: int) -> None:
        self.num_envs, self.quota = num_envs, quota
        self.counts = np.zeros(num_envs, np.int64)
        """(N,) episodes finished and counted."""
        self.steps = 0
        """Control steps of the batch."""
        self._return = np.zeros(num_envs)
        self._length = np.zeros(num_envs, np.int64)
        self._missing = num_envs * quota
        self._records: list[dict[str, NDArray[Any]]] = []

    @property
    def complete(self) -> bool:
        """Whether every environment has finished its quota."""
        return self._missing == 0

    @property
    def episodes(self) -> int:
        """Episodes counted so far, over all environments."""
        return self.num_envs * self.quota - self._missing

    def add(self, reward: NDArray[Any], done: Flags, values: Mapping[str, NDArray[Any]]) -> None:
        """Count one control step.

        Args:
            reward: (N,) of the step.
            done: (N,) whether the episode ended with it.
            values: What to keep of an episode that ends now, each (N,).
        """
        self.steps += 1
        self._return += reward
        self._length += 1
        if done.any():
            self._finish(done, values)

    def _finish(self, done: Flags, values: Mapping[str, NDArray[Any]]) -> None:
        ids = np.flatnonzero(done & (self.counts < self.quota))
        if ids.size:
            record = {name: np.asarray(value)[ids] for name, value in values.items()}
            record |= {"env": ids, "episode": self.counts[ids]}
            record |= {"return": self._return[ids], "length": self._length[ids]}
            self._records.append(record)
            self.counts[ids] += 1
            self._missing -= ids.size
        self._return[done] = 0.0
        self._length[done] = 0

    def column(self, name: str) -> NDArray[Any]:
        """(E,) one value of every counted episode, in the order they ended."""
        parts = [record[name] for record in self._records if name in record]
        return np.concatenate(parts) if parts else np.zeros(0)

    def names(self) -> list[str]:
        """What `column` can give."""
        return list(dict.fromkeys(name for record in self._records for name in record))

    def mean(self, name: str) -> float | None:
        """Mean over the counted episodes, None before the first."""
        column = self.column(name)
        return float(column.mean()) if column.size else None

"""Numbers that say how far to trust a mean: interquartile mean, bootstrap and Wilson intervals.

Plain numpy; knows neither episodes nor environments.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["CONFIDENCE", "Estimate", "Rate", "bootstrap", "estimate", "iqm", "rate"]

CONFIDENCE = 0.95
"""Share of repetitions in which an interval holds the true value, about."""
RESAMPLES = 2000
"""Resamples of a bootstrap: its ends then move by a few percent of its width."""
_SEED = 0  # of the bootstrap's own generator: the same values always give the same interval
_MOST_VALUES = 4_000_000  # drawn at once: 32 MB, however many episodes there are
_NORMAL_975 = 1.959963984540054  # 97.5 % quantile of the standard normal distribution

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Estimate:
    """A quantity of which several values were seen.

    Attributes:
        mean: Arithmetic mean.
        median: The value in the middle.
        iqm: Interquartile mean, see `iqm`.
        std: Standard deviation of the values (divided by their number).
        min: The smallest.
        max: The largest.
        mean_interval: Bootstrap interval of the mean, (low, high); None with a single value.
        iqm_interval: Likewise of the interquartile mean.
    """

    mean: float
    median: float
    iqm: float
    std: float
    min: float
    max: float
    mean_interval: tuple[float, float] | None
    iqm_interval: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class Rate:
    """How often something happened.

    Attributes:
        rate: Share of the trials.
        count: Trials in which it happened.
        trials: All of them.
        interval: Wilson's score interval of the rate, (low, high).
    """

    rate: float
    count: int
    trials: int
    interval: tuple[float, float]


def iqm(values: ArrayLike, axis: int = -1) -> F64:
    """Interquartile mean: the mean without the lowest and the highest quarter.

    A quarter is rounded down to whole values, as ``scipy.stats.trim_mean(values, 0.25)`` does.

    Args:
        values: At least one along `axis`.
        axis: Which is reduced.
    """
    ordered = np.sort(np.asarray(values, np.float64), axis=axis)
    count = ordered.shape[axis]
    cut = count // 4
    middle: F64 = np.take(ordered, np.arange(cut, count - cut), axis=axis).mean(axis=axis)
    return middle


def bootstrap(
    values: ArrayLike, statistic: Callable[..., F64], confidence: float = CONFIDENCE
) -> tuple[float, float] | None:
    """Percentile bootstrap interval of a statistic (Efron, 1979).

    Draws come from a generator of its own with a fixed seed, so the same values give the same
    interval and nobody else's numbers change.

    Args:
        values: (n,).
        statistic: Reduces the last axis; called as ``statistic(samples, axis=-1)``.
        confidence: Between 0 and 1.

    Returns:
        (low, high), or None for fewer than two values: one says nothing about spread.
    """
    data = np.asarray(values, np.float64)
    if data.size < 2:
        return None
    generator = np.random.default_rng(_SEED)
    rows = max(1, min(RESAMPLES, _MOST_VALUES // data.size))
    parts = []
    for first in range(0, RESAMPLES, rows):
        shape = (min(rows, RESAMPLES - first), data.size)
        parts.append(statistic(data[generator.integers(0, data.size, shape)], axis=-1))
    tail = (1.0 - confidence) / 2.0
    low, high = np.quantile(np.concatenate(parts), (tail, 1.0 - tail))
    return float(low), float(high)


def estimate(values: ArrayLike) -> Estimate | None:
    """Sum up values; None for none.

    Args:
        values: (n,).
    """
    data = np.asarray(values, np.float64)
    if not data.size:
        return None
    return Estimate(
        mean=float(data.mean()),
        median=float(np.median(data)),
        iqm=float(iqm(data)),
        std=float(data.std()),
        min=float(data.min()),
        max=float(data.max()),
        mean_interval=bootstrap(data, np.mean),
        iqm_interval=bootstrap(data, iqm),
    )


def rate(happened: ArrayLike) -> Rate | None:
    """Sum up yes-or-no values with Wilson's score interval at 95 % (Wilson, 1927); None for none.

    Unlike a bootstrap it does not shrink to a point where all trials agree.

    Args:
        happened: (n,) truth values.
    """
    data = np.asarray(happened, np.bool_)
    trials, count = int(data.size), int(data.sum())
    if not trials:
        return None
    share, square = count / trials, _NORMAL_975**2
    spread = 1.0 + square / trials
    centre = (share + square / (2 * trials)) / spread
    half = math.sqrt(share * (1 - share) / trials + square / (4 * trials**2))
    half *= _NORMAL_975 / spread
    return Rate(share, count, trials, (max(0.0, centre - half), min(1.0, centre + half)))

"""Statistics of evaluations: interquartile mean, bootstrap and Wilson intervals.

scipy computes them. It is imported at the first use, since that takes half as long as torch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["CONFIDENCE", "Estimate", "Rate", "bootstrap", "estimate", "iqm", "rate"]

CONFIDENCE = 0.95
"""Confidence level: approximate share of repetitions whose interval contains the true value."""
RESAMPLES = 2000
"""Resamples of a bootstrap; its ends then vary by a few percent of its width."""
_SEED = 0  # of the bootstrap's separate generator: the same values give the same interval
_MOST_VALUES = 4_000_000  # drawn at once: 32 MB for any number of episodes

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Estimate:
    """A summary of several values of a quantity.

    Attributes:
        mean: Arithmetic mean.
        median: Median.
        iqm: Interquartile mean, see `iqm`.
        std: Standard deviation of the values (divided by their number).
        min: The smallest.
        max: The largest.
        mean_interval: Bootstrap interval of the mean, (low, high); None with a single value.
        iqm_interval: Bootstrap interval of the interquartile mean, likewise.
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
    """The rate of an event, such as success.

    Attributes:
        rate: Share of the trials with the event.
        count: Number of trials with the event.
        trials: Number of trials.
        interval: Wilson's score interval of the rate, (low, high).
    """

    rate: float
    count: int
    trials: int
    interval: tuple[float, float]


def iqm(values: ArrayLike, axis: int = -1) -> F64:
    """Interquartile mean: the mean without the lowest and the highest quarter.

    A quarter is rounded down to whole values.

    Args:
        values: At least one along `axis`.
        axis: The axis to reduce.
    """
    from scipy.stats import trim_mean

    middle: F64 = trim_mean(np.asarray(values, np.float64), 0.25, axis=axis)
    return middle


def bootstrap(
    values: ArrayLike, statistic: Callable[..., Any], confidence: float = CONFIDENCE
) -> tuple[F64, F64] | None:
    """Percentile bootstrap interval of a statistic over the first axis (Efron, 1979).

    Draws come from a separate generator with a fixed seed: the same values give the same interval,
    and no other random numbers change.

    Args:
        values: (n, ...).
        statistic: Reduces an axis; called as ``statistic(samples, axis=...)``.
        confidence: Between 0 and 1.

    Returns:
        (low, high), each (...); None for fewer than two values.
    """
    from scipy.stats import bootstrap as scipy_bootstrap

    data = np.asarray(values, np.float64)
    if len(data) < 2:
        return None
    found = scipy_bootstrap(
        (data,),
        statistic,
        n_resamples=RESAMPLES,
        batch=max(1, min(RESAMPLES, _MOST_VALUES // data.size)),
        axis=0,
        vectorized=True,
        confidence_level=confidence,
        method="percentile",
        rng=np.random.default_rng(_SEED),
    ).confidence_interval
    return found.low, found.high


def estimate(values: ArrayLike) -> Estimate | None:
    """Summarize values; None if there are none.

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
        mean_interval=_interval(data, np.mean),
        iqm_interval=_interval(data, iqm),
    )


def _interval(data: F64, statistic: Callable[..., Any]) -> tuple[float, float] | None:
    found = bootstrap(data, statistic)
    return None if found is None else (float(found[0]), float(found[1]))


def rate(happened: ArrayLike) -> Rate | None:
    """Summarize booleans with Wilson's 95 % score interval (Wilson, 1927); None if there are none.

    Unlike a bootstrap interval, it does not shrink to a point if all trials agree.

    Args:
        happened: (n,) booleans.
    """
    from scipy.stats import binomtest

    data = np.asarray(happened, np.bool_)
    trials, count = int(data.size), int(data.sum())
    if not trials:
        return None
    ends = binomtest(count, trials).proportion_ci(CONFIDENCE, method="wilson")
    return Rate(count / trials, count, trials, (float(ends.low), float(ends.high)))

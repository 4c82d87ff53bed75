"""Statistics of evaluations: interquartile mean, intervals over episodes and over seeds.

scipy computes them. It is imported at the first use, since that takes half as long as torch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "CONFIDENCE",
    "LEAST_SEEDS",
    "Estimate",
    "Rate",
    "SeedEstimate",
    "bootstrap",
    "estimate",
    "iqm",
    "over_seeds",
    "rate",
]

CONFIDENCE = 0.95
"""Confidence level: approximate share of repetitions whose interval contains the true value."""
LEAST_SEEDS = 5
"""Seeds below which an interval over them says nothing: a t interval of two is 9 standard
deviations wide, and a bootstrap's is their smallest and largest value."""
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


@dataclass(frozen=True, slots=True)
class SeedEstimate:
    """A summary of a number over trainings that differ by their seed.

    Attributes:
        mean: Mean over the seeds.
        median: Median.
        std: Standard deviation of the values (divided by their number less one); None with one.
        min: The smallest.
        max: The largest.
        values: The number of each seed.
        mean_interval: 95 % interval of the mean, (low, high), see `over_seeds`; None below
            `LEAST_SEEDS` seeds.
        note: Why there is no interval; None if there is one.
    """

    mean: float
    median: float
    std: float | None
    min: float
    max: float
    values: tuple[float, ...]
    mean_interval: tuple[float, float] | None
    note: str | None


def iqm(values: ArrayLike, axis: int = -1) -> F64:
    """Interquartile mean: the mean without the lowest and the highest quarter.

    A quarter is rounded down to whole values.

    Args:
        values: At least one along `axis`.
        axis: The axis to reduce.
    """
    from scipy.stats import trim_mean

    return trim_mean(np.asarray(values, np.float64), 0.25, axis=axis)


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
    result = scipy_bootstrap(
        (data,),
        statistic,
        n_resamples=RESAMPLES,
        batch=max(1, min(RESAMPLES, _MOST_VALUES // data.size)),
        axis=0,
        vectorized=True,
        confidence_level=confidence,
        method="percentile",
        rng=np.random.default_rng(_SEED),
    )
    interval = result.confidence_interval
    return interval.low, interval.high


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
    interval = bootstrap(data, statistic)
    if interval is None:
        return None
    low, high = interval
    return float(low), float(high)


def over_seeds(values: ArrayLike, trials: ArrayLike | None = None) -> SeedEstimate | None:
    """Summarize a number over seeds: their mean, with an interval for what further seeds would do.

    The interval is the wider of two: Student's t interval over the seeds, for what differs from
    seed to seed, and of a rate Wilson's over the episodes of all seeds, as seeds that happen to
    agree (all at 0 %) still played only so many. That of a rate is clipped to [0, 1].

    Args:
        values: (n,) the number of each seed, a mean over its episodes.
        trials: (n,) for a rate, the episodes of each seed; 0 where unknown.

    Returns:
        The summary; None without values.
    """
    data = np.asarray(values, np.float64)
    if not data.size:
        return None
    std = float(data.std(ddof=1)) if data.size > 1 else None
    interval: tuple[float, float] | None = None
    note: str | None = None
    if std is None or data.size < LEAST_SEEDS:
        seeds = "1 seed" if data.size == 1 else f"{data.size} seeds"
        note = f"{seeds}: an interval over seeds needs at least {LEAST_SEEDS}"
    elif trials is None:
        interval = _student(data, std)
    else:
        interval = _rate_interval(data, std, np.asarray(trials, np.int64))
    return SeedEstimate(
        mean=float(data.mean()),
        median=float(np.median(data)),
        std=std,
        min=float(data.min()),
        max=float(data.max()),
        values=tuple(data.tolist()),
        mean_interval=interval,
        note=note,
    )


def _student(data: F64, std: float) -> tuple[float, float]:
    """Return Student's t interval of a mean, (low, high)."""
    from scipy.stats import t

    half = float(t.ppf(0.5 + CONFIDENCE / 2, data.size - 1)) * std / data.size**0.5
    mean = float(data.mean())
    return mean - half, mean + half


def _rate_interval(rates: F64, std: float, trials: NDArray[np.int64]) -> tuple[float, float]:
    """Return the wider of Student's interval over seeds and Wilson's over all their episodes."""
    low, high = _student(rates, std)
    low = max(low, 0.0)
    high = min(high, 1.0)
    if not trials.any():
        return low, high
    pooled_low, pooled_high = _wilson(int(np.rint(rates * trials).sum()), int(trials.sum()))
    if pooled_high - pooled_low > high - low:
        return pooled_low, pooled_high
    return low, high


def _wilson(count: int, trials: int) -> tuple[float, float]:
    """Return Wilson's 95 % score interval of a rate (Wilson, 1927)."""
    from scipy.stats import binomtest

    ends = binomtest(count, trials).proportion_ci(CONFIDENCE, method="wilson")
    return float(ends.low), float(ends.high)


def rate(happened: ArrayLike) -> Rate | None:
    """Summarize booleans with Wilson's 95 % score interval (Wilson, 1927); None if there are none.

    Unlike a bootstrap interval, it does not shrink to a point if all trials agree.

    Args:
        happened: (n,) booleans.
    """
    data = np.asarray(happened, np.bool_)
    trials = int(data.size)
    if not trials:
        return None
    count = int(data.sum())
    return Rate(rate=count / trials, count=count, trials=trials, interval=_wilson(count, trials))

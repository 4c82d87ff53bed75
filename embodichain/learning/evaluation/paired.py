"""Two policies on the same starts: differences of pairs of episodes.

Episodes that begin in the same state differ only by what the policies do, so their differences vary
less than the results themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from embodichain.learning.evaluation.statistics import bootstrap, rate

__all__ = ["PairedRates", "PairedValues", "compare_rates", "compare_values"]


@dataclass(frozen=True, slots=True)
class PairedRates:
    """Success of two policies on the same starts.

    Attributes:
        pairs: Number of starts.
        only_first: Number of starts where only the first policy succeeded.
        only_second: Number of starts where only the second one did.
        difference: Success rate of the first less that of the second.
        interval: 95 % interval of the difference (Newcombe, 1998), (low, high).
        p_value: Of McNemar's exact test (1947): how probable a split as uneven as this one is if
            the policies are equally good.
    """

    pairs: int
    only_first: int
    only_second: int
    difference: float
    interval: tuple[float, float]
    p_value: float


@dataclass(frozen=True, slots=True)
class PairedValues:
    """A number of two policies on the same starts.

    Attributes:
        pairs: Number of starts.
        difference: Mean of the first less mean of the second.
        interval: 95 % bootstrap interval of the difference, pairs drawn anew; None with one pair.
    """

    pairs: int
    difference: float
    interval: tuple[float, float] | None


def compare_rates(first: ArrayLike, second: ArrayLike) -> PairedRates:
    """Compare two policies by their successes.

    The interval is Newcombe's tenth method: Wilson's intervals of both rates, joined with the
    correlation of the pairs. Unlike a bootstrap it does not shrink to a point where all pairs
    agree.

    Args:
        first: (n,) booleans, the successes of the first policy.
        second: (n,) those of the second, on the same starts in the same order.

    Raises:
        ValueError: The lengths differ, or there is no pair.
    """
    from scipy.stats import binomtest

    one = np.asarray(first, np.bool_)
    other = np.asarray(second, np.bool_)
    _check_pairs(one, other)
    only_first = int(np.sum(one & ~other))
    only_second = int(np.sum(other & ~one))
    undecided = only_first + only_second
    p_value = float(binomtest(only_first, undecided).pvalue) if undecided else 1.0
    return PairedRates(
        pairs=int(one.size),
        only_first=only_first,
        only_second=only_second,
        difference=float(one.mean() - other.mean()),
        interval=_newcombe(one, other),
        p_value=p_value,
    )


def compare_values(first: ArrayLike, second: ArrayLike) -> PairedValues:
    """Compare two policies by a number of each episode, such as its return.

    Args:
        first: (n,) the numbers of the first policy.
        second: (n,) those of the second, on the same starts in the same order.

    Raises:
        ValueError: The lengths differ, or there is no pair.
    """
    one = np.asarray(first, np.float64)
    other = np.asarray(second, np.float64)
    _check_pairs(one, other)
    differences = one - other
    interval = bootstrap(differences, np.mean)
    return PairedValues(
        pairs=int(one.size),
        difference=float(differences.mean()),
        interval=None if interval is None else (float(interval[0]), float(interval[1])),
    )


def _check_pairs(first: NDArray[np.generic], second: NDArray[np.generic]) -> None:
    if first.shape != second.shape or first.ndim != 1:
        raise ValueError(f"pairs need two lists of one length, got {first.shape}, {second.shape}")
    if not first.size:
        raise ValueError("there is no pair to compare")


def _newcombe(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the interval of a difference of paired rates (Newcombe, 1998, method 10)."""
    one = rate(first)
    other = rate(second)
    if one is None or other is None:
        raise ValueError("there is no pair to compare")
    both = int(np.sum(first & second))
    neither = int(np.sum(~first & ~second))
    only_first = one.count - both
    only_second = other.count - both
    margins = one.count * (one.trials - one.count) * other.count * (other.trials - other.count)
    phi = 0.0
    if margins:
        covariance = float(both * neither - only_first * only_second)
        if covariance > 0:  # Newcombe's correction for continuity, towards no correlation
            covariance = max(covariance - one.trials / 2, 0.0)
        phi = covariance / margins**0.5
    below_one = one.rate - one.interval[0]
    above_one = one.interval[1] - one.rate
    below_other = other.rate - other.interval[0]
    above_other = other.interval[1] - other.rate
    difference = one.rate - other.rate
    low = below_one**2 - 2 * phi * below_one * above_other + above_other**2
    high = above_one**2 - 2 * phi * above_one * below_other + below_other**2
    return difference - max(low, 0.0) ** 0.5, difference + max(high, 0.0) ** 0.5

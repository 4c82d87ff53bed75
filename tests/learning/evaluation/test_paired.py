"""Pairs of episodes on the same starts, beside published numbers and other implementations."""

import numpy as np
import pytest
from statsmodels.stats.contingency_tables import mcnemar

from embodichain.learning.evaluation.paired import compare_rates, compare_values


def successes(both: int, only_first: int, only_second: int, neither: int):
    first = [True] * both + [True] * only_first + [False] * only_second + [False] * neither
    second = [True] * both + [False] * only_first + [True] * only_second + [False] * neither
    return first, second


@pytest.mark.parametrize(
    ("table", "interval"),
    [
        ((36, 12, 2, 0), (0.0569, 0.3404)),
        ((54, 0, 0, 0), (-0.0664, 0.0664)),
        ((0, 30, 0, 0), (0.8395, 1.0)),
    ],
)
def test_intervals_are_those_that_newcombe_published(table, interval):
    """Newcombe 1998, Statistics in Medicine 17, table II, method 10."""
    result = compare_rates(*successes(*table))
    assert result.interval == pytest.approx(interval, abs=5e-5)


@pytest.mark.parametrize("table", [(36, 12, 2, 0), (5, 1, 9, 3), (4, 0, 6, 1), (2, 3, 3, 2)])
def test_the_exact_test_is_that_of_statsmodels(table):
    both, only_first, only_second, neither = table
    result = compare_rates(*successes(*table))
    assert (result.only_first, result.only_second) == (only_first, only_second)
    other = mcnemar([[both, only_first], [only_second, neither]], exact=True)
    assert result.p_value == pytest.approx(other.pvalue)


def test_equal_policies_differ_by_nothing_but_keep_an_interval():
    result = compare_rates([True] * 16, [True] * 16)
    assert result.difference == 0
    assert result.p_value == 1
    assert result.interval[0] < -0.1 and result.interval[1] > 0.1


def test_pairs_say_more_than_the_results_alone():
    """Returns that vary by start: the interval of the difference is that of the differences."""
    rng = np.random.default_rng(0)
    of_start = rng.normal(0, 10, 200)
    first = of_start + rng.normal(1, 0.5, 200)
    result = compare_values(first, of_start)
    low, high = result.interval
    assert low < 1 < high
    assert high - low < 0.3  # unpaired it would be 4 wide


def test_what_is_not_paired_is_refused():
    with pytest.raises(ValueError, match="one length"):
        compare_rates([True], [True, False])
    with pytest.raises(ValueError, match="no pair"):
        compare_values([], [])
    assert compare_values([1.0], [0.5]).interval is None

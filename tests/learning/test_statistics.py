"""Intervals and interquartile means, against hand-worked cases and scipy."""

import numpy as np
import pytest
import scipy.stats

from embodichain.learning.statistics import bootstrap, estimate, iqm, rate


def test_interquartile_mean_by_hand():
    # Eight values: two go at each end, (3 + 4 + 5 + 6) / 4 stays.
    assert iqm([100, 1, 2, 3, 4, 5, 6, -50]) == (2 + 3 + 4 + 5) / 4
    assert iqm([7.0]) == 7.0
    assert iqm([1, 2, 30]) == 11.0  # a quarter of three is no whole value


@pytest.mark.parametrize("count", [1, 3, 4, 5, 17, 100])
def test_interquartile_mean_as_scipy(count):
    values = np.random.default_rng(1).normal(size=(3, count))
    np.testing.assert_allclose(iqm(values), scipy.stats.trim_mean(values, 0.25, axis=-1))


@pytest.mark.parametrize("statistic", [np.mean, iqm])
def test_bootstrap_as_scipy(statistic):
    values = np.random.default_rng(2).exponential(size=60)
    expected = scipy.stats.bootstrap(
        (values,), statistic, n_resamples=20_000, method="percentile", rng=5
    ).confidence_interval
    width = expected.high - expected.low
    low, high = bootstrap(values, statistic)
    assert abs(low - expected.low) < 0.05 * width
    assert abs(high - expected.high) < 0.05 * width


def test_bootstrap_is_its_own_and_repeats():
    values = np.arange(30.0)
    np.random.seed(0)  # noqa: NPY002
    first = bootstrap(values, np.mean)
    drawn = np.random.random()  # noqa: NPY002
    np.random.seed(0)  # noqa: NPY002
    assert np.random.random() == drawn  # noqa: NPY002
    assert bootstrap(values, np.mean) == first
    narrow = bootstrap(values, np.mean, confidence=0.5)
    assert first[0] < narrow[0] < values.mean() < narrow[1] < first[1]


def test_bootstrap_of_many_values_in_parts():
    values = np.random.default_rng(3).normal(size=5000)
    low, high = bootstrap(values, np.mean)
    standard_error = values.std() / np.sqrt(values.size)
    assert high - low == pytest.approx(2 * 1.96 * standard_error, rel=0.06)


def test_one_value_has_no_interval_and_none_no_estimate():
    assert bootstrap([1.0], np.mean) is None
    single = estimate([2.0])
    assert (single.mean, single.median, single.iqm, single.std) == (2.0, 2.0, 2.0, 0.0)
    assert single.mean_interval is None
    assert estimate([]) is None
    assert rate([]) is None


def test_estimate_by_hand():
    found = estimate([0.0, 0.0, 3.0, 9.0])
    assert (found.mean, found.median, found.iqm) == (3.0, 1.5, 1.5)
    assert (found.min, found.max) == (0.0, 9.0)
    assert found.std == pytest.approx(np.sqrt((9 + 9 + 0 + 36) / 4))
    assert found.mean_interval[0] <= 3.0 <= found.mean_interval[1]


@pytest.mark.parametrize(("count", "trials"), [(0, 10), (10, 10), (3, 8), (95, 100)])
def test_rate_as_scipy(count, trials):
    found = rate([True] * count + [False] * (trials - count))
    expected = scipy.stats.binomtest(count, trials).proportion_ci(method="wilson")
    assert (found.rate, found.count, found.trials) == (count / trials, count, trials)
    assert found.interval == pytest.approx((expected.low, expected.high), abs=1e-12)

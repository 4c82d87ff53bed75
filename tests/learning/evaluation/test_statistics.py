"""Intervals and interquartile means, against hand-worked cases and scipy."""

import numpy as np
import pytest
import scipy.stats

from embodichain.learning.evaluation.statistics import bootstrap, estimate, iqm, over_seeds, rate


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


@pytest.mark.parametrize("count", [1, 2, 4])
def test_few_seeds_are_points_and_a_sentence(count):
    found = over_seeds([0.0] * count, [20] * count)
    assert found.values == (0.0,) * count
    assert found.mean_interval is None
    assert found.note == f"{count} seed{'s' * (count > 1)}: an interval over seeds needs at least 5"
    assert over_seeds([]) is None


def test_an_interval_over_seeds_by_hand():
    # Apart from each other: Student's t, 2.776445 of 4 degrees of freedom, clipped at 1.
    rates = [1.0, 1.0, 1.0, 1.0, 0.5]
    half = 2.776445 * np.std(rates, ddof=1) / np.sqrt(5)
    found = over_seeds(rates, [100] * 5)
    assert found.mean_interval == pytest.approx((0.9 - half, 1.0), rel=1e-6)
    # At one: Wilson's of all episodes, z^2 / (n + z^2) below 1.
    found = over_seeds([1.0] * 5, [16, 16, 16, 16, 36])
    assert found.mean_interval == pytest.approx((100 / (100 + 3.841459), 1.0), rel=1e-6)
    # A return is not clipped.
    assert over_seeds([1.0, 1.0, 1.0, 1.0, 9.0]).mean_interval[0] < 0.0


@pytest.mark.parametrize("seeds", [5, 10])
@pytest.mark.parametrize(
    ("mean", "std"), [(0.5, 0.1), (0.8, 0.1), (0.9, 0.05), (0.1, 0.0), (0.0, 0.0), (1.0, 0.0)]
)
def test_the_interval_covers_the_mean_of_all_seeds(seeds, mean, std):
    # Studies with `seeds` trainings, each with its own true rate, played for 20 episodes.
    rng = np.random.default_rng(7)
    true = np.full((2000, seeds), mean)
    if std:
        total = mean * (1 - mean) / std**2 - 1
        true = rng.beta(mean * total, (1 - mean) * total, size=true.shape)
    rates = rng.binomial(20, true) / 20
    ends = [over_seeds(row, np.full(seeds, 20)).mean_interval for row in rates]
    low, high = np.array(ends).T
    assert ((low <= mean) & (mean <= high)).mean() >= 0.93

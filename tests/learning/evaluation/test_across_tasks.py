"""Numbers over tasks and seeds, beside the published examples and scipy's own test."""

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from embodichain.learning.evaluation.across_tasks import improvement, interquartile_mean

FIRST = [[1, 2, 1, 2], [2, 2, 1, 1]]
SECOND = [[1, 2, 3], [1, 2, 3]]


def test_the_numbers_are_those_that_rliable_publishes():
    """The example of its tests: interquartile means 1.5 and 2, probability one third."""
    assert interquartile_mean(FIRST).value == 1.5
    assert interquartile_mean(SECOND).value == 2
    assert improvement(FIRST, SECOND).value == pytest.approx(1 / 3)


def test_improvement_is_the_mean_of_mann_and_whitneys_statistic():
    rng = np.random.default_rng(1)
    scores = [rng.normal(0.3, 1, 10).round(1) for _ in range(4)]
    others = [rng.normal(0, 1, 8).round(1) for _ in range(4)]
    shares = [mannwhitneyu(scores[i], others[i]).statistic / 80 for i in range(4)]
    result = improvement(scores, others)
    assert result.value == pytest.approx(np.mean(shares))
    assert improvement(others, scores).value == pytest.approx(1 - result.value)


def test_an_interval_covers_the_truth_as_often_as_it_says():
    covered = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        scores = [rng.normal(0, 1, 12) for _ in range(3)]
        others = [rng.normal(0, 1, 12) for _ in range(3)]
        low, high = improvement(scores, others).interval
        covered += low <= 0.5 <= high
    assert 175 <= covered <= 200


def test_few_seeds_have_no_interval_and_say_why():
    result = interquartile_mean([[0.1, 0.2, 0.3], [0.5] * 9])
    assert result.interval is None
    assert result.note == "3 seeds: an interval over seeds needs at least 5"
    assert interquartile_mean([[0.1] * 5]).interval == pytest.approx((0.1, 0.1))


@pytest.mark.parametrize("scores", [[], [[]], [[1.0], []]])
def test_a_task_without_scores_is_refused(scores):
    with pytest.raises(ValueError, match="at least one score"):
        interquartile_mean(scores)
    with pytest.raises(ValueError, match="got 1 and 2"):
        improvement([[1.0]], [[1.0], [2.0]])

import numpy as np
import pytest

from embodichain.learning.episode_statistics import EpisodeStatistics


def test_first_episodes_of_each_environment_count() -> None:
    """Environment 0 ends every step, environment 1 every third: two episodes of each count."""
    counted = EpisodeStatistics(2, quota=2)
    steps = 0
    while not counted.complete:
        steps += 1
        done = np.array([True, steps % 3 == 0])
        counted.add(np.array([1.0, 10.0 * steps]), done, {"success": np.array([False, True])})
    assert steps == counted.steps == 6
    assert counted.episodes == 4
    returns = {int(e): [] for e in (0, 1)}
    for env, value in zip(counted.column("env"), counted.column("return"), strict=True):
        returns[int(env)].append(float(value))
    assert returns == {0: [1.0, 1.0], 1: [60.0, 150.0]}
    assert sorted(counted.column("length").tolist()) == [1, 1, 3, 3]
    assert counted.mean("success") == 0.5


def test_nothing_is_known_before_the_first_episode() -> None:
    counted = EpisodeStatistics(3, quota=1)
    counted.add(np.ones(3), np.zeros(3, bool), {})
    assert counted.mean("return") is None
    assert counted.column("return").size == 0
    assert (counted.episodes, counted.complete) == (0, False)


def test_what_is_given_at_the_end_of_an_episode_is_kept_for_those_that_end() -> None:
    counted = EpisodeStatistics(3, quota=5)
    counted.add(
        np.zeros(3), np.array([True, False, True]), {"metrics/x": np.array([1.0, 2.0, 4.0])}
    )
    assert counted.column("metrics/x").tolist() == [1.0, 4.0]
    assert counted.column("env").tolist() == [0, 2]
    assert counted.mean("metrics/x") == pytest.approx(2.5)


def test_each_environment_may_have_a_quota_of_its_own() -> None:
    counted = EpisodeStatistics(3, quota=[2, 1, 0])
    for step in range(2):
        assert not counted.complete
        counted.add(np.full(3, 1.0 + step), np.ones(3, bool), {})
    assert counted.complete
    assert counted.wanted == counted.episodes == 3
    pairs = zip(counted.column("env").tolist(), counted.column("return").tolist(), strict=True)
    assert list(pairs) == [(0, 1.0), (1, 1.0), (0, 2.0)]

"""Episodes that are played inside of shards are those of one batch."""

from typing import Any

import numpy as np
import pytest

import embodichain
from embodichain.lab.gym.policies import resolve_policy
from embodichain.learning.episode_statistics import EpisodeStatistics, play
from embodichain.learning.evaluation import sharded_play
from tests.helpers.local_shards import sharded

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]


def build(first: int, count: int) -> Any:
    lines = [f"sim.first_env={first}", "sim.num_threads=1"]
    return embodichain.make("cart_pole", count, lines, seed=3)


def columns(counted: EpisodeStatistics) -> dict[str, list[Any]]:
    return {name: counted.column(name).tolist() for name in counted.names()}


@pytest.mark.parametrize("first", [1, 7])
def test_statistics_and_steps_are_the_same(first: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """For calls of any length, and shards that finish at different times, or are lost."""
    # Lengths of calls change no result, so no key sets them.
    monkeypatch.setattr(sharded_play, "_FIRST_STEPS", first)
    one = build(0, 5)
    whole, quota = EpisodeStatistics(5, 3), 3
    obs, _ = one.reset()
    for _ in play(one, resolve_policy("random"), obs, whole):
        pass
    with sharded(build, 5, 2, save_every=20) as (env, source):
        counted, progress = EpisodeStatistics(5, quota), []
        env.reset()
        for _ in sharded_play.play_sharded(env, "random", counted):
            progress.append(counted.episodes)
            if counted.steps > 30:
                source.running[1].lose()
        assert columns(counted) == columns(whole)
        assert counted.steps == whole.steps == env.control_step == env.pool.steps
        assert counted.complete and (counted.counts == 3).all()
        assert progress == sorted(progress) and progress[-1] == 15
        assert {r["shard"] for r in env.pool.rebuilt} == {1}
        # all environments took as many steps
        rest = env.step(env.rand("other", (1,), -1, 1))[0].rows
        assert rest.tobytes() == one.step(one.rand("other", (1,), -1, 1))[0].rows.tobytes()
    one.close()


def test_the_number_of_steps_can_be_limited() -> None:
    with sharded(build, 3, 2) as (env, _):
        env.reset()
        counted = EpisodeStatistics(3, 50)
        policy = {"func": "random_around_home", "params": {"range": 0.2}}
        for _ in sharded_play.play_sharded(env, policy, counted, 37):
            pass
        assert counted.steps == 37 and not counted.complete


def test_calls_become_longer_or_shorter(monkeypatch: pytest.MonkeyPatch) -> None:
    # Lengths follow from the time on a clock: bounds of which each call is on one side.
    monkeypatch.setattr(sharded_play, "_FIRST_STEPS", 4)
    for short, long, expected in ((1e9, 2e9, [4, 8, 16]), (-1.0, 0.0, [4, 2, 1])):
        monkeypatch.setattr(sharded_play, "_SHORT_CALL_S", short)
        monkeypatch.setattr(sharded_play, "_LONG_CALL_S", long)
        with sharded(build, 2, 2) as (env, _):
            env.reset()
            counted, seen = EpisodeStatistics(2, 500), [0]
            steps = sharded_play.play_sharded(env, "zero", counted)
            for _ in range(3):
                next(steps)
                seen.append(counted.steps)
            assert np.diff(seen).tolist() == expected

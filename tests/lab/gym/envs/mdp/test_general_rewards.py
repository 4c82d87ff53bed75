"""Rewards that ask how a step ended."""

import pytest
import torch

from embodichain.lab.gym.envs.cfg import RewardCfg, TerminationCfg
from tests.helpers.judging import put
from tests.helpers.ur10_task import HOME

HIGH = {"entity_cfg": {"uid": "cube"}, "threshold": 1.0}
REWARDS = {
    "alive": RewardCfg(func="is_alive"),
    "ended": RewardCfg(func="is_terminated"),
    "price": RewardCfg(func="constant", weight=2.0, params={"value": -0.25}),
}


@pytest.mark.parametrize("kind", ["success", "fail", "time_out"])
def test_alive_and_terminated_are_opposites_and_time_is_no_termination(make, kind) -> None:
    ends = {"t": TerminationCfg(func="height_above", kind=kind, params=HIGH)}
    env = make(rewards=REWARDS, terminations=ends)
    env.reset()
    put(env, "cube", [(0, 3, 9), (0, 3, 0.5), (0, 3, 9)])
    _, reward, terminated, truncated, info = env.step(torch.tensor([HOME]).repeat(3, 1))
    assert (terminated | truncated).tolist() == [True, False, True]
    ended = [0.0] * 3 if kind == "time_out" else [1.0, 0.0, 1.0]
    assert info["rewards"]["ended"].tolist() == ended
    assert info["rewards"]["alive"].tolist() == [1 - value for value in ended]
    assert info["rewards"]["price"].tolist() == [-0.25] * 3
    assert reward.tolist() == [0.5] * 3


def test_nothing_is_terminated_where_terminations_are_ignored(make) -> None:
    ends = {"t": TerminationCfg(func="height_above", params={**HIGH, "threshold": -1.0})}
    env = make(rewards=REWARDS, terminations=ends, ignore_terminations=True)
    env.reset()
    _, _, terminated, _, info = env.step(torch.tensor([HOME]).repeat(3, 1))
    assert not terminated.any()
    assert info["rewards"]["alive"].tolist() == [1.0] * 3

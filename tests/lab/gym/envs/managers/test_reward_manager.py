"""Rewards are value x weight; sums run over an episode; wrong shapes name the term."""

import pytest
import torch

from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import RewardCfg
from tests.helpers.ur10_task import task


def constant(env, obs, action, info, value: float = 1.0):
    return torch.full((env.num_envs,), value)


def term(value: float, **fields) -> RewardCfg:
    return RewardCfg(func=constant, params={"value": value}, **fields)


def still(env) -> torch.Tensor:
    return env.robot.get_qpos(target=True)


def test_values_are_weighted_and_added(make) -> None:
    env = make(rewards={"a": term(2.0, weight=0.5), "b": term(3.0, weight=-1.0), "c": term(1.0)})
    env.reset()
    _, reward, _, _, info = env.step(still(env))
    assert reward.tolist() == [-1.0] * 3
    assert {k: v[0].item() for k, v in info["rewards"].items()} == {"a": 2.0, "b": 3.0, "c": 1.0}
    assert {k: v[0].item() for k, v in info["episode_sums"].items()} == {
        "a": 1.0,
        "b": -3.0,
        "c": 1.0,
    }


def test_replace_takes_the_place_of_what_came_before(make) -> None:
    env = make(rewards={"a": term(2.0), "b": term(3.0, mode="replace", weight=2.0), "c": term(1.0)})
    env.reset()
    assert env.step(still(env))[1].tolist() == [7.0] * 3


def test_terms_are_added_to_the_hook() -> None:
    class Mine(BaseEnv):
        def get_reward(self, obs, action, info):
            return torch.full((3,), 10.0)

    env = Mine(task(rewards={"a": term(2.0)}))
    env.reset()
    assert env.step(still(env))[1].tolist() == [12.0] * 3
    env.close()


def test_sums_start_anew_and_what_was_returned_stays(make) -> None:
    env = make(max_episode_steps=5, rewards={"a": term(1.0)})
    env.reset()
    infos = [env.step(still(env))[4] for _ in range(2)]
    env.reset(options={"reset_ids": [1]})
    infos += [env.step(still(env))[4] for _ in range(4)]
    sums = [info["episode_sums"]["a"].tolist() for info in infos]
    assert sums == [[1] * 3, [2] * 3, [3, 1, 3], [4, 2, 4], [5, 3, 5], [1, 4, 1]]
    assert infos[4]["final_info"]["episode_sums"]["a"].tolist() == [5, 3, 5]


def test_booleans_count_as_one(make) -> None:
    env = make(rewards={"a": RewardCfg(func=lambda e, o, a, i: torch.tensor([True, False, True]))})
    env.reset()
    _, reward, _, _, info = env.step(still(env))
    assert reward.tolist() == [1.0, 0.0, 1.0]
    assert info["rewards"]["a"].dtype == torch.float32


@pytest.mark.parametrize(
    ("func", "part"),
    [
        (lambda e, o, a, i: torch.zeros(3, 1), "(3,), got (3, 1)"),
        (lambda e, o, a, i: torch.zeros(()), "(3,), got ()"),
        (lambda e, o, a, i: 1.0, "got float"),
    ],
)
def test_wrong_shapes_name_the_term(make, func, part) -> None:
    with pytest.raises(ValueError) as caught:
        env = make(rewards={"bad": RewardCfg(func=func)})
        env.reset()
        env.step(still(env))
    assert "reward term 'bad' must return" in str(caught.value)
    assert part in str(caught.value)


def test_classes_keep_state_per_episode(make) -> None:
    env = make(rewards={"a": RewardCfg(func="action_smoothness_penalty")})
    env.reset()
    home = still(env)
    assert env.step(home)[1].tolist() == [0.0] * 3
    moved = home.clone()
    moved[:, 0] += 0.3
    moved[:, 1] += 0.4
    assert torch.allclose(env.step(moved)[1], torch.full((3,), -0.5))
    env.reset(options={"reset_ids": [2]})
    assert torch.allclose(env.step(home)[1], torch.tensor([-0.5, -0.5, 0.0]))


def test_a_floor_is_the_smallest_reward_and_the_sums_of_terms_are_without_it() -> None:
    class Mine(BaseEnv):
        def get_reward(self, obs, action, info):
            return torch.tensor([0.0, 2.0, 5.0])

    env = Mine(task(rewards={"a": term(3.0, weight=-1.0)}, reward_floor=-0.5))
    env.reset()
    _, reward, _, _, info = env.step(still(env))
    assert reward.tolist() == [-0.5, -0.5, 2.0]
    assert info["episode_sums"]["a"].tolist() == [-3.0] * 3
    env.close()

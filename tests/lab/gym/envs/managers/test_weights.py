"""Weights of rewards are finite; one of 0 is not evaluated, and starts anew when it is raised."""

import numpy as np
import pytest
import torch

import embodichain
from embodichain.lab.gym.envs.cfg import CurriculumCfg, RewardCfg
from embodichain.utils.errors import ConfigError

RATE = {"func": "action", "shape": [{"rate": "step"}, "l2"]}
NEVER = 10**6


def home(env) -> torch.Tensor:
    return env.robot.get_qpos(target=True)


def changed(weight: float, steps: int) -> dict[str, CurriculumCfg]:
    params = {"term_name": "rate", "weight": weight, "num_steps": steps}
    return {"later": CurriculumCfg(func="modify_reward_weight", params=params)}


@pytest.mark.parametrize("weight", [np.nan, np.inf, -np.inf, 1e39])
def test_a_weight_that_is_not_finite_is_refused_when_built_and_when_set(make, weight) -> None:
    with pytest.raises(ConfigError, match=r"rewards\.a\.weight: must be a finite number"):
        make(rewards={"a": RewardCfg(func="constant", weight=weight)})
    env = make(rewards={"a": RewardCfg(func="constant", weight=0.5)})
    with pytest.raises(ConfigError, match=r"rewards\.a\.weight: must be a finite number"):
        env.reward_manager.set_weight("a", weight)
    assert dict(env.reward_manager.weights) == {"a": 0.5}
    with pytest.raises(ConfigError, match=r"curriculum\.later\.params\.weight: "):
        make(rewards={"rate": RewardCfg(**RATE)}, curriculum=changed(weight, NEVER))


@pytest.mark.parametrize("weight", ["nan", "inf", "-inf"])
def test_a_file_with_such_a_weight_is_refused_with_its_key(weight) -> None:
    term = f"+task.rewards.x={{func: constant, weight: {weight}}}"
    with pytest.raises(ConfigError) as caught:
        embodichain.make("reach", overrides=[term])
    assert "task.rewards.x.weight: " in str(caught.value)
    assert "finite" in str(caught.value)


def test_weight_0_is_not_evaluated_and_keeps_its_columns(make) -> None:
    calls = []

    def bad(env, obs, action, info):
        calls.append(1)
        return torch.full((3,), torch.nan)

    env = make(rewards={"bad": RewardCfg(func=bad, weight=0.0), "one": RewardCfg(func="constant")})
    env.reset()
    _, reward, terminated, _, info = env.step(home(env))
    assert not calls
    assert reward.tolist() == [1.0] * 3 and not terminated.any()
    assert list(info["rewards"]) == list(info["episode_sums"]) == ["bad", "one"]
    assert info["rewards"]["bad"].tolist() == info["episode_sums"]["bad"].tolist() == [0.0] * 3


def test_a_single_reward_of_weight_0_gives_0(make) -> None:
    env = make(rewards={"one": RewardCfg(func="constant", weight=0.0)})
    env.reset()
    _, reward, _, _, info = env.step(home(env))
    assert reward.tolist() == info["rewards"]["one"].tolist() == [0.0] * 3


def test_a_weight_raised_from_0_starts_the_term_anew(make) -> None:
    env = make(rewards={"rate": RewardCfg(**RATE, weight=1.0)})
    env.reset()
    action = home(env)
    env.step(action)
    env.step(action + 1.0)  # a change of 6 x 1
    env.reward_manager.set_weight("rate", 0.0)
    for step in range(3):
        assert env.step(action + step)[4]["rewards"]["rate"].tolist() == [0.0] * 3
    env.reward_manager.set_weight("rate", 0.5)
    # The first evaluation has no earlier action: neither that before the gap, nor that in it.
    assert env.step(action)[4]["rewards"]["rate"].tolist() == [0.0] * 3
    _, reward, _, _, info = env.step(action + 0.1)
    np.testing.assert_allclose(info["rewards"]["rate"], 6 * 0.01, rtol=1e-4)
    np.testing.assert_allclose(reward, 3 * 0.01, rtol=1e-4)


def test_a_class_without_reset_starts_anew(make) -> None:
    class Counts:
        def __init__(self, env):
            self.count = 0

        def __call__(self, env, obs, action, info):
            self.count += 1
            return torch.full((3,), float(self.count))

    env = make(rewards={"n": RewardCfg(func=Counts)})
    env.reset()
    env.step(home(env))
    env.reward_manager.set_weight("n", 0.0)
    env.step(home(env))
    env.reward_manager.set_weight("n", 1.0)
    assert env.step(home(env))[1].tolist() == [1.0] * 3


def test_a_curriculum_raises_it_at_a_reset_and_the_others_see_no_gap(make) -> None:
    env = make(
        rewards={"rate": RewardCfg(**RATE, weight=0.0)}, curriculum=changed(weight=1.0, steps=2)
    )
    env.reset()
    action = home(env)
    for step in range(2):
        env.step(action + step)
    env.reset(options={"reset_ids": [1]})  # the others are within their episodes
    assert env.step(action + 5)[1].tolist() == [0.0] * 3
    np.testing.assert_allclose(env.step(action + 6)[1], 6.0, rtol=1e-5)


def test_a_saved_state_goes_on_bit_for_bit(make) -> None:
    sections = {
        "rewards": {"rate": RewardCfg(**RATE, weight=0.0)},
        "curriculum": changed(weight=1.0, steps=2),
    }
    env, twin = make(**sections), make(**sections)
    env.reset()
    twin.reset()
    action = home(env)
    for step in range(2):
        env.step(action + step)
    env.reset(options={"reset_ids": [0]})
    env.step(action)
    twin.load_state_dict(env.state_dict())
    for step in range(3):
        mine, other = env.step(action + 0.1 * step), twin.step(action + 0.1 * step)
        assert torch.equal(mine[1], other[1])
        assert torch.equal(mine[4]["episode_sums"]["rate"], other[4]["episode_sums"]["rate"])
    assert mine[1].abs().max() > 0

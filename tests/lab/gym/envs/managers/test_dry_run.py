"""Terms of the wrong shape are found without a step, and looking leaves no trace."""

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import MetricCfg, RewardCfg, TerminationCfg
from embodichain.lab.gym.envs.managers import RewardManager, check_values

WRONG = {"func": lambda env, obs, action, info: torch.zeros(env.num_envs, 1)}


def noisy(env, obs, action, info):
    return env.rand("noise")


@pytest.mark.parametrize(
    ("sections", "part"),
    [
        ({"rewards": {"r": RewardCfg(**WRONG)}}, "reward term 'r'"),
        ({"metrics": {"m": MetricCfg(**WRONG)}}, "metric term 'm'"),
        ({"terminations": {"t": TerminationCfg(**WRONG)}}, "termination term 't'"),
    ],
)
def test_wrong_shapes_are_refused_at_build(make, sections, part) -> None:
    with pytest.raises(ValueError, match=part):
        make(**sections)


def test_it_leaves_no_trace(make) -> None:
    sections = {
        "rewards": {"r": RewardCfg(func=noisy), "s": RewardCfg(func="action_smoothness_penalty")},
        "metrics": {"m": MetricCfg(func=noisy, reduce="sum")},
    }
    found = []
    for look in (False, True):
        env = make(**sections)
        obs, _ = env.reset(seed=1)
        if look:
            check_values(env, obs)
        _, reward, _, _, info = env.step(env.robot.get_qpos(target=True))
        found.append(np.stack([reward, info["episode_sums"]["r"], info["metrics"]["m"]]))
    assert np.array_equal(found[0], found[1])
    assert found[0][0].all()


def test_without_terms_nothing_is_called(make) -> None:
    env = make()
    assert not len(env.reward_manager)
    check_values(env, None)


def test_each_manager_checks_its_first_call(make) -> None:
    env = make()
    env.reset()
    manager = RewardManager(env, {"late": RewardCfg(**WRONG)})
    with pytest.raises(ValueError, match="reward term 'late' must return shape"):
        manager.compute(torch.zeros(3), None, None, {})


def test_a_class_with_an_info_of_its_own_is_checked_in_its_first_step() -> None:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from tests.helpers.ur10_task import HOME, task

    class Mine(BaseEnv):
        def get_info(self, **kwargs):
            return {**super().get_info(**kwargs), "bonus": torch.ones(self.num_envs)}

    def bonus(env, obs, action, info):
        return info["bonus"]

    env = Mine(task(rewards={"b": RewardCfg(func=bonus), "w": RewardCfg(**WRONG)}))
    env.reset()
    with pytest.raises(ValueError, match="reward term 'w' must return shape"):
        env.step(torch.tensor([HOME] * 3))
    env.close()

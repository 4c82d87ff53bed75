import warnings

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_sb3

from embodichain.lab.gym.envs.cfg import ActionTermCfg, RewardCfg
from embodichain.lab.gym.single import SingleEnv
from tests.lab.gym.conftest import jumping


@pytest.fixture
def make_single(make_env):
    def build(flatten=True, **kwargs):
        rewards = {"x": RewardCfg(func=lambda env, obs, action, info: obs["cube"][:, 0])}
        # Normalized actions, as the checkers recommend.
        arm = ActionTermCfg("default_offset_joint_position", {"entity_cfg": {"uid": "ur10"}})
        sections = {"num_envs": 1, **jumping(), "rewards": rewards, "actions": {"arm": arm}}
        env = make_env(**{**sections, **kwargs})
        return SingleEnv(env, flatten)

    return build


@pytest.mark.parametrize("flatten", [True, False])
def test_gymnasiums_checker_passes(make_single, flatten):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # What remains: unbounded observations, and no spec because nobody registered this one.
        warnings.filterwarnings("ignore", ".*(infinity|spec).*")
        check_env(make_single(flatten), skip_render_check=True)


def test_stable_baselines_checker_passes(make_single):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env_sb3(make_single(), skip_render_check=True)


def test_values_have_no_batch_dimension(make_single):
    env = make_single(flatten=False)
    obs, info = env.reset(seed=1)
    assert obs["robot"]["qpos"].shape == (6,) and info["elapsed_steps"] == 0
    obs, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert type(reward) is float and type(terminated) is bool and type(truncated) is bool
    assert info["rewards"]["x"] == pytest.approx(reward) and info["diverged"] is False
    assert env.observation_space.contains(obs)


def test_it_never_resets_itself(make_single):
    env = make_single(max_episode_steps=2)
    env.reset()
    ends = [env.step(np.zeros(6, np.float32))[3] for _ in range(3)]
    assert ends == [False, True, True]


def test_one_environment_only(make_single):
    with pytest.raises(ValueError, match="this batch has 2"):
        make_single(num_envs=2)

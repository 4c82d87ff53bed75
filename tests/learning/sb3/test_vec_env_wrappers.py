"""SB3VecEnv under the wrappers of Stable-Baselines3, and against its DummyVecEnv.

VecTransposeImage and VecVideoRecorder are in `test_vec_env_dict.py`.
"""

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecCheckNan,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
)

from embodichain.config import resolve
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import ObservationCfg, RewardCfg
from embodichain.learning import SB3VecEnv
from embodichain.learning.sb3.normalization import NormalizeStatistics
from tests.learning.counting import CountingEnv

N = 3


class Plain(gym.Env):
    """One cart and pole as a plain environment of Gymnasium, which its caller resets.

    Environment i makes the same bytes whatever its neighbours do, with random streams keyed by i:
    so here it is the last of a batch of i + 1.
    """

    def __init__(self, index):
        self.index = index
        lines = ["task=cart_pole", "task.max_episode_steps=40", "seed=7", f"num_envs={index + 1}"]
        cfg = resolve([*lines, "sim.num_threads=1"], "train").env_cfg
        self.env = BaseEnv(cfg, autoreset_mode="DISABLED")
        self.view = SB3View(self.env)
        self.observation_space = spaces.Box(-np.inf, np.inf, (4,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        if seed is not None:
            obs, _ = self.env.reset(seed=seed - self.index)  # DummyVecEnv gives seed + index
        else:
            obs, _ = self.env.reset(options={"env_ids": [self.index]})
        return self.view(obs)[self.index], {}

    def step(self, action):
        batch = torch.zeros(self.index + 1, 1)
        batch[self.index] = torch.from_numpy(self.view.scale(action[None])[0])
        obs, reward, terminated, truncated, _ = self.env.step(batch)
        i = self.index
        ended = bool(terminated[i])
        return self.view(obs)[i], float(reward[i]), ended, bool(truncated[i]) and not ended, {}

    def close(self):
        self.env.close()


class SB3View:
    """Observations and actions as SB3VecEnv has them, by its documentation."""

    def __init__(self, env):
        self.env = env
        self.low, self.high = env.single_action_space.low, env.single_action_space.high

    def __call__(self, obs):
        return self.env.observation_manager.flatten(obs, "policy").numpy().copy()

    def scale(self, action):
        action = np.asarray(action, np.float32)
        half = np.float32(0.5)
        if (self.low == -1).all() and (self.high == 1).all():
            return action
        return half * ((1 - action) * self.low + (1 + action) * self.high)


@pytest.fixture
def pair():
    """Ours and SB3's around plain environments of the same task."""
    lines = ["task=cart_pole", "task.max_episode_steps=40", "seed=7", f"num_envs={N}"]
    cfg = resolve([*lines, "sim.num_threads=1"], "train").env_cfg
    ours = SB3VecEnv(BaseEnv(cfg))
    theirs = DummyVecEnv([lambda i=i: Monitor(Plain(i)) for i in range(N)])
    yield ours, theirs
    ours.close()
    theirs.close()


def test_equals_dummy_vec_env_to_the_bit(pair):
    ours, theirs = pair
    for env in pair:
        env.seed(11)
    np.testing.assert_array_equal(ours.reset(), theirs.reset())
    rng = np.random.default_rng(0)
    ended = 0
    for _ in range(150):
        actions = rng.uniform(-1, 1, (N, 1)).astype(np.float32)
        (obs, reward, done, infos), (obs2, reward2, done2, infos2) = (
            env.step(actions) for env in pair
        )
        np.testing.assert_array_equal(obs, obs2)
        np.testing.assert_array_equal(reward, reward2)
        np.testing.assert_array_equal(done, done2)
        for told, expected in zip(infos, infos2, strict=True):
            assert bool(told) == ("terminal_observation" in expected)
            if told:
                ended += 1
                assert told["TimeLimit.truncated"] == expected["TimeLimit.truncated"]
                np.testing.assert_array_equal(
                    told["terminal_observation"], expected["terminal_observation"]
                )
                assert told["episode"]["l"] == expected["episode"]["l"]
                np.testing.assert_allclose(told["episode"]["r"], expected["episode"]["r"])
    assert ended > 6


@pytest.mark.parametrize("wrap", [lambda env: env, VecNormalize], ids=["plain", "normalized"])
def test_ppo_learns_the_same_parameters_to_the_bit(pair, wrap):
    found = []
    for env in pair:
        model = PPO(
            "MlpPolicy", wrap(env), n_steps=48, batch_size=36, n_epochs=2, seed=5, device="cpu"
        )
        model.learn(3 * 48 * N)
        found.append(torch.cat([p.detach().flatten() for p in model.policy.parameters()]))
    assert torch.equal(*found)


def test_monitor_counts_what_we_count():
    env = VecMonitor(SB3VecEnv(CountingEnv([0, 3])))
    env.reset()
    for _ in range(3):
        _, _, _, infos = env.step(np.full((2, 2), 0.25, np.float32))
    told = infos[1]["episode"]
    assert (told["r"], told["l"]) == (pytest.approx(1.5), 3)


def test_frames_are_stacked_and_the_terminal_one_too():
    env = VecFrameStack(SB3VecEnv(CountingEnv([0, 3])), n_stack=2)
    assert env.reset().shape == (2, 6)
    for _ in range(3):
        obs, _, _, infos = env.step(np.zeros((2, 2), np.float32))
    # (environment, episode, steps), twice
    np.testing.assert_array_equal(infos[1]["terminal_observation"], [1, 0, 2, 1, 0, 3])
    np.testing.assert_array_equal(obs, [[0, 0, 2, 0, 0, 3], [0, 0, 0, 1, 1, 0]])


def test_check_nan_lets_finite_numbers_through():
    env = VecCheckNan(SB3VecEnv(CountingEnv([0, 3])), raise_exception=True)
    env.reset()
    env.step(np.zeros((2, 2), np.float32))
    with pytest.raises(ValueError, match="nan"):
        env.step(np.full((2, 2), np.nan, np.float32))


def breaks(env, obs, action, info):
    """In its third step the first environment's reward is not a number."""
    reward = torch.ones(env.num_envs)
    if env.control_step == 3:
        reward[0] = float("nan")
    return reward


def sees_nothing(env, obs):
    """An observation that is infinite in the fifth step of the second environment."""
    values = torch.ones(env.num_envs, 1)
    if env.elapsed_steps[1] == 5:
        values[1] = float("inf")
    return values


def test_a_diverging_environment_never_reaches_the_normalizer():
    cfg = resolve(["task=cart_pole", "seed=7", f"num_envs={N}"], "train").env_cfg
    cfg.rewards["odd"] = RewardCfg(func=breaks)
    cfg.observations["odd"] = ObservationCfg(func=sees_nothing)
    env = VecCheckNan(VecNormalize(SB3VecEnv(BaseEnv(cfg))), raise_exception=True)
    try:
        obs = env.reset()
        told = []
        for _ in range(8):
            obs, reward, done, infos = env.step(np.zeros((N, 1), np.float32))
            told.append([info.get("ended_by") for info in infos])
            assert np.isfinite(obs).all() and np.isfinite(reward).all()
            for info in infos:
                assert np.isfinite(info.get("terminal_observation", 0.0)).all()
        assert told[2] == ["diverged", None, None]
        assert told[4] == [None, "diverged", None]
        found = NormalizeStatistics.of(env.venv)
        for values in (found.obs_mean, found.obs_var, found.ret_mean, found.ret_var):
            assert np.isfinite(values).all()
        assert found.obs_mean[-1] == pytest.approx(1.0, abs=1e-4)
        # The rows of diverged steps count with what the reset left: all rows of all steps.
        assert found.obs_count == pytest.approx(9 * N, abs=1e-3)
    finally:
        env.close()

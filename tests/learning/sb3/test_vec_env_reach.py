"""The vector environment around the real thing: physics, managers, resets."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecCheckNan, VecFrameStack, VecNormalize

import embodichain
from embodichain.lab.gym.single import SingleEnv
from embodichain.learning import SB3VecEnv

pytestmark = pytest.mark.slow

STEPS = 20


def actions(num_envs, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (STEPS, num_envs, 6)).astype(np.float32)


def without_autoreset(env, sequence):
    """What Stable-Baselines3 must see, from an environment that only resets when told to."""
    flatten = env.observation_manager.flatten
    obs, _ = env.reset(seed=3)
    yield flatten(obs).numpy(), None
    for action in sequence:
        final, reward, terminated, truncated, info = env.step(torch.from_numpy(action))
        final, obs = flatten(final).numpy(), final
        done = (terminated | truncated).numpy()
        if done.any():
            obs, _ = env.reset(options={"reset_ids": np.flatnonzero(done)})
        success = info["metrics"]["success"].numpy()
        yield (
            flatten(obs).numpy(),
            (final, reward.numpy(), terminated.numpy(), truncated.numpy(), success),
        )


def test_equals_a_run_without_autoreset_to_the_bit(make_reach):
    sequence = actions(4)
    vec_env = SB3VecEnv(make_reach(4))
    expected = without_autoreset(make_reach(4, mode="DISABLED"), sequence)
    vec_env.seed(3)
    np.testing.assert_array_equal(vec_env.reset(), next(expected)[0])
    ended = []
    for action in sequence:
        obs, rewards, dones, infos = vec_env.step(action)
        new, (final, reward, terminated, truncated, success) = next(expected)
        np.testing.assert_array_equal(obs, new)
        np.testing.assert_array_equal(rewards, reward)
        np.testing.assert_array_equal(dones, terminated | truncated)
        for i, info in enumerate(infos):
            assert bool(info) == bool(dones[i])
            if info:
                np.testing.assert_array_equal(info["terminal_observation"], final[i])
                assert not np.array_equal(info["terminal_observation"], obs[i])
                assert info["TimeLimit.truncated"] == (truncated[i] and not terminated[i])
                assert info["is_success"] == bool(success[i])
                ended.append((i, info["TimeLimit.truncated"], info["episode"]["l"]))
    # Environments 1 (after 4 steps) and 3 (after 6, as the limit comes) fail, the others time out.
    assert set(ended) == {(0, True, 6), (1, False, 4), (2, True, 6), (3, False, 6)}


def test_episode_returns_are_the_sums_of_rewards(make_reach):
    vec_env = SB3VecEnv(make_reach(3))
    vec_env.reset()
    sums = np.zeros(3)
    for action in actions(3):
        _, rewards, dones, infos = vec_env.step(action)
        sums += rewards
        for i in np.flatnonzero(dones):
            assert infos[i]["episode"]["r"] == pytest.approx(sums[i], abs=1e-9)
            sums[i] = 0.0


def test_a_diverged_environment_is_terminal_and_finite(make_reach):
    env = make_reach(3)
    vec_env = SB3VecEnv(env)
    vec_env.reset()
    vec_env.step(actions(3)[0])
    env.sim.engine.write("qvel", np.nan, np.array([1]))  # below the handles, which would refuse it
    obs, rewards, dones, infos = vec_env.step(actions(3)[1])
    np.testing.assert_array_equal(dones, [False, True, False])
    assert infos[1]["TimeLimit.truncated"] is False
    assert rewards[1] == 0.0
    for values in (obs, rewards, infos[1]["terminal_observation"]):
        assert np.isfinite(values).all()


def test_nan_actions_are_refused(make_reach):
    vec_env = SB3VecEnv(make_reach(2))
    vec_env.reset()
    with pytest.raises(ValueError, match="not finite in environments \\[1\\]"):
        vec_env.step(np.float32([[0] * 6, [np.nan] * 6]))


def test_pictures_of_every_environment(make_reach):
    vec_env = SB3VecEnv(make_reach(2, render_mode="rgb_array"))
    vec_env.reset()
    images = vec_env.get_images()
    assert [image.dtype for image in images] == [np.uint8] * 2
    assert vec_env.render("rgb_array").size == 2 * images[0].size
    assert not np.array_equal(images[0], images[1])  # each has a goal of its own
    assert SB3VecEnv(make_reach(2)).get_images() == [None, None]


def test_learns_and_evaluates_under_stable_baselines_wrappers(make_reach):
    inner = VecNormalize(VecFrameStack(VecCheckNan(SB3VecEnv(make_reach(4)), True), 2))
    model = PPO("MlpPolicy", inner, n_steps=8, batch_size=16, n_epochs=1, device="cpu", seed=0)
    model.learn(2 * 4 * 8)
    assert sorted(info["l"] for info in model.ep_info_buffer) == [4] * 4 + [6] * 6
    returns, lengths = evaluate_policy(model, inner, 8, return_episode_rewards=True, warn=True)
    assert sorted(set(lengths)) == [4, 6]
    assert np.isfinite(returns).all()


def test_stable_baselines_own_check_on_a_view_of_one(make_reach, recwarn):
    check_env(SingleEnv(make_reach(1)))
    assert [str(w.message) for w in recwarn if "normalized" in str(w.message)] == []


def test_embodichain_make_is_what_it_wraps():
    env = embodichain.make("reach", num_envs=2)
    try:
        assert SB3VecEnv(env).reset().shape == (2, 21)
        assert SB3VecEnv(gym.wrappers.OrderEnforcing(env)).reset().shape == (2, 21)
    finally:
        env.close()

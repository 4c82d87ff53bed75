"""The environment of skrl, in its own trainer; and the values that PPO learns."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest
import torch

import embodichain
from embodichain.config.keys.tensor_algorithms import SkrlPpoCfg, TensorAlgoCfg
from embodichain.learning.tensors.tensor_env import TensorEnv
from tests.learning.counting import CountingEnv

pytest.importorskip("skrl")

from skrl import config
from skrl.agents.torch.ppo import PPO_CFG
from skrl.envs.wrappers.torch import Wrapper, wrap_env
from skrl.trainers.torch import SequentialTrainer

from embodichain.learning import SkrlEnv
from embodichain.learning.tensors.skrl_ppo import SkrlPpo

pytestmark = pytest.mark.slow

STATE = ["task.observations.to_goal.group=critic", "task.max_episode_steps=5", "seed=1"]
# What is built from other keys, or not offered.
GIVEN = {
    *("experiment", "rewards_shaper", "learning_rate_scheduler", "learning_rate_scheduler_kwargs"),
    *("observation_preprocessor", "observation_preprocessor_kwargs"),
    *("state_preprocessor", "state_preprocessor_kwargs"),
    *("value_preprocessor", "value_preprocessor_kwargs"),
}


@pytest.fixture
def reach():
    env = embodichain.make("reach", 3, STATE)
    yield env
    env.close()


def test_it_is_an_environment_of_skrl(reach):
    env = SkrlEnv(reach, ["policy", "critic"])
    assert isinstance(env, Wrapper)
    assert env.num_envs == 3 and env.device.type == "cpu"
    shapes = [s.shape for s in (env.observation_space, env.state_space, env.action_space)]
    assert shapes == [(18,), (21,), (6,)]
    obs, info = env.reset()
    assert obs.shape == (3, 18) and info == {}
    assert torch.equal(env.state(), torch.cat([obs, reach.get_obs()["to_goal"]], dim=1))
    for _ in range(5):
        obs, reward, terminated, truncated, info = env.step(torch.zeros(3, 6))
    assert reward.shape == terminated.shape == truncated.shape == (3, 1)
    assert truncated.all() and not terminated.any() and "metrics" in info
    assert torch.equal(env.state()[:, :18], obs)
    assert env.render() is None
    alone = SkrlEnv(reach)
    alone.reset()
    assert alone.state_space is None and alone.state() is None


def test_closing_it_closes_the_environment(reach):
    env = SkrlEnv(reach)
    env.close()
    with pytest.raises(gym.error.ClosedEnvironmentError):
        reach.reset()


def test_the_trainer_of_skrl_learns_in_it(reach):
    env = SkrlEnv(reach, ["policy", "critic"])
    made = learner(env.tensors, rollouts=6, mini_batches=2)
    before = [p.detach().clone() for p in made._policy.parameters()]
    cfg = {"timesteps": 12, "headless": True, "disable_progressbar": True}
    cfg |= {"close_environment_at_exit": False}
    SequentialTrainer(cfg=cfg, env=env, agents=made._agent).train()
    after = list(made._policy.parameters())
    assert not any(torch.equal(a, b) for a, b in zip(before, after, strict=True))


@pytest.mark.filterwarnings("ignore:To copy construct from a tensor")  # skrl's own
def test_wrap_env_takes_it_with_its_state(reach):
    env = wrap_env(SkrlEnv(reach, ["policy", "critic"]), verbose=False)
    assert env.num_envs == 3 and env.device.type == "cpu"
    shapes = [s.shape for s in (env.observation_space, env.state_space, env.action_space)]
    assert shapes == [(18,), (21,), (6,)]
    obs, _ = env.reset()
    twin = SkrlEnv(embodichain.make("reach", 3, STATE), ["policy", "critic"])
    assert torch.equal(obs, twin.reset(seed=config.torch.key)[0])
    ended = 0
    for step in range(6):  # of episodes of 5 steps
        actions = torch.full((3, 6), 0.1 * step)
        obs, reward, terminated, truncated, _ = env.step(actions)
        expected = twin.step(actions)
        for value, other in zip((obs, reward, terminated, truncated), expected, strict=False):
            assert torch.equal(value, other)
        assert torch.equal(env.state(), twin.state()) and env.state().shape == (3, 21)
        ended += int(truncated.sum())
    assert ended == 3
    twin.close()


@pytest.mark.filterwarnings("ignore:To copy construct from a tensor")
def test_wrap_env_takes_one_environment_of_it():
    env = wrap_env(SkrlEnv(embodichain.make("reach", 1, STATE)), verbose=False)
    assert env.reset()[0].shape == (1, 18)
    assert [v.shape for v in env.step(torch.zeros(1, 6))[:4]] == [(1, 18), *[(1, 1)] * 3]
    env.close()


@pytest.mark.filterwarnings("ignore:To copy construct from a tensor")
def test_the_trainer_of_skrl_learns_in_what_wrap_env_made(reach):
    inner = SkrlEnv(reach, ["policy", "critic"])
    made = learner(inner.tensors, rollouts=6, mini_batches=2)
    before = [p.detach().clone() for p in made._policy.parameters()]
    cfg = {"timesteps": 12, "headless": True, "disable_progressbar": True}
    cfg |= {"close_environment_at_exit": False}
    SequentialTrainer(cfg=cfg, env=wrap_env(inner, verbose=False), agents=made._agent).train()
    after = list(made._policy.parameters())
    assert not any(torch.equal(a, b) for a, b in zip(before, after, strict=True))


@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP"])
def test_wrap_env_takes_vector_environments_of_gymnasium(mode):
    made = gym.make_vec("embodichain/reach-v0", num_envs=2, seed=1, autoreset_mode=mode)
    env = wrap_env(made, verbose=False)
    assert (env.num_envs, env.observation_space.shape, env.action_space.shape) == (2, (21,), (6,))
    obs, _ = env.reset()
    stepped, reward, *_ = env.step(torch.zeros(2, 6))
    assert obs.shape == stepped.shape == (2, 21) and reward.shape == (2, 1)
    env.close()


def test_the_wrapper_of_maniskill_resets_what_ended_and_nothing_else():
    env = embodichain.make("reach", 3, ["task.max_episode_steps=5"], autoreset_mode="DISABLED")
    wrapped = wrap_env(env, wrapper="mani-skill", verbose=False)
    assert wrapped.reset()[0].shape == (3, 39)
    env.reset(options={"env_idx": torch.tensor([1])})
    for _ in range(3):
        wrapped.step(torch.zeros(3, 6))
    env.reset(options={"env_idx": torch.tensor([2])})
    truncated = [wrapped.step(torch.zeros(3, 6))[3].flatten().tolist() for _ in range(2)]
    assert truncated == [[False] * 3, [True, True, False]]
    assert env.episodes.elapsed.tolist() == [0, 0, 2]
    env.close()


def test_every_argument_of_ppo_may_be_set():
    arguments = {f.name for f in dataclasses.fields(PPO_CFG)} - GIVEN
    own = {f.name for f in dataclasses.fields(TensorAlgoCfg)}
    assert {f.name for f in dataclasses.fields(SkrlPpoCfg)} - own == arguments
    assert set(SkrlPpoCfg().arguments()) == arguments


def learner(env, **keys):
    return SkrlPpo(SkrlPpoCfg(hidden_dims=[4], **keys), env)


def test_settings_reach_the_algorithm():
    env = TensorEnv(CountingEnv([0, 0]))
    made = learner(env, discount_factor=0.5, init_std=0.3, activation="tanh", rollouts=3)
    agent = made._agent
    assert (agent.cfg.discount_factor, agent.cfg.rollouts, made.steps) == (0.5, 3, 3)
    assert [type(m).__name__ for m in made._policy.net] == ["Linear", "Tanh", "Linear"]
    assert made._policy.log_std.exp().tolist() == pytest.approx([0.3, 0.3])
    assert agent.scheduler.kl_threshold == 0.01
    assert "observation_preprocessor" in agent.checkpoint_modules
    plain = learner(env, desired_kl=None, obs_normalization=False)._agent
    assert plain.scheduler is None
    assert set(plain.checkpoint_modules) == {"policy", "value", "optimizer"}


def test_what_is_cut_off_is_bootstrapped_from_its_last_observation():
    """Environment 0 terminates in step 2, environment 1 is cut off there; rewards are 1."""
    env = TensorEnv(CountingEnv([2, 0], limit=2))
    made = learner(env, rollouts=2, discount_factor=0.9)
    groups = env.reset()
    memory = made._agent.memory
    with torch.no_grad():
        for _ in range(2):
            made.act(groups)
            step = env.step(torch.tensor([[1.0, 0.0]] * 2))
            made.record(step)
            groups = step.groups
        last = torch.tensor([[1.0, 0.0, 2.0]])  # environment, episode, steps: before the reset
        scaled = made._agent._observation_preprocessor(last)
        value, _ = made._agent.value.act({"observations": scaled, "states": None}, role="value")
    rewards = memory.get_tensor_by_name("rewards")
    assert rewards[0].flatten().tolist() == [1.0, 1.0]
    assert rewards[1, 0, 0] == 1.0
    assert rewards[1, 1, 0] == pytest.approx(1.0 + 0.9 * float(value), rel=1e-5)
    assert memory.get_tensor_by_name("observations")[:, 1].tolist() == [[1, 0, 0], [1, 0, 1]]
    assert step.reward.tolist() == [1.0, 1.0]  # the environment's own tensor is unchanged


def test_without_a_value_at_the_limit_returns_end_there():
    """Both environments are cut off in step 2 of 3; rewards are 1, nothing of step 3 is in them."""
    env = TensorEnv(CountingEnv([0, 0], limit=2))
    made = learner(env, rollouts=3, discount_factor=0.9, time_limit_bootstrap=False)
    groups = env.reset()
    with torch.no_grad():
        for _ in range(3):
            made.act(groups)
            step = env.step(torch.tensor([[1.0, 0.0]] * 2))
            made.record(step)
            groups = step.groups
    made.update(groups)
    returns = made._agent.memory.get_tensor_by_name("returns")
    assert returns[1].flatten().tolist() == pytest.approx([1.0, 1.0], rel=1e-5)


def test_an_update_tells_its_losses():
    env = TensorEnv(CountingEnv([0] * 4))
    made = learner(env, rollouts=4)
    groups = env.reset()
    for _ in range(2):
        for _ in range(made.steps):
            with torch.no_grad():
                step = env.step(made.act(groups))
                made.record(step)
            groups = step.groups
        found = made.update(groups)
    assert set(found) == {
        *("policy_loss", "value_loss", "entropy_loss"),
        *("learning_rate", "std"),
    }
    scaler = made._agent.checkpoint_modules["observation_preprocessor"]
    assert float(scaler.current_count) == 1 + 2 * 4 * 4


def test_the_actor_is_a_copy_with_its_normalization():
    env = TensorEnv(CountingEnv([0] * 2))
    made = learner(env)
    scaler = made._agent.checkpoint_modules["observation_preprocessor"]
    scaler.running_mean += 3.0
    actor = made.actor()
    seen = torch.tensor([[1.0, 2.0, 3.0]])
    with torch.no_grad():
        wanted = made._policy.net(seen - 3.0)
        made._policy.net[0].weight.zero_()
        np.testing.assert_allclose(actor(seen), wanted, atol=1e-5)

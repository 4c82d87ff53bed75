"""PPO of rsl_rl and of skrl: their environments in their own trainers, and the values learned."""

from __future__ import annotations

import dataclasses
import inspect
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from torch import Tensor, nn

import embodichain
from embodichain.config.keys.tensor_algorithms import RslRlPpoCfg, SkrlPpoCfg, TensorAlgoCfg
from embodichain.learning.tensors.tensor_env import TensorEnv
from tests.helpers.extras import needs
from tests.learning.counting import CountingEnv

pytestmark = pytest.mark.slow

STATE = ["task.observations.to_goal.group=critic", "task.max_episode_steps=5", "seed=1"]


@pytest.fixture
def reach():
    env = embodichain.make("reach", 3, STATE)
    yield env
    env.close()


class RslRl:
    """PPO of rsl_rl, and where its numbers are.

    They are read from rsl_rl's own objects, which `RslRlPpo` has in a private attribute: a training
    has no use for them.
    """

    cfg_type = RslRlPpoCfg
    keys = {"steps": "num_steps_per_env", "discount": "gamma"}
    # Arguments that are built from other keys, or not offered.
    other_arguments = {
        *("self", "actor", "critic", "storage", "device", "schedule", "desired_kl"),
        *("rnd_cfg", "symmetry_cfg", "multi_gpu_cfg", "grad_reduce_bucket_mb"),
    }
    own_keys = {"num_steps_per_env"}
    losses = {"value_loss", "surrogate_loss", "entropy_loss"}

    def __init__(self, env: TensorEnv, **keys: Any) -> None:
        from embodichain.learning.tensors.rsl_rl_ppo import RslRlPpo

        self.learner = RslRlPpo(RslRlPpoCfg(hidden_dims=[4], **keys), env)
        self.ppo = self.learner._ppo

    @staticmethod
    def arguments() -> set[str]:
        """The arguments of the library's PPO."""
        from rsl_rl.algorithms import PPO

        return set(inspect.signature(PPO.__init__).parameters)

    @property
    def discount(self) -> float:
        return self.ppo.gamma

    @property
    def desired_kl(self) -> float | None:
        """None if the learning rate is fixed."""
        return self.ppo.desired_kl if self.ppo.schedule == "adaptive" else None

    @property
    def layers(self) -> nn.Module:
        return self.ppo.actor.mlp

    @property
    def std(self) -> Tensor:
        return self.ppo.actor.distribution.std_param

    @property
    def normalizes(self) -> bool:
        return self.ppo.actor.obs_normalization

    @property
    def normalized_rows(self) -> int:
        """Number of observations that the normalization has read."""
        return int(self.ppo.actor.obs_normalizer.count)

    @property
    def rewards(self) -> Tensor:
        """(steps, N) rewards as they are stored, the value of what was cut off included."""
        return self.ppo.storage.rewards[..., 0]

    @property
    def observations(self) -> Tensor:
        """(steps, N, K) observations as they are stored."""
        return self.ppo.storage.observations["policy"]

    def value_at_the_limit(self, last: Tensor) -> float:
        """What is added for environment 1: the value of the observation before its last step."""
        return float(self.ppo.storage.values[1, 1, 0])


class Skrl:
    """PPO of skrl, and where its numbers are.

    They are read from skrl's own objects, which `SkrlPpo` has in private attributes: a training has
    no use for them.
    """

    cfg_type = SkrlPpoCfg
    keys = {"steps": "rollouts", "discount": "discount_factor"}
    # Arguments that are built from other keys, or not offered.
    other_arguments = {
        *("experiment", "rewards_shaper"),
        *("learning_rate_scheduler", "learning_rate_scheduler_kwargs"),
        *("observation_preprocessor", "observation_preprocessor_kwargs"),
        *("state_preprocessor", "state_preprocessor_kwargs"),
        *("value_preprocessor", "value_preprocessor_kwargs"),
    }
    own_keys: set[str] = set()
    losses = {"policy_loss", "value_loss", "entropy_loss"}

    def __init__(self, env: TensorEnv, **keys: Any) -> None:
        from embodichain.learning.tensors.skrl_ppo import SkrlPpo

        self.learner = SkrlPpo(SkrlPpoCfg(hidden_dims=[4], **keys), env)
        self.agent = self.learner._agent
        self.policy = self.learner._policy

    @staticmethod
    def arguments() -> set[str]:
        """The arguments of the library's PPO."""
        from skrl.agents.torch.ppo import PPO_CFG

        return {field.name for field in dataclasses.fields(PPO_CFG)}

    @property
    def discount(self) -> float:
        return self.agent.cfg.discount_factor

    @property
    def desired_kl(self) -> float | None:
        """None if the learning rate is fixed."""
        scheduler = self.agent.scheduler
        return None if scheduler is None else scheduler.kl_threshold

    @property
    def layers(self) -> nn.Module:
        return self.policy.net

    @property
    def std(self) -> Tensor:
        return self.policy.log_std.exp()

    @property
    def normalizes(self) -> bool:
        return "observation_preprocessor" in self.agent.checkpoint_modules

    @property
    def normalized_rows(self) -> int:
        """Number of observations that the normalization has read."""
        scaler = self.agent.checkpoint_modules["observation_preprocessor"]
        return int(scaler.current_count) - 1  # which begins with 1

    @property
    def rewards(self) -> Tensor:
        """(steps, N) rewards as they are stored, the value of what was cut off included."""
        return self.agent.memory.get_tensor_by_name("rewards")[..., 0]

    @property
    def observations(self) -> Tensor:
        """(steps, N, K) observations as they are stored."""
        return self.agent.memory.get_tensor_by_name("observations")

    def value_at_the_limit(self, last: Tensor) -> float:
        """What is added for environment 1: the value of its last observation."""
        scaler = self.agent.checkpoint_modules["observation_preprocessor"]
        inputs = {"observations": scaler(last), "states": None}
        with torch.no_grad():
            value, _ = self.agent.value.act(inputs, role="value")
        return float(value)


BOTH = pytest.mark.parametrize(
    "library",
    [
        pytest.param(RslRl, id="rsl_rl", marks=needs("rsl_rl")),
        pytest.param(Skrl, id="skrl", marks=needs("skrl")),
    ],
)


# -- PPO -------------------------------------------------------------------------------------------


@BOTH
def test_every_argument_of_ppo_may_be_set(library):
    arguments = library.arguments() - library.other_arguments
    shared = {field.name for field in dataclasses.fields(TensorAlgoCfg)} | library.own_keys
    keys = {field.name for field in dataclasses.fields(library.cfg_type)}
    assert keys - shared == arguments
    assert set(library.cfg_type().arguments()) == arguments


@BOTH
def test_settings_reach_the_algorithm(library):
    env = TensorEnv(CountingEnv([0, 0]))
    keys = {library.keys["discount"]: 0.5, library.keys["steps"]: 3}
    ppo = library(env, init_std=0.3, activation="tanh", **keys)
    assert (ppo.discount, ppo.desired_kl, ppo.learner.steps) == (0.5, 0.01, 3)
    assert [type(layer).__name__ for layer in ppo.layers] == ["Linear", "Tanh", "Linear"]
    assert ppo.std.tolist() == pytest.approx([0.3, 0.3])
    assert ppo.normalizes
    assert library(env, desired_kl=None).desired_kl is None
    assert not library(env, obs_normalization=False).normalizes


@BOTH
def test_what_is_cut_off_is_bootstrapped_and_what_terminates_is_not(library):
    """Environment 0 terminates in step 2, environment 1 is cut off there; rewards are 1."""
    env = TensorEnv(CountingEnv([2, 0], limit=2))
    ppo = library(env, **{library.keys["steps"]: 2, library.keys["discount"]: 0.9})
    groups = env.reset()
    with torch.no_grad():
        for _ in range(2):
            ppo.learner.act(groups)
            step = env.step(torch.tensor([[1.0, 0.0]] * 2))
            ppo.learner.record(step)
            groups = step.groups
    last = torch.tensor([[1.0, 0.0, 2.0]])  # environment, episode, steps: before the reset
    value = ppo.value_at_the_limit(last)
    assert value != 0.0
    assert ppo.rewards[0].tolist() == [1.0, 1.0]
    assert ppo.rewards[1, 0] == 1.0
    assert ppo.rewards[1, 1] == pytest.approx(1.0 + 0.9 * value, rel=1e-5)
    assert ppo.observations[:, 1].tolist() == [[1, 0, 0], [1, 0, 1]]
    assert step.reward.tolist() == [1.0, 1.0]  # the environment's own tensor is unchanged
    assert step.done.tolist() == [True, True]


@BOTH
def test_updates_tell_their_losses_and_use_the_steps(library):
    env = TensorEnv(CountingEnv([0] * 4))
    ppo = library(env, **{library.keys["steps"]: 4})
    groups = env.reset()
    for _ in range(2):  # the storage is empty again after an update
        for _ in range(ppo.learner.steps):
            with torch.no_grad():
                step = env.step(ppo.learner.act(groups))
                ppo.learner.record(step)
            groups = step.groups
        numbers = ppo.learner.update(groups)
    assert set(numbers) == {*library.losses, "learning_rate", "std"}
    assert ppo.normalized_rows == 2 * 4 * 4


@needs("rsl_rl")
def test_rsl_rl_stores_where_episodes_end():
    env = TensorEnv(CountingEnv([2, 0], limit=2))
    ppo = RslRl(env, num_steps_per_env=2)
    groups = env.reset()
    with torch.no_grad():
        for _ in range(2):
            ppo.learner.act(groups)
            step = env.step(torch.tensor([[1.0, 0.0]] * 2))
            ppo.learner.record(step)
            groups = step.groups
    assert ppo.ppo.storage.dones[..., 0].tolist() == [[0, 0], [1, 1]]


@needs("skrl")
def test_skrl_without_normalization_keeps_three_modules():
    env = TensorEnv(CountingEnv([0, 0]))
    plain = Skrl(env, obs_normalization=False)
    assert set(plain.learner.state_dict()) == {"policy", "value", "optimizer"}


@needs("skrl")
def test_skrl_without_a_value_at_the_limit_ends_returns_there():
    """Both environments are cut off in step 2 of 3; rewards are 1, nothing of step 3 is in them."""
    env = TensorEnv(CountingEnv([0, 0], limit=2))
    ppo = Skrl(env, rollouts=3, discount_factor=0.9, time_limit_bootstrap=False)
    groups = env.reset()
    with torch.no_grad():
        for _ in range(3):
            ppo.learner.act(groups)
            step = env.step(torch.tensor([[1.0, 0.0]] * 2))
            ppo.learner.record(step)
            groups = step.groups
    ppo.learner.update(groups)
    returns = ppo.agent.memory.get_tensor_by_name("returns")
    assert returns[1].flatten().tolist() == pytest.approx([1.0, 1.0], rel=1e-5)


@needs("skrl")
def test_the_actor_of_skrl_is_a_copy_with_its_normalization():
    ppo = Skrl(TensorEnv(CountingEnv([0] * 2)))
    scaler = ppo.agent.checkpoint_modules["observation_preprocessor"]
    scaler.running_mean += 3.0
    actor = ppo.learner.actor()
    seen = torch.tensor([[1.0, 2.0, 3.0]])
    with torch.no_grad():
        wanted = ppo.layers(seen - 3.0)
        ppo.layers[0].weight.zero_()
        np.testing.assert_allclose(actor(seen), wanted, atol=1e-5)


# -- the environment of rsl_rl ---------------------------------------------------------------------


@needs("rsl_rl")
def test_rsl_rl_environment_steps_and_logs(reach):
    from rsl_rl.env import VecEnv

    from embodichain.learning import RslRlVecEnv

    env = RslRlVecEnv(reach, ["policy", "critic"])
    assert isinstance(env, VecEnv)
    assert (env.num_envs, env.num_actions, env.max_episode_length) == (3, 6, 5)
    obs = env.get_observations()
    assert obs.batch_size == (3,) and set(obs.keys()) == {"policy", "critic"}
    assert torch.equal(obs["critic"], reach.get_obs()["to_goal"])
    before = env.episode_length_buf.tolist()
    obs, rewards, dones, extras = env.step(torch.zeros(3, 6))
    assert (before, env.episode_length_buf.tolist()) == ([0, 0, 0], [1, 1, 1])
    assert torch.equal(env.get_observations()["policy"], obs["policy"])
    assert rewards.shape == dones.shape == extras["time_outs"].shape == (3,)
    assert set(extras["log"]) == {"Reward/distance", "Reward/near", "Metrics/success"}
    assert extras["log"]["Reward/distance"].shape == ()  # of all environments
    assert 3 * float(extras["log"]["Metrics/success"]) in (0.0, 1.0, 2.0, 3.0)
    for _ in range(4):
        obs, _, dones, extras = env.step(torch.zeros(3, 6))
    assert dones.all() and extras["time_outs"].all()
    env.episode_length_buf = torch.tensor([4, 0, 3])
    _, _, dones, _ = env.step(torch.zeros(3, 6))
    assert dones.tolist() == [True, False, False]  # of 5 steps
    assert env.episode_length_buf.tolist() == [0, 1, 4]
    with pytest.raises(ValueError, match=r"elapsed_steps must be \(3,\)"):
        env.episode_length_buf = torch.zeros(2)
    with pytest.raises(ValueError, match="must not be negative"):
        env.episode_length_buf = torch.full((3,), -1)
    obs, extras = env.reset()
    assert env.episode_length_buf.tolist() == [0, 0, 0] and extras == {}
    assert torch.equal(env.get_observations()["policy"], obs["policy"])
    assert env.unwrapped is reach
    assert env.seed(7) == 7
    env.close()


@needs("rsl_rl")
def test_rsl_rl_runner_learns_in_its_environment(reach, tmp_path, capsys):
    from rsl_rl.runners import OnPolicyRunner

    from embodichain.learning import RslRlVecEnv

    env = RslRlVecEnv(reach, ["policy", "critic"])
    network = {"class_name": "MLPModel", "hidden_dims": [8], "activation": "elu"}
    gaussian = {"class_name": "GaussianDistribution", "init_std": 1.0}
    cfg = {
        "num_steps_per_env": 6,
        "save_interval": 10,
        "obs_groups": {"actor": ["policy"], "critic": ["policy", "critic"]},
        "actor": {**network, "distribution_cfg": gaussian},
        "critic": dict(network),
        "algorithm": {"class_name": "PPO", "num_mini_batches": 2},
    }
    runner = OnPolicyRunner(env, cfg, str(tmp_path), "cpu")
    before = [p.detach().clone() for p in runner.alg.actor.parameters()]
    runner.learn(2, init_at_random_ep_len=True)
    after = list(runner.alg.actor.parameters())
    assert not any(torch.equal(a, b) for a, b in zip(before, after, strict=True))
    assert runner.alg.critic.obs_dim == runner.alg.actor.obs_dim + 3 == 21
    assert "Metrics/success" in capsys.readouterr().out
    assert (tmp_path / "model_1.pt").is_file()


# -- the environment of skrl -----------------------------------------------------------------------


@needs("skrl")
def test_skrl_environment_steps_with_a_state(reach):
    from skrl.envs.wrappers.torch import Wrapper

    from embodichain.learning import SkrlEnv

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


@needs("skrl")
def test_skrl_environment_closes_what_it_wraps(reach):
    from embodichain.learning import SkrlEnv

    env = SkrlEnv(reach)
    env.close()
    with pytest.raises(gym.error.ClosedEnvironmentError):
        reach.reset()


@needs("skrl")
@pytest.mark.parametrize("wrapped", [False, True], ids=["itself", "wrap_env"])
@pytest.mark.filterwarnings("ignore:To copy construct from a tensor")  # skrl's own
def test_skrl_trainer_learns_in_its_environment(reach, wrapped):
    from skrl.envs.wrappers.torch import wrap_env
    from skrl.trainers.torch import SequentialTrainer

    from embodichain.learning import SkrlEnv

    env = SkrlEnv(reach, ["policy", "critic"])
    ppo = Skrl(env.tensors, rollouts=6, mini_batches=2)
    before = [p.detach().clone() for p in ppo.policy.parameters()]
    cfg = {"timesteps": 12, "headless": True, "disable_progressbar": True}
    cfg |= {"close_environment_at_exit": False}
    played = wrap_env(env, verbose=False) if wrapped else env
    SequentialTrainer(cfg=cfg, env=played, agents=ppo.agent).train()
    after = list(ppo.policy.parameters())
    assert not any(torch.equal(a, b) for a, b in zip(before, after, strict=True))


@needs("skrl")
@pytest.mark.filterwarnings("ignore:To copy construct from a tensor")
def test_wrap_env_takes_it_with_its_state(reach):
    from skrl import config
    from skrl.envs.wrappers.torch import wrap_env

    from embodichain.learning import SkrlEnv

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


@needs("skrl")
@pytest.mark.filterwarnings("ignore:To copy construct from a tensor")
def test_wrap_env_takes_one_environment_of_it():
    from skrl.envs.wrappers.torch import wrap_env

    from embodichain.learning import SkrlEnv

    env = wrap_env(SkrlEnv(embodichain.make("reach", 1, STATE)), verbose=False)
    assert env.reset()[0].shape == (1, 18)
    assert [v.shape for v in env.step(torch.zeros(1, 6))[:4]] == [(1, 18), *[(1, 1)] * 3]
    env.close()


@needs("skrl")
@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP"])
def test_wrap_env_takes_vector_environments_of_gymnasium(mode):
    from skrl.envs.wrappers.torch import wrap_env

    made = gym.make_vec("embodichain/reach-v0", num_envs=2, seed=1, autoreset_mode=mode)
    env = wrap_env(made, verbose=False)
    assert (env.num_envs, env.observation_space.shape, env.action_space.shape) == (2, (21,), (6,))
    obs, _ = env.reset()
    stepped, reward, *_ = env.step(torch.zeros(2, 6))
    assert obs.shape == stepped.shape == (2, 21) and reward.shape == (2, 1)
    env.close()


@needs("skrl")
def test_the_wrapper_of_maniskill_resets_what_ended_and_nothing_else():
    from skrl.envs.wrappers.torch import wrap_env

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

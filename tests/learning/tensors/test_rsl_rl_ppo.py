"""The environment of rsl_rl, in its own runner; and the values that PPO learns."""

import dataclasses
import inspect

import pytest
import torch

import embodichain
from embodichain.config.keys.tensor_algorithms import RslRlPpoCfg, TensorAlgoCfg
from embodichain.learning.tensors.tensor_env import TensorEnv
from tests.learning.counting import CountingEnv

pytest.importorskip("rsl_rl")

from rsl_rl.algorithms import PPO
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner

from embodichain.learning import RslRlVecEnv
from embodichain.learning.tensors.rsl_rl_ppo import RslRlPpo

pytestmark = pytest.mark.slow

STATE = ["task.observations.to_goal.group=critic", "task.max_episode_steps=5", "seed=1"]
# What is built from other keys, or not offered.
GIVEN = {
    *("self", "actor", "critic", "storage", "device", "schedule", "desired_kl"),
    *("rnd_cfg", "symmetry_cfg", "multi_gpu_cfg", "grad_reduce_bucket_mb"),
}


@pytest.fixture
def reach():
    env = embodichain.make("reach", 3, STATE)
    yield env
    env.close()


def test_it_is_an_environment_of_rsl_rl(reach):
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


def test_the_runner_of_rsl_rl_learns_in_it(reach, tmp_path, capsys):
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


def test_every_argument_of_ppo_may_be_set():
    arguments = set(inspect.signature(PPO.__init__).parameters) - GIVEN
    own = {f.name for f in dataclasses.fields(TensorAlgoCfg)} | {"num_steps_per_env"}
    assert {f.name for f in dataclasses.fields(RslRlPpoCfg)} - own == arguments
    assert set(RslRlPpoCfg().arguments()) == arguments


def learner(env, **keys):
    return RslRlPpo(RslRlPpoCfg(hidden_dims=[4], **keys), env)


def test_settings_reach_the_algorithm():
    env = TensorEnv(CountingEnv([0, 0]))
    made = learner(env, gamma=0.5, init_std=0.3, activation="tanh", num_steps_per_env=3)
    ppo = made._ppo
    assert (ppo.gamma, ppo.schedule, ppo.desired_kl, made.steps) == (0.5, "adaptive", 0.01, 3)
    assert [type(m).__name__ for m in ppo.actor.mlp] == ["Linear", "Tanh", "Linear"]
    assert ppo.actor.distribution.std_param.tolist() == pytest.approx([0.3, 0.3])
    assert ppo.actor.obs_normalization
    assert learner(env, desired_kl=None)._ppo.schedule == "fixed"
    assert not learner(env, obs_normalization=False)._ppo.actor.obs_normalization


def test_what_is_cut_off_is_bootstrapped_and_what_terminates_is_not():
    """Environment 0 terminates in step 2, environment 1 is cut off there; rewards are 1."""
    env = TensorEnv(CountingEnv([2, 0], limit=2))
    made = learner(env, num_steps_per_env=2, gamma=0.9)
    groups = env.reset()
    with torch.no_grad():
        for _ in range(2):
            made.act(groups)
            step = env.step(torch.tensor([[1.0, 0.0]] * 2))
            made.record(step)
            groups = step.groups
        storage = made._ppo.storage
        value = storage.values[1, 1, 0]
    assert storage.rewards[0].flatten().tolist() == [1.0, 1.0]
    assert storage.rewards[1, 0, 0] == 1.0
    assert storage.rewards[1, 1, 0] == pytest.approx(1.0 + 0.9 * float(value))
    assert storage.dones[1].flatten().tolist() == [1, 1]
    assert storage.observations["policy"][:, 1].tolist() == [[1, 0, 0], [1, 0, 1]]


def test_an_update_tells_its_losses_and_uses_the_steps():
    env = TensorEnv(CountingEnv([0] * 4))
    made = learner(env, num_steps_per_env=4)
    groups = env.reset()
    for _ in range(2):  # the storage is empty again after an update
        for _ in range(made.steps):
            with torch.no_grad():
                step = env.step(made.act(groups))
                made.record(step)
            groups = step.groups
        found = made.update(groups)
    assert set(found) == {
        *("value_loss", "surrogate_loss", "entropy_loss"),
        *("learning_rate", "std"),
    }
    assert int(made._ppo.actor.obs_normalizer.count) == 2 * 4 * 4

import dataclasses
import importlib.util
import inspect

import numpy as np
import pytest
import torch

from embodichain.config.keys.algorithms import AlgoCfg
from embodichain.config.keys.check_types import check_types
from embodichain.config.keys.learners import LEARNERS
from embodichain.learning.sb3.algorithms import Algorithm, action_noise, algorithm_class
from embodichain.learning.sb3.vec_env import SB3VecEnv
from embodichain.utils.errors import ConfigError
from tests.learning.counting import CountingEnv


def algorithm(name="ppo", **keys):
    checked = check_types({"task": {}, "algo": {"name": name, **keys}})
    assert checked.problems == []
    return Algorithm.of(checked.root.algo)


def problems(name="ppo", **keys):
    checked = check_types({"task": {}, "algo": {"name": name, **keys}})
    found = list(checked.problems)
    try:
        Algorithm.of(checked.root.algo)
    except ConfigError as error:
        found += error.problems
    return {p.path: p for p in found}


def test_arguments_reach_the_algorithm():
    kwargs = {
        "log_std_init": -0.7,
        "net_arch": {"pi": [8], "vf": [16, 4]},
        "activation_fn": "relu",
        "optimizer_class": "sgd",
        "optimizer_kwargs": {"momentum": 0.5},
    }
    asked = algorithm(n_steps=4, batch_size=8, policy_kwargs=kwargs)
    model = asked.build(SB3VecEnv(CountingEnv([0, 0])), seed=5)
    policy = model.policy
    assert (model.n_steps, model.batch_size, model.seed) == (4, 8, 5)
    assert torch.equal(policy.log_std, torch.full((2,), -0.7))
    assert [type(m).__name__ for m in policy.mlp_extractor.value_net] == ["Linear", "ReLU"] * 2
    assert [m.out_features for m in policy.mlp_extractor.value_net[::2]] == [16, 4]
    assert isinstance(policy.optimizer, torch.optim.SGD)
    assert policy.optimizer.defaults["momentum"] == 0.5


def test_the_given_map_is_left_alone():
    kwargs = {"activation_fn": "relu"}
    algorithm(policy_kwargs=kwargs)
    assert kwargs == {"activation_fn": "relu"}


def test_unknown_algorithm():
    with pytest.raises(ConfigError) as caught:
        algorithm_class("pppo")
    assert str(caught.value) == (
        "algo.name: unknown algorithm 'pppo'; allowed: ppo, a2c, sac, td3, ddpg, dqn, trpo, tqc, "
        "crossq, recurrent_ppo, bc Did you mean 'ppo'?"
    )


# Arguments that the command gives itself, or that a config cannot write.
GIVEN = {
    *("self", "env", "seed", "device", "verbose", "tensorboard_log", "_init_setup_model"),
    *("rollout_buffer_class", "rollout_buffer_kwargs"),
    *("replay_buffer_class", "replay_buffer_kwargs", "action_noise"),
}


WITH_SB3 = [entry.config for _, entry in LEARNERS.items() if issubclass(entry.config, AlgoCfg)]


@pytest.mark.parametrize("cfg", WITH_SB3)
def test_a_config_has_every_argument_of_its_class(cfg):
    if cfg.name in ("trpo", "tqc", "crossq", "recurrent_ppo"):
        pytest.importorskip("sb3_contrib")
    arguments = set(inspect.signature(algorithm_class(cfg.name).__init__).parameters) - GIVEN
    settings = {"name", "normalize", "normalize_kwargs", "noise_type", "noise_std"}
    settings |= {"critic_groups", "symmetric"}
    assert {f.name for f in dataclasses.fields(cfg)} - settings == arguments


def test_dqn_says_what_would_fit():
    assert "use sac, td3 or ppo" in problems("dqn")["algo.name"].message


def test_a_missing_package_is_named(monkeypatch):
    # As if the package were not installed.
    monkeypatch.setattr(importlib.util, "find_spec", lambda package: None)
    assert problems("tqc")["algo.name"].message == "tqc needs a package: pip install sb3-contrib"


def test_schedules_fall_to_zero():
    arguments = algorithm(learning_rate="lin_3e-4", clip_range="lin_.2").arguments
    rates = [arguments["learning_rate"](remaining) for remaining in (1.0, 0.5, 0.0)]
    np.testing.assert_allclose(rates, [3e-4, 1.5e-4, 0.0])
    assert arguments["clip_range"](1.0) == 0.2
    found = problems(gamma="lin_0.9", learning_rate="lin_fast")
    assert found["algo.gamma"].message == "expected a number, got 'lin_0.9'"
    assert found["algo.learning_rate"].message == (
        "expected a number or a schedule lin_VALUE, got 'lin_fast'"
    )


@pytest.mark.parametrize("kind", ["normal", "ornstein-uhlenbeck"])
def test_noise_is_drawn_for_each_environment(kind):
    noise = action_noise(kind, 0.5, width=2, num_envs=3)
    drawn = np.array([noise() for _ in range(50)])
    assert drawn.shape == (50, 3, 2)
    assert not np.allclose(drawn[:, 0], drawn[:, 1])


def test_parts_of_networks_are_those_of_the_algorithm():
    algorithm("sac", policy_kwargs={"net_arch": {"pi": [4], "qf": [4]}})
    found = problems("sac", policy_kwargs={"net_arch": {"pi": [4], "vf": [4]}})
    assert found["algo.policy_kwargs.net_arch.vf"].message == (
        "unknown part; allowed: pi (policy), qf (value)"
    )


def test_every_mistake_is_reported_at_once():
    found = problems(
        learnin_rate=1e-3,
        n_steps="many",
        clip_range_vf=[1],
        seed=1,
        policy="CnnPolicyy",
        policy_kwargs={"net_arch": {"pi": [4], "qf": [4]}, "activation_fn": "rel", "ortho": True},
    )
    assert set(found) == {
        "algo.learnin_rate",
        "algo.n_steps",
        "algo.clip_range_vf",
        "algo.seed",
        "algo.policy",
        "algo.policy_kwargs.net_arch.qf",
        "algo.policy_kwargs.activation_fn",
        "algo.policy_kwargs.ortho",
    }
    assert found["algo.learnin_rate"].hint == "Did you mean 'learning_rate'?"
    assert found["algo.n_steps"].message == "expected an integer, got 'many'"
    assert found["algo.clip_range_vf"].message == "expected a number or text, got [1]"
    assert found["algo.seed"].message == (
        "not a key of an algorithm; it is a key of the root: seed=N"
    )
    assert found["algo.policy_kwargs.activation_fn"].hint == "Did you mean 'relu'?"
    assert found["algo.policy_kwargs.ortho"].hint == "Did you mean 'ortho_init'?"


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"net_arch": [0]}, "layers need a width of at least 1, got [0]"),
        ({"net_arch": ["a"]}, "expected an integer or a map, got 'a'"),
        ({"log_std_init": "low"}, "expected a number, got 'low'"),
        ({"lr_schedule": 1}, "cannot be set here: use algo.learning_rate"),
    ],
)
def test_policy_arguments(kwargs, message):
    assert problems(policy_kwargs=kwargs)[f"algo.policy_kwargs.{next(iter(kwargs))}"].message == (
        message
    )


def test_what_the_algorithm_refuses_is_the_users_mistake():
    asked = algorithm(n_steps=1, batch_size=2)
    with pytest.raises(ConfigError, match=r"algo: ppo refuses this: .*n_steps"):
        asked.build(SB3VecEnv(CountingEnv([0])), seed=0)

import pytest
import torch

from embodichain.learning.algorithms import build_algorithm, check_arguments
from embodichain.learning.vec_env import SB3VecEnv
from embodichain.utils.errors import ConfigError
from tests.learning.counting import CountingEnv


def problems(name="ppo", **arguments):
    with pytest.raises(ConfigError) as caught:
        check_arguments(name, arguments)
    return {p.path: p for p in caught.value.problems}


def test_arguments_reach_the_algorithm():
    kwargs = {
        "log_std_init": -0.7,
        "net_arch": {"pi": [8], "vf": [16, 4]},
        "activation_fn": "relu",
        "optimizer_class": "sgd",
        "optimizer_kwargs": {"momentum": 0.5},
    }
    arguments = check_arguments("ppo", {"n_steps": 4, "batch_size": 8, "policy_kwargs": kwargs})
    model = build_algorithm("ppo", arguments, SB3VecEnv(CountingEnv([0, 0])), seed=5)
    policy = model.policy
    assert (model.n_steps, model.batch_size, model.seed) == (4, 8, 5)
    assert torch.equal(policy.log_std, torch.full((2,), -0.7))
    assert [type(m).__name__ for m in policy.mlp_extractor.value_net] == ["Linear", "ReLU"] * 2
    assert [m.out_features for m in policy.mlp_extractor.value_net[::2]] == [16, 4]
    assert isinstance(policy.optimizer, torch.optim.SGD)
    assert policy.optimizer.defaults["momentum"] == 0.5


def test_the_given_map_is_left_alone():
    kwargs = {"activation_fn": "relu"}
    check_arguments("ppo", {"policy_kwargs": kwargs})
    assert kwargs == {"activation_fn": "relu"}


def test_unknown_algorithm():
    with pytest.raises(ConfigError) as caught:
        check_arguments("pppo", {})
    assert str(caught.value) == (
        "algo.name: unknown algorithm 'pppo'; allowed: ppo Did you mean 'ppo'?"
    )


def test_every_mistake_is_reported_at_once():
    found = problems(
        learnin_rate=1e-3,
        n_steps="many",
        clip_range_vf=[1],
        seed=1,
        policy="CnnPolicy",
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
    assert found["algo.n_steps"].message == "needs an integer, got 'many'"
    assert found["algo.clip_range_vf"].message == "needs a number or null, got [1]"
    assert found["algo.seed"].message == "cannot be set here: it stands at the root: seed=N"
    assert found["algo.policy_kwargs.activation_fn"].hint == "Did you mean 'relu'?"
    assert found["algo.policy_kwargs.ortho"].hint == "Did you mean 'ortho_init'?"


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"net_arch": [0]}, "layers need a width of at least 1, got [0]"),
        ({"net_arch": ["a"]}, "needs a list of integers or a map or null, got ['a']"),
        ({"log_std_init": "low"}, "needs a number, got 'low'"),
        ({"lr_schedule": 1}, "cannot be set here: use algo.learning_rate"),
    ],
)
def test_policy_arguments(kwargs, message):
    assert problems(policy_kwargs=kwargs)[f"algo.policy_kwargs.{next(iter(kwargs))}"].message == (
        message
    )


def test_what_the_algorithm_refuses_is_the_users_mistake():
    arguments = check_arguments("ppo", {"n_steps": 1, "batch_size": 2})
    with pytest.raises(ConfigError, match=r"algo: ppo refuses this: .*n_steps"):
        build_algorithm("ppo", arguments, SB3VecEnv(CountingEnv([0])), seed=0)

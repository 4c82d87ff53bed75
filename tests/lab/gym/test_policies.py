"""Policies by name, by path and by users; what they draw does not depend on N."""

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import ActionTermCfg
from embodichain.lab.gym.policies import POLICIES, resolve_policy
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import HOME, builder

MODULE = """
import torch

def shove(obs, env, force: float = 1.0):
    return torch.full((env.num_envs, 6), force)

def slide(obs, env, from_: float = 0.0):
    return torch.full((env.num_envs, 6), from_)

class Wave:
    def __init__(self, start: int = 0):
        self.count = start
        self.resets = []
    def __call__(self, obs, env):
        self.count += 1
        return torch.full((env.num_envs, 6), float(self.count))
    def reset(self, env_ids):
        self.resets.append(env_ids)

number = 3
"""


@pytest.fixture
def make():
    with builder() as build:
        yield build


class TakesObservations:
    def __call__(self, obs):
        return obs


class NeedsMore:
    def __call__(self, obs, env, scale):
        return obs


class TakesAnything:
    def __call__(self, *args):
        return args


@pytest.fixture
def user_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "user_policy_for_test.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    yield "user_policy_for_test"
    sys.modules.pop("user_policy_for_test", None)


def absolute() -> dict:
    return {"arm": ActionTermCfg(func="joint_position", params={"entity_cfg": {"uid": "ur10"}})}


def offset() -> dict:
    params = {"entity_cfg": {"uid": "ur10"}, "scale": 0.6}
    return {"arm": ActionTermCfg(func="default_offset_joint_position", params=params)}


@pytest.mark.parametrize("name", sorted(name for name, func in POLICIES.items() if callable(func)))
@pytest.mark.parametrize("actions", [{}, absolute(), offset()], ids=["none", "absolute", "offset"])
def test_every_policy_acts_within_the_action_space(make, name, actions) -> None:
    env = make(actions=actions)
    obs, _ = env.reset()
    policy = resolve_policy(name)
    policy.reset(None)
    for _ in range(3):
        action = policy(obs, env)
        assert (action.shape, action.dtype) == ((3, 6), torch.float32)
        assert env.action_space.contains(action.numpy())
        obs = env.step(action)[0]


def test_random_covers_the_space_anew_at_every_step(make) -> None:
    env = make(num_envs=64, actions=offset())
    obs, _ = env.reset()
    first, second = (resolve_policy("random")(obs, env) for _ in range(2))
    assert not torch.equal(first, second)
    assert first.min() < -0.95 and first.max() > 0.95
    assert abs(first.mean()) < 0.15
    assert len(torch.unique(first)) == 64 * 6


def test_random_around_home(make) -> None:
    env = make(num_envs=64, actions=absolute())
    obs, _ = env.reset()
    policy = resolve_policy({"func": "random_around_home", "params": {"range": 0.2}})
    noise = policy(obs, env) - torch.tensor(HOME)
    assert noise.abs().max() <= 0.2 + 1e-6
    assert noise.min() < -0.18 and noise.max() > 0.18
    # Without action terms, actions of a declared robot are joint targets as well.
    bare = make(num_envs=64)
    bare.reset()
    assert torch.equal(policy(obs, bare) - torch.tensor(HOME), noise)


def test_draws_do_not_depend_on_the_number_of_environments(make) -> None:
    drawn = []
    for count in (1, 3, 64):
        env = make(num_envs=count, actions=offset())
        obs, _ = env.reset(seed=5)
        drawn.append([resolve_policy("random")(obs, env)[0].numpy().tobytes() for _ in range(3)])
    assert drawn[0] == drawn[1] == drawn[2]


def test_hold_keeps_the_targets(make) -> None:
    env = make(actions=offset())
    obs, _ = env.reset()
    env.step(torch.full((3, 6), 0.5))
    before = env.robot.drives.read_target_qpos().copy()
    for _ in range(3):
        env.step(resolve_policy("hold")(obs, env))
    assert np.allclose(env.robot.drives.read_target_qpos(), before, atol=1e-6)


def test_zero(make) -> None:
    env = make(actions=offset())
    obs, _ = env.reset()
    assert not resolve_policy("zero")(obs, env).any()


def test_a_users_function_and_class(make, user_module) -> None:
    env = make()
    shove = resolve_policy({"func": f"{user_module}:shove", "params": {"force": 2}})
    assert shove(None, env)[0, 0] == 2.0
    shove.reset(None)  # a function has nothing to reset
    wave = resolve_policy({"func": f"{user_module}:Wave", "params": {"start": 4}})
    assert wave(None, env)[0, 0] == 5.0
    wave.reset(np.array([1]))
    assert wave.resets[0].tolist() == [1]


def test_a_parameter_that_python_reserves_has_its_word(make, user_module) -> None:
    env = make()
    obs, _ = env.reset()
    slide = resolve_policy({"func": f"{user_module}:slide", "params": {"from": 0.5}})
    assert slide(obs, env).eq(0.5).all()


def test_a_callable_is_taken_as_it_is(make) -> None:
    env = make()
    policy = resolve_policy(lambda obs, env: torch.zeros(env.num_envs, 6))
    assert policy(None, env).shape == (3, 6)


@pytest.mark.parametrize("path", ["runs/last/model.zip", "model.zip", "last", "./here"])
def test_files_are_left_to_who_can_read_them(path: str) -> None:
    loaded = []

    def load(where: Path):
        loaded.append(where)
        return resolve_policy("zero")

    resolve_policy(path, load_file=load)
    assert loaded == [Path(path)]
    with pytest.raises(ConfigError, match="is a file"):
        resolve_policy(path)


@pytest.mark.parametrize(
    ("policy", "path", "part"),
    [
        ("randm", "policy", "Did you mean 'random'?"),
        ("user_policy_for_test:shov", "policy", "Did you mean 'shove'?"),
        ("user_policy_for_test:number", "policy", "is not callable"),
        ("no_such_package_here:f", "policy", "cannot import"),
        ({"params": {}}, "policy", "needs func"),
        ({"func": "zero", "parms": {}}, "policy", "needs func"),
        (
            {"func": "random_around_home", "params": {"rnge": 1}},
            "policy.params.rnge",
            "Did you mean 'range'?",
        ),
        (
            {"func": "random_around_home", "params": {"range": -1}},
            "policy.params.range",
            "at least 0",
        ),
        (3, "policy", "is not callable"),
        (lambda obs: None, "policy", "must take (obs, env, ...) first, it takes (obs)"),
        (
            TakesObservations,
            "policy",
            "class 'TakesObservations': __call__ must take (self, obs, env), it takes (self, obs)",
        ),
        (
            NeedsMore,
            "policy",
            "__call__ must take (self, obs, env), it takes (self, obs, env, scale)",
        ),
    ],
)
def test_mistakes(user_module, policy, path, part) -> None:
    with pytest.raises(ConfigError) as caught:
        resolve_policy(policy)
    assert caught.value.problems[0].path == path
    assert part in str(caught.value)


def test_a_class_may_take_more_than_it_is_given() -> None:
    assert resolve_policy(TakesAnything)("obs", "env") == ("obs", "env")

"""What an observation is in memory: one array, its entries and groups as views of it."""

import subprocess
import sys

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs import BaseEnv
from embodichain.lab.gym.envs.cfg import ObservationCfg
from embodichain.lab.gym.envs.observation import Observation
from tests.lab.gym.conftest import flat, home, targets


def ones(env, obs, width=2):
    return np.full((env.num_envs, width), float(width))


def flags(env, obs):
    return torch.ones(env.num_envs, 2, dtype=torch.bool)


def _observed(**groups):
    return {
        name: ObservationCfg(func=ones, params={"width": width}, group=group)
        for name, (width, group) in groups.items()
    }


def test_entries_share_the_memory_of_one_array(make_env):
    env = make_env(observations=_observed(a=(2, "policy"), c=(1, "critic"), b=(3, "policy")))
    obs, _ = env.reset()
    assert isinstance(obs, Observation) and obs.rows.shape == (3, 18 + 6)
    obs["a"][1] = 7.0
    assert (obs.rows == 7.0).sum() == 2
    vector = env.observation_manager.flatten(obs)
    assert vector.shape == (3, 5) and vector[1].tolist() == [7.0, 7.0, 3.0, 3.0, 3.0]
    assert env.observation_manager.flatten(obs, "critic").tolist() == [[1.0]] * 3


def test_the_vector_has_entries_that_were_replaced(make_env):
    env = make_env(observations=_observed(a=(2, "policy"), b=(1, "policy")))
    obs, _ = env.reset()
    obs["b"] = torch.full((3, 1), 5.0)
    assert env.observation_manager.flatten(obs).tolist() == [[2.0, 2.0, 5.0]] * 3


def test_every_step_has_an_array_of_its_own(make_env):
    env = make_env()
    first, _ = env.reset()
    numbers = first.rows.copy()
    second, *_ = env.step(targets(env, 1))
    assert not np.shares_memory(first.rows, second.rows)
    np.testing.assert_array_equal(first.rows, numbers)


def test_entries_that_are_no_numbers_are_beside_the_array(make_env):
    env = make_env(observations={"f": ObservationCfg(func=flags), **_observed(a=(2, "policy"))})
    obs, *_ = env.reset()
    assert obs["f"].dtype == torch.bool and list(obs) == ["robot", "f", "a"]
    assert env.observation_manager.flatten(obs).tolist() == [[1.0, 1.0, 2.0, 2.0]] * 3


def test_a_term_that_changes_its_shape_is_an_error(make_env):
    widths = iter([2, 2, 3])

    def wider(env, obs):
        return np.zeros((env.num_envs, next(widths)))

    env = make_env(observations={"w": ObservationCfg(func=wider)})
    env.reset()
    with pytest.raises(ValueError, match=r"'w' was \(3, 2\), is now \(3, 3\)"):
        env.step(home(env))


def test_arrays_and_tensors_of_terms_are_the_same(make_env):
    def as_tensor(env, obs):
        return torch.from_numpy(env.robot.read_qpos().astype(np.float32))

    def as_array(env, obs):
        return env.robot.read_qpos()

    observations = {
        "t": ObservationCfg(func=as_tensor, scale=0.3),
        "n": ObservationCfg(func=as_array, scale=0.3),
    }
    env = make_env(observations=observations)
    env.reset()
    obs, *_ = env.step(targets(env, 2))
    assert torch.equal(obs["t"], obs["n"])


class Extended(BaseEnv):
    def _extend_obs(self, obs, **kwargs):
        assert list(obs) == ["robot"]
        obs["own"] = obs["robot", "qpos"][:, :1] * 2.0
        return obs


def test_an_overriding_hook_gets_what_was_observed_before_it(make_env):
    env, plain = make_env(cls=Extended), make_env()
    env.reset(), plain.reset()
    obs, *_ = env.step(targets(env, 1))
    expected, *_ = plain.step(targets(plain, 1))
    assert torch.equal(obs["own"], 2.0 * obs["robot", "qpos"][:, :1])
    np.testing.assert_array_equal(flat(obs)[:, :18], flat(expected))


@pytest.mark.unmeasured
def test_stepping_imports_neither_tensordict_nor_dynamo():
    code = (
        "import sys, torch, embodichain; env = embodichain.make('reach');"
        "env.reset(); obs = env.step(torch.zeros(1, 6))[0]; obs['robot']['qpos'];"
        "print([m for m in ('tensordict', 'torch._dynamo') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"

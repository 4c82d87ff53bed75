"""Environments with arrays on the device: what they return, what they refuse, their state."""

from pathlib import Path

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode

import embodichain
from embodichain.lab.gym.envs import BaseEnv, StepObserver
from embodichain.lab.gym.envs.restoring.snapshot import Snapshot
from embodichain.lab.gym.policies import resolve_policy
from embodichain.lab.gym.single import SingleEnv
from embodichain.lab.gym.vector import NumpyVectorEnv
from embodichain.lab.sim.engine.device import device_values
from embodichain.lab.sim.engine.device.device_array import DeviceArray
from embodichain.lab.sim.engine.warp.device_arrays import DeviceArrays
from embodichain.learning.checkpoints.plain_state import read_tree, write_tree
from embodichain.utils.errors import ConfigError
from tests.helpers.warp_scene import DEVICE

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

N = 3
LINES = (
    *(f"device={DEVICE}", "sim.engine=warp", "sim.warp.arrays=device", "sim.num_threads=1"),
    *("sim.warp.nconmax=64", "sim.warp.njmax=128", "seed=3", "task.max_episode_steps=7"),
)


def made(task="cart_pole", num_envs=N, **kwargs):
    return embodichain.make(task, num_envs, LINES, **kwargs)


@pytest.fixture(scope="module")
def env():
    with made() as env:
        env.reset()
        yield env


def test_a_step_returns_tensors_of_the_device(env):
    obs, reward, terminated, truncated, info = env.step(torch.zeros(N, 1, device=env.device))
    shapes = [(tuple(part.shape), part.dtype) for part in (reward, terminated, truncated)]
    assert shapes == [((N,), torch.float32), ((N,), torch.bool), ((N,), torch.bool)]
    assert obs["robot"]["qpos"].shape == (N, 2) and obs["qvel"].dtype == torch.float32
    tensors = [reward, terminated, obs["robot"]["qpos"], info["elapsed_steps"], info["diverged"]]
    assert {tensor.device.type for tensor in tensors} == {torch.device(DEVICE).type}
    assert type(obs.rows) is DeviceArray


@pytest.mark.parametrize("name", ["zero", "random", "random_around_home", "hold"])
def test_policies(env, name):
    obs, _ = env.reset()
    action = resolve_policy(name)(obs, env)
    assert action.shape == (N, 1) and action.device.type == env.device.type
    env.step(action)


def test_the_action_that_holds_positions():
    with made("reach") as env:
        obs, _ = env.reset()
        action = resolve_policy("hold")(obs, env)
        assert action.shape == (N, 6) and action.device.type == env.device.type


def test_some_environments_can_be_reset(env):
    env.reset(seed=5)
    begun = env.episode_ids
    for _ in range(3):
        obs, *_ = env.step(torch.zeros(N, 1, device=env.device))
    again, _ = env.reset(options={"reset_ids": [0, 2]})
    same = (again.rows == obs.rows).host().all(axis=1)
    assert same.tolist() == [False, True, False]
    assert env.elapsed_steps.tolist() == [0, 3, 0]
    assert (env.episode_ids - begun).tolist() == [1, 0, 1]


@pytest.mark.parametrize("kind", ["tensor", "array", "list"])
def test_values_of_users_may_be_anywhere(env, kind):
    env.reset()
    values = np.array([[0.1, 0.2], [0.3, -0.4]], np.float32)
    given = {"tensor": torch.from_numpy(values).to(env.device), "array": values}
    env.robot.set_qpos(given.get(kind, values.tolist()), env_ids=[0, 2], target=False)
    found = env.robot.get_qpos()
    assert found.device.type == env.device.type
    np.testing.assert_allclose(found.cpu()[[0, 2]], values, atol=1e-7)
    pose = np.array([[0.0, 0.5, 1.0, 1.0, 0.0, 0.0, 0.0]] * N, np.float32)
    with pytest.raises(ValueError, match=r"must have shape \(3, 2\), got \(3, 7\)"):
        env.robot.set_qpos(torch.from_numpy(pose).to(env.device), target=False)


def test_gains_and_masses_of_users_are_checked():
    with made() as env:
        env.reset()
        one = torch.ones(N, 1, device=env.device)
        for what in (env.robot.set_mass, env.robot.set_joint_drive):
            names = {"link_names": ["pole"]} if what == env.robot.set_mass else {"joint_ids": [0]}
            key = "mass" if what == env.robot.set_mass else "max_velocity"
            what(**{key: 2.0 * one}, **names)
            with pytest.raises(ValueError, match=r"must (be positive|not be negative)"):
                what(**{key: -one}, **names)
        assert env.robot.get_mass(["pole"]).tolist() == [[2.0]] * N


def test_episodes_can_be_cut_off(env):
    env.reset()
    env.truncate([0, 2])
    zero = torch.zeros(N, 1, device=env.device)
    assert [env.step(zero)[3].tolist() for _ in range(2)] == [[True, False, True], [False] * 3]


REFUSED = {
    "observers that may not be called late": lambda env: env.add_observer(StepObserver()),
    "recorded states": lambda env: env.restore(object.__new__(Snapshot)),
    "actions that are mappings": lambda env: env.step({"qpos": torch.zeros(N, 1)}),
    "results that are arrays of numpy": lambda env: NumpyVectorEnv(env),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_needs_the_host_is_refused(env, message):
    with pytest.raises(
        ConfigError, match=rf"{message} are not available .* sim\.warp\.arrays=host"
    ):
        REFUSED[message](env)


def test_a_single_environment_is_of_numpys_arrays():
    with made(num_envs=1) as env, pytest.raises(ConfigError, match="arrays of numpy"):
        SingleEnv(env)


class Starts(BaseEnv):
    def _initialize_episode(self, env_ids, **kwargs):
        pass


def test_what_takes_indices_of_environments_is_refused(env):
    with pytest.raises(ConfigError, match=r"indices .* Starts\._initialize_episode takes"):
        Starts(env.cfg)
    with pytest.raises(ConfigError, match="steps of some environments, as of .* NEXT_STEP"):
        BaseEnv(env.cfg, autoreset_mode=AutoresetMode.NEXT_STEP)


@pytest.mark.parametrize("task", ["cart_pole", "quadruped_velocity"])
def test_a_saved_state_continues_to_the_bit(task):
    """Through the file of a training's state, with episodes that end before and after."""
    rng = np.random.default_rng(0)
    with made(task) as one, made(task) as other:
        one.reset()
        other.reset()
        shape = (20, N, *one.single_action_space.shape)
        actions = torch.from_numpy(rng.uniform(-1, 1, shape).astype(np.float32)).to(one.device)
        for action in actions[:9]:
            one.step(action)
        write_tree(Path("state.npz"), one.state_dict())
        other.step(actions[0])
        other.load_state_dict(read_tree(Path("state.npz")))
        for action in actions[9:]:
            (obs, reward, *_), (obs2, reward2, *_) = one.step(action), other.step(action)
            # On a GPU contact forces are added up in any order.
            loose = 1e-3 if DEVICE != "cpu" and task == "quadruped_velocity" else 0.0
            np.testing.assert_allclose(obs2.rows.host(), obs.rows.host(), rtol=loose, atol=loose)
            np.testing.assert_allclose(reward2.cpu(), reward.cpu(), rtol=loose, atol=loose)


def test_a_state_has_only_arrays_of_the_host():
    arrays = DeviceArrays(DEVICE)
    state = {"a": arrays.put(np.arange(3)), "b": [1.5, {"c": arrays.full(2, 0.5)}], "d": (None,)}
    saved = arrays.saved(state)
    assert saved["a"]["on_device"].tolist() == [0, 1, 2] and saved["d"] == (None,)
    loaded = arrays.loaded(saved)
    assert loaded["a"].host().dtype == np.int64 and loaded["b"][0] == 1.5
    assert loaded["b"][1]["c"].host().tolist() == [0.5, 0.5]


@pytest.mark.parametrize("task", ["reach", "quadruped_velocity"])
def test_no_row_of_each_environment_is_kept_on_the_host(task, monkeypatch):
    """Small arrays of the host are constants; those with a row for each environment are large."""
    # Small enough for rows of 128 environments to be large.
    monkeypatch.setattr(device_values, "_LARGEST_CONSTANT", 2000)
    with made(task, num_envs=128) as env:
        obs, _ = env.reset()
        for _ in range(2):
            obs, *_ = env.step(resolve_policy("random")(obs, env))

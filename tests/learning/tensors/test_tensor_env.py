"""The environment as learners of tensors read it, on an environment that counts."""

from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from torch.utils._python_dispatch import TorchDispatchMode

import embodichain
from embodichain.learning.evaluation.episodes import TrainStatistics
from embodichain.learning.sb3.vec_env import SB3VecEnv
from embodichain.learning.tensors.tensor_env import EpisodeRecorder, TensorEnv, to_bounds
from embodichain.utils.errors import ConfigError
from tests.learning.counting import CountingEnv

STATE = ["task.observations.to_goal.group=critic", "task.max_episode_steps=7", "seed=1"]


@pytest.fixture
def reach():
    env = embodichain.make("reach", 3, STATE)
    yield env
    env.close()


def test_observations_are_the_groups_of_actor_and_critic(reach):
    env = TensorEnv(reach, ["policy", "critic"])
    groups = env.reset(seed=4)
    manager, obs = reach.observation_manager, reach.get_obs()
    assert list(groups) == ["policy", "critic"]
    assert {name: space.shape for name, space in env.spaces.items()} == {
        "policy": (18,),
        "critic": (3,),
    }
    for name, value in groups.items():
        assert value.dtype == torch.float32
        assert torch.equal(value, manager.flatten(obs, name))
    alone = TensorEnv(reach)
    assert list(alone.reset()) == ["policy"] and alone.critic_groups == ("policy",)


def test_the_seed_is_that_of_the_environment(reach):
    env = TensorEnv(reach, ["critic"])
    first, again, other = (env.reset(seed=s)["critic"].clone() for s in (1, 1, 2))
    assert torch.equal(first, again) and not torch.equal(first, other)


def test_a_group_that_is_missing_or_has_images_is_refused(reach):
    with pytest.raises(ConfigError, match="no observation is in group 'critics'"):
        TensorEnv(reach, ["critics"])
    camera = [
        "+task.sensors.front={sensor_type: camera, width: 8, height: 8}",
        "+task.observations.front={func: camera_image, params: {sensor: front}}",
    ]
    env = embodichain.make("reach", 1, camera)
    try:
        with pytest.raises(ConfigError, match="front is an image"):
            TensorEnv(env)
    finally:
        env.close()


def test_other_views_of_a_task_are_refused():
    with pytest.raises(ValueError, match="TensorEnv needs autoreset_mode SAME_STEP"):
        TensorEnv(CountingEnv([0], mode="NEXT_STEP"))
    with pytest.raises(ConfigError, match="finite action bounds"):
        TensorEnv(CountingEnv([0], high=np.inf))


def test_actions_are_clipped_and_scaled_to_the_bounds():
    low, high = np.float32([-3.0, 0.5]), np.float32([1.0, 20.0])
    counting = CountingEnv([0, 0], low=low, high=high)
    env = TensorEnv(counting)
    env.reset()
    env.step(torch.tensor([[-1.0, 1.0], [7.0, 0.0]]))
    np.testing.assert_array_equal(counting.actions[0], [[-3.0, 20.0], [1.0, 10.25]])
    assert env.action_space.low.tolist() == [-1.0, -1.0]


def test_actions_are_scaled_before_they_are_clipped():
    counting = CountingEnv([0], low=-2.0, high=2.0)
    env = TensorEnv(counting, action_scale=0.25)
    env.reset()
    env.step(torch.tensor([[1.0, -5.0]]))
    np.testing.assert_array_equal(counting.actions[0], [[0.5, -2.0]])


def test_scaling_hits_the_bounds_exactly():
    low, high = torch.tensor([0.1, -7.3]), torch.tensor([0.7, 1e-3])
    assert torch.equal(to_bounds(-torch.ones(1, 2), low, high)[0], low)
    assert torch.equal(to_bounds(torch.ones(1, 2), low, high)[0], high)


def test_a_step_has_the_observations_before_and_after_resets():
    env = TensorEnv(CountingEnv([2, 0], limit=3))
    env.reset()
    first = env.step(torch.zeros(2, 2))
    assert first.final is first.groups and not first.done.any()
    step = env.step(torch.zeros(2, 2))  # environment 0 terminates
    # Columns: environment, episode, steps.
    assert step.groups["policy"].tolist() == [[0, 1, 0], [1, 0, 2]]
    assert step.final["policy"].tolist() == [[0, 0, 2], [1, 0, 2]]
    assert step.terminated.tolist() == [True, False] and not step.time_out.any()
    step = env.step(torch.zeros(2, 2))  # environment 1 is cut off
    assert step.time_out.tolist() == [False, True] and step.done.tolist() == [False, True]


def test_what_terminates_at_the_limit_is_not_cut_off():
    env = TensorEnv(CountingEnv([2, 0], limit=2))
    env.reset()
    env.step(torch.zeros(2, 2))
    step = env.step(torch.zeros(2, 2))
    assert step.terminated.tolist() == [True, False]
    assert step.time_out.tolist() == [False, True]


# -- no transfer to the host ----------------------------------------------------------------------


class Transfer(Exception):
    pass


class NoTransfers(TorchDispatchMode):
    """Refuses what waits for a device: a tensor's value, or a size that depends on values."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        name = func.overloadpacket.__name__
        rows = args[1] if name in ("index", "index_put_") else ()
        masks = any(index is not None and index.dtype == torch.bool for index in rows)
        if masks or name in ("_local_scalar_dense", "nonzero", "masked_select"):
            raise Transfer(str(func))
        return func(*args, **(kwargs or {}))


class Prepared(gym.Env):
    """Returns the same tensors in every step; computes nothing."""

    def __init__(self, num_envs=3):
        self.num_envs, self.device = num_envs, torch.device("cpu")
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        box = gym.spaces.Box(-np.inf, np.inf, (2,), np.float32)
        self.single_observation_space = gym.spaces.Dict({"x": box})
        self.single_action_space = gym.spaces.Box(-2.0, 2.0, (1,), np.float32)
        self.observation_manager = SimpleNamespace(
            group_terms=lambda group: ("x",),
            image_terms=lambda group: (),
            flatten=lambda obs, group: obs["x"],
        )
        true = torch.ones(num_envs, dtype=torch.bool)
        self.obs = {"x": torch.rand(num_envs, 2)}
        self.termination_manager = SimpleNamespace(values={"early": true})
        self.judges_success = True
        self.results = self.obs, torch.rand(num_envs), true, true, self.info(true)

    def info(self, true):
        flags = dict.fromkeys(("success", "success_terminated", "fail", "diverged"), true)
        values = {"metrics": {"error": torch.rand(len(true))}, "episode_sums": {}, "rewards": {}}
        return {**flags, **values, "elapsed_steps": true.int(), "final_obs": self.obs}

    def reset(self, *, seed=None, options=None):
        return self.obs, {}

    def step(self, action):
        return self.results


@pytest.fixture
def no_transfers(monkeypatch):
    def refused(self, *args, **kwargs):
        raise Transfer("a tensor is read on the host")

    # On the CPU such a read is no transfer, and would go unseen.
    for name in ("numpy", "cpu", "tolist", "__array__"):
        monkeypatch.setattr(torch.Tensor, name, refused)
    with NoTransfers():
        yield


def test_the_check_finds_transfers(no_transfers):
    tensor = torch.ones(2)
    for read in (bool, float, torch.Tensor.item, lambda t: t.cpu(), lambda t: t[t > 0]):
        with pytest.raises(Transfer):
            read(tensor[:1])


def test_a_step_reads_nothing_on_the_host(no_transfers):
    env = TensorEnv(Prepared())
    recorder = EpisodeRecorder(env)
    env.reset()
    for _ in range(3):
        recorder.add(env.step(torch.zeros(3, 1)))
    assert env.step(torch.zeros(3, 1)).groups["policy"] is env.base.obs["x"]  # not a copy


# -- episodes -------------------------------------------------------------------------------------


def played(counting, steps):
    """A recorder after so many steps with actions of (1, 0)."""
    env = TensorEnv(counting)
    recorder = EpisodeRecorder(env)
    env.reset()
    for _ in range(steps):
        recorder.add(env.step(torch.tensor([[1.0, 0.0]] * env.num_envs)))
    return recorder


def test_episodes_of_a_rollout_are_told_at_its_end():
    recorder = played(CountingEnv([3, 2, 0], limit=5), 5)
    found = recorder.finish()
    # Environment 1 ends after steps 2 and 4, environment 0 after 3, environment 2 is cut off.
    assert found["return"].tolist() == [2.0, 3.0, 2.0, 5.0]
    assert found["length"].tolist() == [2.0, 3.0, 2.0, 5.0]
    assert found["success"].tolist() == [0.0, 1.0, 0.0, 0.0]
    assert found["Episode_Reward/steps"].tolist() == [2.0, 3.0, 2.0, 5.0]
    assert found["Episode_Termination/success"].tolist() == [0.0, 1.0, 0.0, 0.0]
    assert found["Episode_Termination/fail"].tolist() == [1.0, 0.0, 1.0, 0.0]
    assert found["Episode_Termination/time_out"].tolist() == [0.0, 0.0, 0.0, 1.0]
    assert recorder.returns.tolist() == [2.0, 1.0, 0.0]  # of the episodes that go on


def test_an_episode_goes_on_in_the_next_rollout():
    env = TensorEnv(CountingEnv([0], limit=4))
    recorder = EpisodeRecorder(env)
    env.reset()
    for steps, ended in ((3, []), (2, [4.0])):
        for _ in range(steps):
            recorder.add(env.step(torch.tensor([[1.0, 0.0]])))
        assert recorder.finish()["return"].tolist() == ended


def test_a_task_without_success_has_none():
    assert "success" not in played(CountingEnv([2], has_success=False), 2).finish()


def test_the_same_columns_as_of_stable_baselines3(make_reach, tmp_path):
    """Shares, metrics and sums of one task, by both adapters, with the same actions."""
    from embodichain.learning.training.train_logs import log_episode, make_logger

    actions = np.random.default_rng(3).uniform(-1, 1, (14, 4, 6)).astype(np.float32)
    vec_env, logger = SB3VecEnv(make_reach(4)), make_logger(tmp_path)
    vec_env.seed(5)
    vec_env.reset()
    wanted = TrainStatistics(100)
    for action in actions:
        _, _, dones, infos = vec_env.step(action)
        for i in np.flatnonzero(dones):
            wanted.add(infos[i])
            log_episode(logger, infos[i])
    env = TensorEnv(make_reach(4))
    recorder, found = EpisodeRecorder(env), TrainStatistics(100)
    env.reset(seed=5)
    for action in torch.from_numpy(actions):
        recorder.add(env.step(action))
    ended = recorder.finish()
    found.extend(ended["return"], ended["length"], ended["success"])
    columns = {n: v for n, v in logger.name_to_value.items() if n.startswith("Episode")}
    logger.close()
    assert columns.keys() == {n for n in ended if "/" in n}
    for name, value in columns.items():
        assert ended[name].mean() == pytest.approx(value, abs=1e-6), name
    assert (found.episodes, found.mean_length) == (wanted.episodes, wanted.mean_length)
    assert found.mean_return == pytest.approx(wanted.mean_return, rel=1e-5)
    assert found.success_rate == wanted.success_rate

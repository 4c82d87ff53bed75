import gymnasium as gym
import numpy as np
import pytest
import torch

from embodichain.config import resolve
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.learning.sb3.algorithms import Algorithm
from embodichain.learning.sb3.vec_env import SB3VecEnv
from embodichain.learning.spaces import UNBOUNDED, ActionScale, observation_box
from embodichain.learning.tensors.tensor_env import to_bounds
from embodichain.utils.errors import ConfigError
from tests.learning.counting import CountingEnv


def box(low, high):
    return gym.spaces.Box(np.float32(low), np.float32(high), dtype=np.float32)


def test_ends_are_met_to_the_bit():
    rng = np.random.default_rng(0)
    low = -rng.uniform(0, 10, 500).astype(np.float32)
    high = rng.uniform(0, 1e-3, 500).astype(np.float32)
    scale = ActionScale(box(low, high))
    np.testing.assert_array_equal(scale(np.ones((1, 500))), high[None])
    np.testing.assert_array_equal(scale(-np.ones((1, 500))), low[None])


def test_scaling_is_linear_and_float32():
    scale = ActionScale(box([-1, 0], [3, 0.5]))
    scaled = scale([[0.0, 0.0], [0.5, -0.5]])
    np.testing.assert_allclose(scaled, [[1.0, 0.25], [2.0, 0.125]])
    assert scaled.dtype == np.float32
    assert scale.space == gym.spaces.Box(-1, 1, (2,), np.float32)


def test_unit_bounds_change_no_bit_and_share_no_memory():
    actions = np.random.default_rng(1).uniform(-1.5, 1.5, (4, 2)).astype(np.float32)
    scaled = ActionScale(box([-1, -1], [1, 1]))(actions)
    np.testing.assert_array_equal(scaled, actions)
    assert not np.shares_memory(scaled, actions)


@pytest.mark.parametrize("shape", [(2,), (3, 1), (3, 3), (3, 2, 1)])
def test_wrong_shape_is_not_broadcast(shape):
    with pytest.raises(ValueError, match=r"shape \(N, 2\), got"):
        ActionScale(box([-2, -2], [2, 2]))(np.zeros(shape))


@pytest.mark.parametrize(
    ("space", "message"),
    [
        (gym.spaces.Discrete(3), r"needs a Box \(A,\) as action space, got Discrete"),
        (gym.spaces.Box(-1, 1, (2, 2)), r"needs a Box \(A,\)"),
        (box([-1, -np.inf], [1, 1]), r"finite action bounds; columns \[1\] have none"),
    ],
)
def test_spaces_nobody_can_learn_in(space, message):
    with pytest.raises(ConfigError, match=message):
        ActionScale(space)


def test_columns_without_bounds_stay_as_they_are():
    scale = ActionScale(box([-np.inf, 0], [np.inf, 0.5]))
    assert scale.unbounded.tolist() == [True, False]
    assert scale.space.high.tolist() == [UNBOUNDED, 1.0]
    assert scale([[2.5, 1.0]]).tolist() == [[2.5, 0.5]]
    assert scale.inverse([[2.5, 0.25]]).tolist() == [[2.5, 0.0]]
    low, high = torch.tensor([-np.inf, 0.0]), torch.tensor([np.inf, 0.5])
    assert to_bounds(torch.tensor([[2.5, 3.0]]), low, high).tolist() == [[2.5, 0.5]]


@pytest.mark.parametrize("name", ["sac", "td3", "ppo"])
def test_learners_that_need_bounds_name_the_key(name):
    overrides = ["task=reach", "~task.actions.arm.params.clip", "num_envs=2", f"algo={name}"]
    resolved = resolve([*overrides, "++task.actions.arm.params.bounds=null"], "train")
    env = BaseEnv(resolved.env_cfg, autoreset_mode="SAME_STEP")
    try:
        vec_env = SB3VecEnv(env)
        algorithm = Algorithm.of(resolved.root.algo)
        if name == "ppo":
            model = algorithm.build(vec_env, 0)
            assert (model.action_space.high == UNBOUNDED).all()
            return
        wanted = (
            rf"algo.name: {name} needs bounds .*Write task.actions.arm.params: {{clip: \[-1, 1\]}}"
        )
        with pytest.raises(ConfigError, match=wanted):
            algorithm.build(vec_env, 0)
    finally:
        env.close()


def test_observation_is_the_group_and_nothing_else():
    assert observation_box(CountingEnv([0]), "policy").shape == (3,)


def test_unknown_group_lists_the_groups():
    with pytest.raises(ConfigError, match="no observation is in group 'critic'; there are: policy"):
        observation_box(CountingEnv([0]), "critic")

"""EmbodiChain's traps, mended: numbers are those of the compatibility page.

Traps 3 and 4 (terms that keep something over a reset) and 11 (relative actions on some joints) are
tested with the managers; 16 (defaults of the command line that overwrite a file) with the command.
"""

import gymnasium as gym
import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs import BaseEnv, EnvCfg
from embodichain.lab.gym.envs.cfg import MetricCfg, PhysicsTaskCfg, TerminationCfg
from embodichain.lab.gym.utils.registration import REGISTERED_ENVS, register_env
from embodichain.lab.sim.cfg import RigidObjectCfg, SimulationManagerCfg
from embodichain.utils.errors import ConfigError
from tests.lab.gym.conftest import flat, home, targets, task


def test_1_the_terminal_observation_is_kept(make_env):
    env = make_env(max_episode_steps=2)
    env.reset()
    env.step(targets(env, 0))
    obs, _, _, truncated, info = env.step(targets(env, 1))
    assert truncated.all() and info["_final_obs"].all()
    moved = flat(info["final_obs"])[:, :6]
    assert (np.abs(moved - flat(obs)[:, :6]) > 1e-3).any()
    np.testing.assert_allclose(obs["robot", "qpos"], home(env), atol=1e-6)


def test_2_no_scalar_time_limit_is_added(make_env):
    class Limited(BaseEnv):
        def __init__(self, num_envs=1, **kwargs):
            super().__init__(task(num_envs=num_envs, max_episode_steps=100), **kwargs)

    register_env("Trap2-v0", max_episode_steps=2, override=True)(Limited)
    env = gym.make("Trap2-v0", num_envs=3)
    try:
        assert env.unwrapped.max_episode_steps == 2
        env.reset()
        for _ in range(2):
            truncated = env.step(home(env.unwrapped))[3]
        assert isinstance(truncated, torch.Tensor) and truncated.tolist() == [True] * 3
        assert not env.step(home(env.unwrapped))[3].any()
    finally:
        env.close()
        REGISTERED_ENVS.pop("Trap2-v0")
        gym.registry.pop("Trap2-v0")


def test_5_active_joints_do_not_add_up_over_environments(make_env):
    class Picks(BaseEnv):
        def _setup_robot(self, **kwargs):
            robot = super()._setup_robot(**kwargs)
            self.active_joint_ids.extend([0, 2])
            return robot

    for _ in range(2):
        env = make_env(cls=Picks)
        assert env.active_joint_ids == [0, 2] and env.single_action_space.shape == (2,)
        obs, _ = env.reset()
        assert obs["robot", "qpos"].shape == (3, 2)
        env.step(home(env)[:, [0, 2]])
    assert BaseEnv.active_joint_ids == []


def test_6_elapsed_steps_in_info_are_a_copy(make_env):
    env = make_env(max_episode_steps=2)
    env.reset()
    first = env.step(home(env))[4]["elapsed_steps"]
    second = env.step(home(env))[4]["elapsed_steps"]
    env.step(home(env))
    assert first.tolist() == [1, 1, 1]
    assert second.tolist() == [2, 2, 2]  # though the automatic reset has put the counter to 0


def test_7_a_seed_reaches_gymnasium_as_well(make_env):
    env = make_env()
    env.reset(seed=3)
    numbers = env.np_random.random(3), torch.rand(3)
    env.reset(seed=3)
    np.testing.assert_array_equal(env.np_random.random(3), numbers[0])
    assert torch.equal(torch.rand(3), numbers[1])


def test_8_euler_angles_mean_the_same_in_every_way_to_say_them(make_env):
    turned = RigidObjectCfg(init_rot=(90.0, 0.0, 90.0), body_type="kinematic")
    env = make_env(objects={"cube": turned})
    env.reset()
    # Intrinsic XYZ: R = Rx(90) Rz(90) takes x to Rx(90) y = z, y to -x, z to -y.
    expected = torch.tensor([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    pose = env.sim.get_rigid_object("cube").get_local_pose(to_matrix=True)[0, :3, :3]
    np.testing.assert_allclose(pose, expected, atol=1e-6)
    matrix = np.eye(4)
    matrix[:3, :3] = expected
    same = RigidObjectCfg(init_local_pose=matrix, body_type="kinematic")
    other = make_env(objects={"cube": same})
    other.reset()
    pose = other.sim.get_rigid_object("cube").get_local_pose(to_matrix=True)[0, :3, :3]
    np.testing.assert_allclose(pose, expected, atol=1e-6)


def test_9_a_misspelt_entity_is_an_error(make_env):
    env = make_env()
    with pytest.raises(ConfigError, match="Did you mean 'cube'"):
        env.scene_entity({"uid": "cub"})


def test_10_unknown_keys_are_errors(make_env):
    with pytest.raises(TypeError, match="colour"):
        RigidObjectCfg(colour="red")
    env = make_env()
    with pytest.raises(ConfigError, match="uuid"):
        env.scene_entity({"uuid": "cube"})


def test_12_targets_are_clamped_to_the_joint_limits(make_env):
    env = make_env()
    env.reset()
    env.step(torch.full((3, 6), 100.0))
    high = env.robot.body_data.qpos_limits[:, :, 1]
    assert torch.equal(env.robot.get_qpos(target=True), high)


def test_13_no_config_is_shared(make_env):
    assert EnvCfg().sim_cfg is not EnvCfg().sim_cfg
    cfg = task(sim_cfg=SimulationManagerCfg(headless=True, num_threads=1))
    first, second = make_env(cfg), make_env(cfg)
    first.cfg.sim_cfg.arena_space = 9.0
    assert cfg.sim_cfg.arena_space == second.cfg.sim_cfg.arena_space == 5.0
    assert cfg.sim_cfg.num_envs == 1 and first.sim.num_envs == 3


def test_14_a_task_sets_its_own_timestep_and_seed(make_env):
    env = make_env(physics=PhysicsTaskCfg(physics_dt=0.002), seed=17)
    assert env.sim.scene.model.opt.timestep == 0.002 and env.seed_value == 17


def test_15_success_is_not_assumed(make_env):
    class Watched(BaseEnv):
        seen = ()

        def _initialize_episode(self, env_ids, **kwargs):
            self.seen = (*self.seen, self._task_success.tolist())

    plain = make_env(cls=Watched, max_episode_steps=1)
    plain.reset()
    plain.step(home(plain))
    assert plain.seen == ([False] * 3, [False] * 3)
    first = TerminationCfg(
        func=lambda env, obs, action, info: torch.tensor([True, False, False]), kind="success"
    )
    env = make_env(cls=Watched, terminations={"done": first})
    env.reset()
    env.step(home(env))
    assert env.seen[1] == [True, False, False]
    second = MetricCfg(func=lambda env, obs, action, info: torch.tensor([0.0, 1.0, 0.0]))
    env = make_env(cls=Watched, metrics={"success": second}, max_episode_steps=1)
    env.reset()
    info = env.step(home(env))[4]
    assert env.seen[1] == info["success"].tolist() == [False, True, False]
    assert not info["success_terminated"].any()


def test_an_action_hook_may_return_nothing(make_env):
    """Of EmbodiChain's rewards: a `_step_action` that returns None must not reach them."""

    class Silent(BaseEnv):
        def _step_action(self, action):
            self.robot.set_qpos(action)

        def get_reward(self, obs, action, info):
            return action.sum(dim=1)

    env = make_env(cls=Silent)
    env.reset()
    action = targets(env, 1)
    assert torch.equal(env.step(action)[1], action.sum(dim=1))

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode

from embodichain.lab.gym.envs import BaseEnv
from embodichain.lab.gym.envs.cfg import MetricCfg, RewardCfg
from tests.lab.gym.conftest import flat, jumping, targets


def _ends_alone(env, obs, action, info):
    """Environment 1 fails at its second step."""
    return (torch.arange(env.num_envs) == 1) & (env.elapsed_steps == 1)


class Drifting(BaseEnv):
    """Draws in every place a hook can."""

    def _initialize_episode(self, env_ids, **kwargs):
        qpos = self.robot.body_data.qpos[env_ids] + self.rand("start", (6,), -0.1, 0.1, env_ids)
        self.robot.set_qpos(qpos, env_ids=env_ids, target=False)

    def _update_sim_state(self, **kwargs):
        self.force = self.rand("force", (6,), -1.0, 1.0)
        self.robot.set_qf(self.force)

    def evaluate(self, **kwargs):
        return {"fail": _ends_alone(self, None, None, None)}


def _make(make_env, mode, **sections):
    return make_env(
        cls=Drifting,
        **jumping(),
        rewards={"x": RewardCfg(func=lambda env, obs, action, info: 1.0 + obs["cube"][:, 0])},
        metrics={"n": MetricCfg(func=lambda env, o, a, i: torch.ones(env.num_envs), reduce="sum")},
        env_kwargs={"autoreset_mode": mode},
        **sections,
    )


def test_the_default_is_same_step_and_belongs_to_the_instance(make_env):
    env, other = make_env(), make_env(env_kwargs={"autoreset_mode": "next_step"})
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert other.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert BaseEnv.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    with pytest.raises(ValueError, match="SAME_STEP, DISABLED.*Did you mean"):
        make_env(env_kwargs={"autoreset_mode": "SAME_STAP"})


def test_the_final_observation_is_the_one_without_autoreset(make_env):
    env, twin = _make(make_env, "SAME_STEP"), _make(make_env, "DISABLED")
    env.reset(seed=1), twin.reset(seed=1)
    for step in range(2):
        obs, reward, terminated, truncated, info = env.step(targets(env, step))
        expected = twin.step(targets(twin, step))
    assert terminated.tolist() == [False, True, False] and not truncated.any()
    np.testing.assert_array_equal(flat(info["final_obs"])[1], flat(expected[0])[1])
    np.testing.assert_array_equal(flat(obs)[[0, 2]], flat(expected[0])[[0, 2]])
    assert (flat(obs)[1] != flat(expected[0])[1]).any()
    np.testing.assert_array_equal(reward, expected[1])
    assert info["final_observation"] is info["final_obs"]
    assert info["_final_obs"].tolist() == info["_final_info"].tolist() == [False, True, False]
    assert info["final_info"]["elapsed_steps"].tolist() == [2, 2, 2]
    assert info["final_info"]["metrics"]["n"].tolist() == [2.0, 2.0, 2.0]
    assert info["elapsed_steps"].tolist() == [2, 2, 2] and env.elapsed_steps.tolist() == [2, 0, 2]
    assert "final_obs" not in expected[4]


def test_without_ends_there_is_no_final_observation(make_env):
    env = _make(make_env, "SAME_STEP")
    env.reset()
    info = env.step(targets(env, 0))[4]
    assert not {"final_obs", "final_info", "_final_obs", "_final_info"} & set(info)


def test_an_automatic_reset_equals_an_explicit_one_to_the_bit(make_env):
    env, twin = _make(make_env, "SAME_STEP"), _make(make_env, "DISABLED")
    env.reset(seed=9), twin.reset(seed=9)
    for step in range(9):
        obs, _, terminated, truncated, _ = env.step(targets(env, step))
        expected, _, t, u, _ = twin.step(targets(twin, step))
        assert torch.equal(terminated, t) and torch.equal(truncated, u)
        done = terminated | truncated
        if done.any():
            expected, _ = twin.reset(options={"reset_ids": done.nonzero().squeeze(-1)})
        np.testing.assert_array_equal(env.sim.engine.rows, twin.sim.engine.rows)
        np.testing.assert_array_equal(flat(obs), flat(expected))
        for name, counters in env.streams.state_dict()["counters"].items():
            np.testing.assert_array_equal(counters, twin.streams.state_dict()["counters"][name])
    assert env.episode_ids.tolist() == twin.episode_ids.tolist() == [0, 4, 0]


def test_next_step_resets_in_the_following_step_and_ignores_its_action(make_env):
    env, twin = _make(make_env, "NEXT_STEP"), _make(make_env, "DISABLED")
    env.reset(seed=9), twin.reset(seed=9)
    for step in range(2):
        obs, _, terminated, _, info = env.step(targets(env, step))
        expected, *_ = twin.step(targets(twin, step))
        np.testing.assert_array_equal(flat(obs), flat(expected))
        assert "final_obs" not in info
    assert terminated.tolist() == [False, True, False]
    expected, _ = twin.reset(options={"env_ids": [1]})
    rows = twin.sim.engine.rows[1].copy()
    obs, reward, terminated, truncated, info = env.step(targets(env, 2))
    np.testing.assert_array_equal(env.sim.engine.rows[1], rows)
    np.testing.assert_array_equal(flat(obs)[1], flat(expected)[1])
    assert reward[1] == 0 and reward[0] != 0
    assert not terminated.any() and not truncated.any() and not info["fail"].any()
    assert env.elapsed_steps.tolist() == [3, 0, 3] and info["metrics"]["n"][1] == 0
    # From here on, environment 1 lives as its twin does.
    for step in range(3, 5):
        obs, reward, terminated, _, info = env.step(targets(env, step))
        expected, expected_reward, t, _, expected_info = twin.step(targets(twin, step))
        np.testing.assert_array_equal(env.sim.engine.rows[1], twin.sim.engine.rows[1])
        np.testing.assert_array_equal(flat(obs)[1], flat(expected)[1])
        assert reward[1] == expected_reward[1] and terminated[1] == t[1]
        assert info["episode_sums"]["x"][1] == expected_info["episode_sums"]["x"][1]


def test_an_explicit_reset_takes_a_pending_one_away(make_env):
    env = _make(make_env, "NEXT_STEP")
    env.reset()
    for step in range(2):
        env.step(targets(env, step))
    env.reset(options={"env_ids": [1]})
    _, reward, *_ = env.step(targets(env, 2))
    assert reward[1] != 0 and env.episode_ids.tolist() == [0, 1, 0]
    assert env.elapsed_steps.tolist() == [3, 1, 3]


def test_disabled_never_resets(make_env):
    env = _make(make_env, "DISABLED", max_episode_steps=2)
    env.reset()
    for step in range(4):
        _, _, _, truncated, info = env.step(targets(env, step))
        assert truncated.all() == (step >= 1) and "final_obs" not in info
    assert env.episode_ids.tolist() == [0, 0, 0] and env.elapsed_steps.tolist() == [4, 4, 4]


def test_a_time_limit_is_each_environments_own(make_env):
    env = make_env(max_episode_steps=3)
    env.reset()
    env.step(targets(env, 0))
    env.reset(options={"env_ids": [0]})
    ends = [env.step(targets(env, step))[3].tolist() for step in range(4)]
    assert ends == [[False] * 3, [False, True, True], [True, False, False], [False] * 3]

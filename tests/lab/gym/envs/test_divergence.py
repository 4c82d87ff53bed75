import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs import BaseEnv
from embodichain.lab.gym.envs.cfg import MetricCfg, ObservationCfg, RewardCfg, TerminationCfg
from embodichain.utils.arrays import all_finite
from tests.lab.gym.conftest import flat, home, jumping, marker, targets

BAD = 1


def _sections():
    return {
        **jumping(),
        "rewards": {"x": RewardCfg(func=lambda env, obs, action, info: 1 + obs["cube"][:, 0])},
        "metrics": {
            "success": MetricCfg(func=lambda env, obs, a, i: obs["robot"]["qpos"][:, 0] > -100)
        },
        "terminations": {
            "low": TerminationCfg(func=lambda env, obs, a, i: obs["robot"]["qpos"][:, 0] < -100)
        },
    }


def _poison(env, field, value):
    """Write below the handles, in one environment, into the first column of a component.

    The first mocap body is the robot's base.
    """
    env.sim.engine.write(field, value, np.array([BAD]), slice(0, 1))


class Poisoned(BaseEnv):
    """Poisons one environment after the action of a step was applied, before physics."""

    poison = None

    def _step_action(self, action):
        super()._step_action(action)
        if self.poison is not None and self.control_step == 2:
            _poison(self, *self.poison)


CASES = {
    "qpos nan": ("qpos", np.nan),
    "qpos inf": ("qpos", np.inf),
    "qvel nan": ("qvel", np.nan),
    "qvel 1e30": ("qvel", 1e30),
    "ctrl nan": ("ctrl", np.nan),
    "mocap_pos nan": ("mocap_pos", np.nan),
    "mocap_quat nan": ("mocap_quat", np.nan),
}


@pytest.mark.parametrize("case", CASES)
def test_a_poisoned_environment_ends_and_touches_no_other(make_env, case):
    env, twin = make_env(cls=Poisoned, **_sections()), make_env(cls=Poisoned, **_sections())
    env.reset(seed=3), twin.reset(seed=3)
    env.poison = CASES[case]
    diverged = []
    previous = None
    for step in range(6):
        got, expected = env.step(targets(env, step)), twin.step(targets(twin, step))
        obs, reward, terminated, truncated, info = got
        others = [0, 2]
        np.testing.assert_array_equal(flat(obs)[others], flat(expected[0])[others])
        np.testing.assert_array_equal(env.sim.engine.rows[others], twin.sim.engine.rows[others])
        np.testing.assert_array_equal(reward[others], expected[1][others])
        assert np.isfinite(flat(obs)).all() and torch.isfinite(reward).all()
        for name in ("rewards", "episode_sums", "metrics"):
            assert all(torch.isfinite(v.float()).all() for v in info[name].values())
        if info["diverged"].any():
            diverged.append(step)
            assert info["diverged"].tolist() == terminated.tolist() == [False, True, False]
            assert not truncated.any() and reward[BAD] == 0
            assert not info["success"][BAD] and not info["fail"][BAD]
            np.testing.assert_array_equal(flat(info["final_obs"])[BAD], previous)
            assert env.episode_ids.tolist() == [0, 1, 0]
        previous = flat(obs)[BAD]
    if not case.startswith("mocap"):  # nothing need show that a base's pose is lost
        assert diverged == [2]


def test_an_observed_nan_is_found_though_no_counter_rises(make_env):
    class Lost(BaseEnv):
        def _update_sim_state(self, **kwargs):
            if self.control_step == 1:
                column = 3 * self.sim.get_rigid_object("cube").entity.mocap_id
                where = slice(column, column + 1)
                self.sim.engine.write("mocap_pos", np.nan, np.array([BAD]), where)

    env = make_env(cls=Lost, observations={"cube": ObservationCfg(func=marker)})
    env.reset()
    before, *_ = env.step(home(env))
    _, _, terminated, _, info = env.step(home(env))
    assert info["diverged"].tolist() == terminated.tolist() == [False, True, False]
    np.testing.assert_array_equal(flat(info["final_obs"])[BAD], flat(before)[BAD])


@pytest.mark.parametrize("where", ["get_reward", "_extend_reward", "term"])
def test_a_reward_that_is_not_finite_ends_its_environment(make_env, where):
    bad = torch.tensor([1.0, torch.nan, 2.0])
    sections, hooks = {}, {}
    if where == "term":
        sections = {"rewards": {"r": RewardCfg(func=lambda env, obs, action, info: bad)}}
    else:
        hooks = {where: lambda self, *args: bad}
    env = make_env(cls=type("Paid", (BaseEnv,), hooks), **sections)
    env.reset()
    _, reward, terminated, _, info = env.step(home(env))
    assert reward.tolist() == [1.0, 0.0, 2.0] and terminated.tolist() == [False, True, False]
    assert info["diverged"].tolist() == [False, True, False]
    if where == "term":
        assert info["rewards"]["r"].tolist() == info["episode_sums"]["r"].tolist() == [1, 0, 2]
    assert torch.isnan(bad[1])  # the hook's own tensor is not touched


def test_ignore_terminations_does_not_keep_what_diverged(make_env):
    env = make_env(ignore_terminations=True)
    env.reset()
    _poison(env, "qpos", np.nan)
    _, _, terminated, _, info = env.step(home(env))
    assert terminated.tolist() == info["diverged"].tolist() == [False, True, False]


@pytest.mark.parametrize("mode", ["NEXT_STEP", "DISABLED"])
def test_other_modes_hand_out_the_last_finite_observation(make_env, mode):
    env = make_env(env_kwargs={"autoreset_mode": mode})
    env.reset()
    before, *_ = env.step(targets(env, 0))
    _poison(env, "qpos", np.nan)
    obs, reward, terminated, _, info = env.step(targets(env, 1))
    assert terminated.tolist() == info["diverged"].tolist() == [False, True, False]
    np.testing.assert_array_equal(flat(obs)[BAD], flat(before)[BAD])
    if mode == "DISABLED":
        env.reset(options={"env_ids": [BAD]})
    for step in range(2):
        obs, _, terminated, _, info = env.step(targets(env, step))
        assert not terminated.any() and not info["diverged"].any()
        assert np.isfinite(flat(obs)).all()


def test_the_state_before_the_step_goes_to_the_run_folder(make_env, tmp_path):
    env = make_env(cls=Poisoned, env_kwargs={"run_dir": tmp_path})
    env.reset()
    env.poison = ("qpos", np.nan)
    for step in range(2):
        env.step(targets(env, step))
    action = targets(env, 2)
    env.step(action)
    files = [path.name for path in (tmp_path / "diverged").iterdir()]
    assert files == ["step_2_env_1.npz"]
    dump = np.load(tmp_path / "diverged" / files[0], allow_pickle=False)
    np.testing.assert_array_equal(dump["action"], action[BAD].double())
    layout = env.sim.engine.component("qpos")
    assert np.isnan(dump["before"][layout.start]) and len(dump["before"]) == len(dump["after"])
    target = dump["before"][env.sim.engine.component("ctrl")]
    np.testing.assert_allclose(target, action[BAD].double())


def test_only_the_first_ten_states_are_kept(make_env, tmp_path):
    class Always(BaseEnv):
        def _step_action(self, action):
            self.sim.engine.write("qpos", np.nan, None, slice(0, 1))

    env = make_env(cls=Always, num_envs=4, env_kwargs={"run_dir": tmp_path})
    env.reset()
    for _ in range(4):
        assert env.step(home(env))[4]["diverged"].all()
    assert len(list((tmp_path / "diverged").iterdir())) == 10


def test_an_observation_that_is_never_finite_is_kept_from_learners(make_env, caplog):
    nan = torch.full((3, 1), torch.nan)
    env = make_env(observations={"bad": ObservationCfg(func=lambda env, obs: nan)})
    obs, _ = env.reset()
    assert "not finite after a reset" in caplog.text and np.isfinite(flat(obs)).all()
    obs, _, terminated, _, info = env.step(home(env))
    assert terminated.all() and info["diverged"].all() and np.isfinite(flat(obs)).all()


def test_infinities_of_both_signs_are_found_without_a_warning() -> None:
    assert not all_finite(np.array([[1.0, np.inf], [-np.inf, 0.0]], np.float32))
    assert all_finite(np.full(4, 3e38, np.float32))

"""The vector environment's own work, on an environment whose every number is known."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from embodichain.learning import SB3VecEnv
from embodichain.utils.errors import ConfigError
from tests.learning.counting import CountingEnv

ZEROS = np.zeros((3, 2), np.float32)


def advance(vec_env, steps, action=ZEROS):
    for _ in range(steps):
        result = vec_env.step(action)
    return result


def test_only_the_group_is_observed_flat_and_float32():
    vec_env = SB3VecEnv(CountingEnv([0, 0, 0]))
    obs = vec_env.reset()
    assert obs.dtype == np.float32
    np.testing.assert_array_equal(obs, [[0, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert vec_env.observation_space.shape == obs.shape[1:]


def test_actions_are_scaled_to_the_bounds():
    env = CountingEnv([0, 0, 0], low=-2.0, high=6.0)
    vec_env = SB3VecEnv(env)
    vec_env.reset()
    _, rewards, _, _ = vec_env.step(np.float32([[-1, -1], [0, 0.5], [1, 1]]))
    np.testing.assert_array_equal(rewards, [-4, 6, 12])
    assert env.actions[0].dtype.is_floating_point


def test_terminal_observation_is_the_one_before_the_reset():
    vec_env = SB3VecEnv(CountingEnv([0, 3, 0]))
    vec_env.reset()
    obs, _, dones, infos = advance(vec_env, 3)
    np.testing.assert_array_equal(dones, [False, True, False])
    np.testing.assert_array_equal(infos[1]["terminal_observation"], [1, 0, 3])
    np.testing.assert_array_equal(obs, [[0, 0, 3], [1, 1, 0], [2, 0, 3]])
    assert infos[0] == infos[2] == {}


def test_nothing_returned_changes_later():
    vec_env = SB3VecEnv(CountingEnv([0, 2, 0]))
    first = vec_env.reset()
    obs, rewards, dones, infos = advance(vec_env, 2, ZEROS + 1)
    kept = [a.copy() for a in (first, obs, rewards, dones, infos[1]["terminal_observation"])]
    advance(vec_env, 5)
    for now, before in zip(
        (first, obs, rewards, dones, infos[1]["terminal_observation"]), kept, strict=True
    ):
        np.testing.assert_array_equal(now, before)


def test_what_callers_write_reaches_nobody():
    env = CountingEnv([0, 2, 0])
    vec_env = SB3VecEnv(env)
    vec_env.reset()
    actions = ZEROS + 1
    vec_env.step_async(actions)
    actions[:] = 7  # between the two halves of a step
    obs, rewards, _, infos = vec_env.step_wait()
    np.testing.assert_array_equal(rewards, 2)
    obs[:], rewards[:], infos[0]["note"] = -1, -1, "mine"
    obs, _, _, infos = vec_env.step(ZEROS + 1)
    np.testing.assert_array_equal(obs[0], [0, 0, 2])
    assert "note" not in infos[0] and "note" not in infos[2]
    assert infos[1]["episode"]["r"] == 4.0  # not the rewards that were overwritten


@pytest.mark.parametrize(
    ("end", "limit", "truncated"), [(3, 5, False), (0, 3, True), (3, 3, False)]
)
def test_time_limit_is_truncated_and_not_terminated(end, limit, truncated):
    vec_env = SB3VecEnv(CountingEnv([end], limit=limit))
    vec_env.reset()
    _, _, dones, infos = advance(vec_env, 3, np.zeros((1, 2)))
    assert dones[0]
    assert infos[0]["TimeLimit.truncated"] is truncated


def test_vectors_on_another_device_are_copied_once(monkeypatch):
    """Packed into one tensor, the results are those of copies one by one."""
    counts = []
    numpy = torch.Tensor.numpy

    def counted(self, **kwargs):
        if self.numel():
            counts.append(self.shape)
        return numpy(self, **kwargs)

    envs = [SB3VecEnv(CountingEnv([2, 0, 3], limit=4)) for _ in range(2)]
    # As on a device, whose arrays are sent to the host in one piece.
    envs[1]._packs = True
    for env in envs:
        env.reset()
    for step in range(5):
        action = np.full((3, 2), 0.1 * step, np.float32)
        wanted = envs[0].step(action)
        with monkeypatch.context() as patch:
            # Copies to the host show only in their time.
            patch.setattr(torch.Tensor, "numpy", counted)
            found = envs[1].step(action)
        for a, b in zip(found[:3], wanted[:3], strict=True):
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype
        assert [info.keys() for info in found[3]] == [info.keys() for info in wanted[3]]
        if step == 0:  # no episode ended
            assert counts == [(54,)]  # bytes: (3, 3) and (3,) float32, two flags
        found[0][:] = found[1][:] = np.nan  # is the caller's


def test_episode_counts_begin_anew():
    vec_env = SB3VecEnv(CountingEnv([2, 0, 3], limit=4))
    vec_env.reset()
    seen = [[], [], []]
    for step in range(1, 9):
        _, _, dones, infos = vec_env.step(np.full((3, 2), step / 2, np.float32))
        for i in np.flatnonzero(dones):
            seen[i].append((infos[i]["episode"]["r"], infos[i]["episode"]["l"]))
            assert infos[i]["episode"]["t"] >= 0
    assert seen[0] == [(3.0, 2), (7.0, 2), (11.0, 2), (15.0, 2)]
    assert seen[1] == [(10.0, 4), (26.0, 4)]
    assert seen[2] == [(6.0, 3), (15.0, 3)]


def test_reset_forgets_unfinished_episodes():
    vec_env = SB3VecEnv(CountingEnv([4]))
    vec_env.reset()
    advance(vec_env, 3, np.ones((1, 2)))
    vec_env.reset()
    _, _, _, infos = advance(vec_env, 4, np.ones((1, 2)))
    assert (infos[0]["episode"]["r"], infos[0]["episode"]["l"]) == (8.0, 4)


def test_success_is_told_only_by_tasks_that_have_one():
    for has_success in (True, False):
        vec_env = SB3VecEnv(CountingEnv([1, 1, 1], has_success=has_success))
        vec_env.reset()
        _, _, _, infos = vec_env.step(ZEROS)
        told = [info.get("is_success") for info in infos]
        assert told == ([True, False, True] if has_success else [None] * 3)


def test_seed_and_options_are_used_once():
    env = CountingEnv([0, 0, 0])
    vec_env = SB3VecEnv(env)
    assert vec_env.seed(7) == [7, 8, 9]
    assert env.resets == []  # seeding does not reset
    vec_env.set_options({"level": 2})
    vec_env.reset()
    vec_env.reset()
    assert env.resets == [(7, {"level": 2}), (None, None)]


def test_seed_none_draws_one_without_the_global_generator():
    vec_env = SB3VecEnv(CountingEnv([0, 0, 0]))
    np.random.seed(0)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    first, second = vec_env.seed(), vec_env.seed()
    assert first != second
    np.testing.assert_array_equal(before, np.random.get_state()[1])  # noqa: NPY002


def test_options_that_differ_are_refused():
    vec_env = SB3VecEnv(CountingEnv([0, 0]))
    vec_env.set_options([{"level": 1}, {"level": 2}])
    with pytest.raises(ValueError, match="give all environments the same options"):
        vec_env.reset()


def test_get_attr_splits_what_has_rows():
    vec_env = SB3VecEnv(CountingEnv([0, 0, 0]))
    assert vec_env.get_attr("weights") == [0.0, 1.0, 2.0]
    assert vec_env.get_attr("weights", indices=[2, 0]) == [2.0, 0.0]
    assert vec_env.get_attr("level", indices=-1) == [3]
    assert vec_env.get_attr("action_space") == [vec_env.action_space] * 3
    assert vec_env.has_attr("level") and not vec_env.has_attr("nothing")
    with pytest.raises(IndexError):
        vec_env.get_attr("weights", indices=3)


def test_set_attr_of_all_and_of_rows():
    vec_env = SB3VecEnv(CountingEnv([0, 0, 0]))
    vec_env.set_attr("level", 5)
    vec_env.set_attr("weights", 9.0, indices=[1])
    assert vec_env.get_attr("level") == [5, 5, 5]
    assert vec_env.get_attr("weights") == [0.0, 9.0, 2.0]
    with pytest.raises(ValueError, match="environments share 'level'"):
        vec_env.set_attr("level", 6, indices=0)


def test_env_method_is_called_once():
    vec_env = SB3VecEnv(CountingEnv([0, 0, 0]))
    assert vec_env.env_method("double", 2) == [4, 8, 12]
    assert vec_env.env_method("double", 2, indices=[0, 2]) == [4, 12]
    assert vec_env.env_method("touch_all") == ["touched"] * 3
    with pytest.raises(ValueError, match="'touch_all' acts on all environments"):
        vec_env.env_method("touch_all", indices=1)


def test_attributes_are_found_below_gymnasiums_wrappers():
    env = gym.wrappers.OrderEnforcing(CountingEnv([2, 0, 0]))
    vec_env = SB3VecEnv(env)
    vec_env.reset()
    _, _, dones, _ = advance(vec_env, 2)
    assert dones[0]
    vec_env.set_attr("level", 4)
    assert vec_env.get_attr("level") == [4, 4, 4]
    assert vec_env.env_is_wrapped(gym.wrappers.OrderEnforcing) == [True] * 3
    assert vec_env.env_is_wrapped(gym.wrappers.TimeLimit, indices=0) == [False]
    assert vec_env.env_is_wrapped(Monitor)[0]


@pytest.mark.parametrize("mode", ["NEXT_STEP", "DISABLED"])
def test_other_autoreset_modes_are_refused(mode):
    with pytest.raises(ValueError, match="needs autoreset_mode SAME_STEP"):
        SB3VecEnv(CountingEnv([0], mode=mode))


def test_infinite_bounds_are_refused():
    with pytest.raises(ConfigError, match="finite action bounds"):
        SB3VecEnv(CountingEnv([0], high=np.inf))


def test_step_wait_needs_actions():
    vec_env = SB3VecEnv(CountingEnv([0]))
    vec_env.reset()
    with pytest.raises(RuntimeError, match="needs the actions"):
        vec_env.step_wait()


def test_vec_normalize_transforms_terminal_observations_too():
    vec_env = VecNormalize(SB3VecEnv(CountingEnv([0, 3, 0])), norm_reward=False)
    vec_env.reset()
    _, _, _, infos = advance(vec_env, 3)
    final = vec_env.unnormalize_obs(infos[1]["terminal_observation"])
    np.testing.assert_allclose(final, [1, 0, 3], atol=1e-5)
    assert not np.allclose(infos[1]["terminal_observation"], [1, 0, 3])


def test_vec_monitor_agrees_with_our_episodes():
    ours = SB3VecEnv(CountingEnv([2, 3, 0]))
    with pytest.warns(UserWarning, match="already wrapped with a `Monitor`"):
        theirs = VecMonitor(SB3VecEnv(CountingEnv([2, 3, 0])))
    ours.reset(), theirs.reset()
    for step in range(7):
        action = np.full((3, 2), step, np.float32)
        for mine, other in zip(ours.step(action)[3], theirs.step(action)[3], strict=True):
            assert ("episode" in mine) == ("episode" in other)
            if "episode" in mine:
                assert mine["episode"]["l"] == other["episode"]["l"]
                assert mine["episode"]["r"] == pytest.approx(float(other["episode"]["r"]))

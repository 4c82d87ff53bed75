import gymnasium as gym
import imageio_ffmpeg
import numpy as np
import pytest
import torch
from gymnasium.wrappers import vector as wrappers

from embodichain.lab.gym.envs.cfg import ObservationCfg, RewardCfg, TerminationCfg
from embodichain.lab.gym.vector import NumpyVectorEnv
from tests.helpers.films import install_moviepy
from tests.lab.gym.conftest import jumping, marker, noise

LIMIT = 5
FIRST = 2
"""Steps of the first episode of environment 0."""


def _first_fails(env, obs, action, info):
    return (torch.arange(3) == 0) & (env.elapsed_steps == 2) & (env.episode_ids == 0)


@pytest.fixture
def make_vec(make_env):
    """A vector environment in which environment 0 fails at its second step."""

    def build(mode="SAME_STEP", flatten=False, **kwargs):
        sections = {
            **jumping(),
            "max_episode_steps": LIMIT,
            "rewards": {"one": RewardCfg(func=lambda env, o, a, i: torch.ones(3))},
            "terminations": {"first": TerminationCfg(func=_first_fails)},
        }
        return NumpyVectorEnv(make_env(**{**sections, **kwargs}), mode, flatten)

    return build


def _actions(env):
    space = env.action_space
    return 0.05 * (space.low + space.high) + np.float32(1.0)


def _check_contains(env, obs):
    assert env.observation_space.contains(obs), "observation outside its space"


def test_numpy_observations_and_flags(make_vec):
    env = make_vec()
    obs, info = env.reset(seed=1)
    _check_contains(env, obs)
    assert (
        isinstance(obs["robot"]["qpos"], np.ndarray) and info["elapsed_steps"].tolist() == [0] * 3
    )
    assert env.single_observation_space["robot"]["qpos"].shape == (6,)
    obs, reward, terminated, truncated, info = env.step(_actions(env))
    _check_contains(env, obs)
    assert all(isinstance(x, np.ndarray) for x in (reward, terminated, truncated))
    assert terminated.dtype == truncated.dtype == np.bool_ and env.np_random_seed == 1
    with pytest.raises(ValueError, match="one integer"):
        env.reset(seed=[1, 2, 3])


def test_a_flat_observation_is_the_declared_terms_in_order(make_vec):
    env, nested = make_vec(flatten=True), make_vec()
    assert env.single_observation_space.shape == (5,)
    flat, _ = env.reset(seed=2)
    obs, _ = nested.reset(seed=2)
    np.testing.assert_array_equal(flat, np.concatenate([obs["cube"], obs["noise"]], axis=1))
    everything = make_vec(flatten=True, observations={}, terminations={})
    assert everything.reset(seed=2)[0].shape == (3, 18)


def test_only_the_group_policy_is_in_the_vector(make_vec):
    observations = {
        "noise": ObservationCfg(func=noise, name="a/noise"),
        "cube": ObservationCfg(func=marker, group="critic"),
    }
    env = make_vec(flatten=True, observations=observations, terminations={})
    assert env.reset()[0].shape == (3, 2)


@pytest.mark.parametrize("flatten", [False, True])
def test_final_observations_follow_gymnasiums_convention(make_vec, flatten):
    env, twin = make_vec("SAME_STEP", flatten), make_vec("DISABLED", flatten)
    env.reset(seed=3), twin.reset(seed=3)
    for _ in range(2):
        obs, _, terminated, _, info = env.step(_actions(env))
        expected, *_ = twin.step(_actions(twin))
    assert terminated.tolist() == info["_final_obs"].tolist() == [True, False, False]
    final = info["final_obs"]
    assert final.dtype == object and final.shape == (3,) and final[1] is None
    got, want = (final[0], expected[0]) if flatten else (final[0]["cube"], expected["cube"][0])
    np.testing.assert_array_equal(got, want)
    assert info["final_info"]["elapsed_steps"][0] == 2 and "final_observation" not in info
    assert isinstance(info["final_info"]["rewards"]["one"], np.ndarray)


def _episodes(env, steps=12):
    """Lengths of the episodes that RecordEpisodeStatistics saw, per environment."""
    env = wrappers.RecordEpisodeStatistics(env)
    env.reset(seed=4)
    found = [[], [], []]
    for _ in range(steps):
        info = env.step(_actions(env))[4]
        for i in np.flatnonzero(info.get("_episode", np.zeros(3, bool))):
            assert info["episode"]["r"][i] == pytest.approx(info["episode"]["l"][i])
            found[i].append(int(info["episode"]["l"][i]))
    return found


def test_record_episode_statistics(make_vec):
    assert _episodes(make_vec("SAME_STEP")) == [[2, 5, 5], [5, 5], [5, 5]]
    assert _episodes(make_vec("NEXT_STEP")) == [[2, 5], [5, 5], [5, 5]]


def test_reward_wrappers(make_vec):
    env = wrappers.TransformReward(make_vec(), lambda reward: 2 * reward)
    env.reset()
    assert env.step(_actions(env))[1].tolist() == [2.0, 2.0, 2.0]
    env = wrappers.NormalizeReward(make_vec())
    env.reset()
    for _ in range(8):
        reward = env.step(_actions(env))[1]
    assert np.isfinite(reward).all() and (reward != 1).all()


def test_dict_info_to_list(make_vec):
    env = wrappers.DictInfoToList(wrappers.RecordEpisodeStatistics(make_vec()))
    _, infos = env.reset()
    assert len(infos) == 3 and infos[0]["elapsed_steps"] == 0
    env.step(_actions(env))
    infos = env.step(_actions(env))[4]
    assert infos[0]["final_info"]["elapsed_steps"] == 2 and "final_info" not in infos[1]
    assert infos[0]["episode"]["l"] == 2 and "episode" not in infos[1]
    assert infos[2]["rewards"]["one"] == 1.0


def test_normalize_observation_with_next_step(make_vec):
    env = wrappers.NormalizeObservation(make_vec("NEXT_STEP", flatten=True))
    env.reset()
    for _ in range(8):
        obs, *_ = env.step(_actions(env))
    assert obs.shape == (3, 5) and np.isfinite(obs).all()


@pytest.mark.parametrize("mode", ["NEXT_STEP", "DISABLED"])
def test_flatten_observation(make_vec, mode):
    env = wrappers.FlattenObservation(make_vec(mode))
    obs, _ = env.reset(seed=1)
    assert obs.shape == (3, 23) and env.observation_space.shape == (3, 23)
    for _ in range(4):
        obs, _, terminated, truncated, _ = env.step(_actions(env))
        done = terminated | truncated
        if mode == "DISABLED" and done.any():
            obs, _ = env.reset(options={"reset_mask": done})
    assert obs.shape == (3, 23)


def test_a_reset_mask_resets_those_and_must_be_one(make_vec):
    env = make_vec("DISABLED")
    env.reset()
    env.step(_actions(env))
    mask = np.array([False, True, False])
    options = {"reset_mask": mask}
    _, info = env.reset(options=options)
    assert info["elapsed_steps"].tolist() == [1, 0, 1] and "reset_mask" in options
    for wrong in ([True, False, False], np.zeros(3, bool), np.array([0, 1, 0])):
        with pytest.raises(ValueError, match="reset_mask"):
            env.reset(options={"reset_mask": wrong})


def test_record_video_with_next_step(make_vec, tmp_path, monkeypatch):
    install_moviepy(monkeypatch)
    env = make_vec("NEXT_STEP", flatten=True, env_kwargs={"render_mode": "rgb_array"})
    assert env.metadata["render_fps"] == env.env.control_frequency
    env = wrappers.RecordVideo(env, str(tmp_path), episode_trigger=lambda episode: episode == 0)
    env.reset(seed=1)
    for _ in range(LIMIT + 2):
        env.step(_actions(env))
    env.close()
    (film,) = tmp_path.glob("*.mp4")
    frames = imageio_ffmpeg.read_frames(str(film))
    meta = next(frames)
    assert meta["size"] == (3 * 640, 480)  # the environments side by side
    assert meta["fps"] == pytest.approx(env.metadata["render_fps"])
    assert sum(1 for _ in frames) == 1 + FIRST  # of the reset, and of each step of environment 0


def test_the_default_is_next_step_and_what_a_policy_sees(make_env):
    env = NumpyVectorEnv(make_env(**jumping()))
    assert env.metadata["autoreset_mode"] is gym.vector.AutoresetMode.NEXT_STEP
    assert env.observation_space.shape == (3, 5)


def test_closing_closes_the_environment(make_vec):
    env = make_vec()
    env.close()
    assert env.closed
    with pytest.raises(RuntimeError):
        _ = env.env.sim.engine
    assert isinstance(env, gym.vector.VectorEnv)
    with pytest.warns(UserWarning, match='render_mode="rgb_array"'):
        assert env.render() is None

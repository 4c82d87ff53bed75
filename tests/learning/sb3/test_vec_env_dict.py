"""SB3VecEnv with observations by name, pictures among them; VecTransposeImage, VecVideoRecorder."""

import gymnasium as gym
import imageio_ffmpeg
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import (
    VecFrameStack,
    VecNormalize,
    VecTransposeImage,
    VecVideoRecorder,
)

from embodichain.learning import SB3VecEnv
from tests.helpers.films import install_moviepy
from tests.learning.counting import CountingEnv


class SeeingEnv(CountingEnv):
    """Observes a picture too, all of whose pixels are the step."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        picture = gym.spaces.Box(0, 255, (40, 36, 3), np.uint8)
        self.single_observation_space = gym.spaces.Dict(
            {**self.single_observation_space.spaces, "camera": picture}
        )

    @staticmethod
    def _group_terms(group):
        return ("where/id", "time", "camera")

    def _obs(self):
        obs = super()._obs()
        steps = torch.from_numpy(self.count.astype(np.uint8))
        obs["camera"] = steps[:, None, None, None].expand(-1, 40, 36, 3)
        return obs


def test_entries_have_their_own_shapes_and_types():
    env = SB3VecEnv(CountingEnv([0, 2]), flatten=False)
    assert list(env.observation_space) == ["time", "where/id"]  # Gymnasium sorts names
    first = env.reset()
    assert {name: part.shape for name, part in first.items()} == {
        "where/id": (2, 1),
        "time": (2, 2),
    }
    env.step(np.zeros((2, 2), np.float32))
    obs, _, dones, infos = env.step(np.zeros((2, 2), np.float32))
    np.testing.assert_array_equal(dones, [False, True])
    np.testing.assert_array_equal(obs["time"], [[0, 2], [1, 0]])
    np.testing.assert_array_equal(infos[1]["terminal_observation"]["time"], [0, 2])
    np.testing.assert_array_equal(first["time"], 0.0)  # what was returned stays as it was
    assert env.observation_space.contains({name: part[0] for name, part in obs.items()})


def test_the_same_numbers_as_flat(make_reach):
    flat, named = SB3VecEnv(make_reach(3)), SB3VecEnv(make_reach(3), flatten=False)
    names = list(named.base.observation_manager.group_terms("policy"))
    rows = [flat.reset()], [named.reset()]
    actions = np.random.default_rng(0).uniform(-1, 1, (8, 3, 6)).astype(np.float32)
    for action in actions:
        for vec_env, kept in zip((flat, named), rows, strict=True):
            obs, _, _, infos = vec_env.step(action)
            kept += [obs, *(info["terminal_observation"] for info in infos if info)]
    assert len(rows[0]) == len(rows[1]) > 9
    for one, parts in zip(*rows, strict=True):
        np.testing.assert_array_equal(one, np.concatenate([parts[n] for n in names], axis=-1))


def test_pictures_are_learned_from_under_the_wrappers():
    inner = VecNormalize(SB3VecEnv(SeeingEnv([0, 3]), flatten=False), norm_obs_keys=["time"])
    env = VecTransposeImage(VecFrameStack(inner, 2, channels_order={"camera": "last", **REST}))
    obs = env.reset()
    assert obs["camera"].shape == (2, 6, 40, 36) and obs["camera"].dtype == np.uint8
    obs, *_ = env.step(np.zeros((2, 2), np.float32))
    np.testing.assert_array_equal(obs["camera"][0, :, 0, 0], [0, 0, 0, 1, 1, 1])
    model = PPO("MultiInputPolicy", env, n_steps=4, batch_size=8, n_epochs=1, device="cpu")
    model.learn(16)
    assert sorted({info["l"] for info in model.ep_info_buffer}) == [3]


REST = {"time": None, "where/id": None}


def test_videos_of_all_environments(make_reach, tmp_path, monkeypatch):
    """Stable-Baselines3 needs moviepy for the file only."""
    install_moviepy(monkeypatch)
    vec_env = SB3VecEnv(make_reach(2, render_mode="rgb_array"))
    env = VecVideoRecorder(vec_env, str(tmp_path), lambda step: step == 0, video_length=2)
    env.reset()
    for _ in range(3):
        env.step(np.zeros((2, 6), np.float32))
    (path,) = tmp_path.glob("*.mp4")
    film = imageio_ffmpeg.read_frames(str(path))
    meta = next(film)
    assert meta["fps"] == pytest.approx(vec_env.base.metadata["render_fps"])
    sizes = [len(frame) for frame in film]
    assert sizes == 3 * [2 * vec_env.get_images()[0].size]

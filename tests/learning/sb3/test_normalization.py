"""Statistics come back to the bit and normalize as VecNormalize does; broken files are told."""

import dataclasses

import numpy as np
import pytest
from stable_baselines3.common.vec_env import VecNormalize

from embodichain.learning import SB3VecEnv
from embodichain.learning.checkpoints.plain_state import write_tree
from embodichain.learning.sb3.normalization import (
    NormalizeStatistics,
    load_statistics,
    save_statistics,
    statistics_path,
)
from embodichain.utils.errors import ConfigError
from tests.learning.counting import CountingEnv


def stepped(steps=7, **options):
    env = VecNormalize(SB3VecEnv(CountingEnv([0, 3, 4])), gamma=0.9, clip_obs=1.5, **options)
    env.reset()
    rng = np.random.default_rng(0)
    for _ in range(steps):
        env.step(rng.uniform(-1, 1, (3, 2)).astype(np.float32))
    return env


@pytest.mark.parametrize(
    "options", [{}, {"norm_obs": False}, {"norm_reward": False}, {"epsilon": 1e-3}]
)
def test_what_comes_back_normalizes_as_in_training(tmp_path, options):
    env = stepped(**options)
    path = statistics_path(tmp_path / "final.zip")
    assert path == tmp_path / "final.normalize.npz"
    save_statistics(path, env)
    found = load_statistics(path)
    raw = env.get_original_obs()
    np.testing.assert_array_equal(found.normalize(raw), env.normalize_obs(raw))
    assert found.normalize(raw).dtype == np.float32
    for field in dataclasses.fields(found):
        expected = getattr(NormalizeStatistics.of(env), field.name)
        np.testing.assert_array_equal(getattr(found, field.name), expected)
    assert [p.name for p in tmp_path.glob("*.npz*")] == [path.name]


def test_counting_goes_on_to_the_bit(tmp_path):
    env, other = stepped(), stepped(steps=2)
    save_statistics(tmp_path / "a.npz", env)
    load_statistics(tmp_path / "a.npz").restore(other)
    obs = np.float32([[1, 2, 3]] * 3)
    for each in (env, other):
        each.obs_rms.update(obs)
        # What Stable-Baselines3 does in `step_wait`, without an environment.
        each._update_reward(np.float32([1, 2, 3]))
    kept = [NormalizeStatistics.of(each) for each in (env, other)]
    np.testing.assert_equal(dataclasses.asdict(kept[0]), dataclasses.asdict(kept[1]))


def test_broken_files_are_one_clear_error(tmp_path):
    path = tmp_path / "final.normalize.npz"
    with pytest.raises(ConfigError, match="is missing: this policy needs the statistics"):
        load_statistics(path)
    path.write_bytes(b"no")
    with pytest.raises(ConfigError, match="has no normalization statistics"):
        load_statistics(path)
    np.savez(path, obs_mean=np.zeros(3))
    with pytest.raises(ConfigError, match="has no normalization statistics"):
        load_statistics(path)
    write_tree(path, {"obs_mean": np.zeros(3)})
    with pytest.raises(ConfigError, match="has no normalization statistics: .*'obs_var'"):
        load_statistics(path)
    save_statistics(path, stepped())
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(ConfigError, match="has no normalization statistics"):
        load_statistics(path)

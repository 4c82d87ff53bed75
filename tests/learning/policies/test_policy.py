"""Checkpoints and what acts from them; the model is trained on an environment that counts."""

import json
import random
import sys
import zipfile

import numpy as np
import pytest
import stable_baselines3
import torch
from stable_baselines3.common.vec_env import VecNormalize

from embodichain.learning import SB3VecEnv, find_checkpoint, load_policy
from embodichain.learning.checkpoints.checkpoint import read_note, save_checkpoint
from embodichain.learning.sb3.algorithms import Algorithm
from embodichain.learning.sb3.normalization import save_statistics, statistics_path
from embodichain.utils.errors import ConfigError
from tests.learning.counting import CountingEnv

NOTE = {"algo": "ppo", "group": "policy", "task": "counting"}


def make_model(seed=0, **env_options):
    kwargs = {"log_std_init": 0.0}
    arguments = {"policy": "MlpPolicy", "n_steps": 4, "batch_size": 8, "policy_kwargs": kwargs}
    vec_env = SB3VecEnv(CountingEnv([0, 3], **env_options))
    return Algorithm("ppo", arguments).build(vec_env, seed)


@pytest.fixture
def model():
    return make_model().learn(16)


@pytest.fixture
def run_dir(model, tmp_path):
    save_checkpoint(model, tmp_path / "run/checkpoints/final.zip", NOTE)
    return tmp_path / "run"


def test_policy_acts_as_the_model_does(model, run_dir):
    env = CountingEnv([0, 3], low=-3.0, high=1.0)
    obs, _ = env.reset()
    actions = load_policy(run_dir, env)(obs, env)
    means, _ = model.predict(np.float32([[0, 0, 0], [1, 0, 0]]), deterministic=True)
    assert actions.dtype == torch.float32
    np.testing.assert_allclose(actions.numpy(), 2 * means - 1, atol=1e-6)


def test_policy_is_deterministic_unless_asked(run_dir):
    env = CountingEnv([0, 3])
    obs, _ = env.reset()
    certain, drawn = load_policy(run_dir), load_policy(run_dir, deterministic=False)
    assert torch.equal(certain(obs, env), certain(obs, env))
    assert not torch.equal(drawn(obs, env), drawn(obs, env))


def test_loading_draws_and_seeds_nothing(run_dir):
    def states():
        return random.random(), np.random.random(), torch.rand(1).item()  # noqa: NPY002

    generators = (random.getstate(), np.random.get_state(), torch.get_rng_state())  # noqa: NPY002
    expected = states()
    random.setstate(generators[0])
    np.random.set_state(generators[1])  # noqa: NPY002
    torch.set_rng_state(generators[2])
    load_policy(run_dir)
    assert states() == expected


def test_a_zip_of_stable_baselines_itself_is_played(model, tmp_path):
    model.save(tmp_path / "mine.zip")
    env = CountingEnv([0])
    assert load_policy(tmp_path / "mine.zip", env)(env.reset()[0], env).shape == (1, 2)


@pytest.mark.parametrize("name", ["best", "checkpoints/best", "checkpoints/best.zip"])
def test_checkpoints_are_found_by_name(run_dir, name):
    best = run_dir / "checkpoints/best.zip"
    (run_dir / "checkpoints/final.zip").rename(best)
    assert find_checkpoint(run_dir / name) == best


def test_note_is_plain_json(run_dir):
    path = find_checkpoint(run_dir)
    with zipfile.ZipFile(path) as archive:
        assert json.loads(archive.read("data"))["embodichain"] == NOTE
    assert read_note(path) == NOTE


def test_failed_save_leaves_the_old_file(model, run_dir, monkeypatch):
    path = run_dir / "checkpoints/final.zip"
    before = path.read_bytes()

    def fail(stream):
        stream.write(b"half")
        raise OSError(28, "No space left on device")

    # A disk that is full, which a test cannot make.
    monkeypatch.setattr(model, "save", fail)
    with pytest.raises(OSError, match="No space left"):
        save_checkpoint(model, path, NOTE)
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == ["final.zip"]


def other_file(tmp_path, what):
    path = tmp_path / "policy.zip"
    if what == "missing":
        return path
    if what == "text":
        path.write_text("not a zip")
        return path
    if what == "folder":
        path.mkdir()
        return path
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data" if what != "foreign zip" else "readme", "{}")
        archive.writestr("policy.pth", b"")
    return path


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("missing", "no such file or folder"),
        ("text", "is not a policy of Stable-Baselines3: File is not a zip file"),
        ("folder", "has no checkpoints/final.zip"),
        ("foreign zip", "it has no data"),
        ("no algorithm", "does not say which algorithm made it"),
    ],
)
def test_what_is_no_policy(tmp_path, what, message):
    path = other_file(tmp_path, what)
    with pytest.raises(ConfigError, match=message) as caught:
        load_policy(path)
    assert str(path) in str(caught.value)
    assert caught.value.problems[0].path == "policy"


def test_truncated_and_damaged_files(run_dir):
    path = find_checkpoint(run_dir)
    whole = path.read_bytes()
    for size in (0, 100, len(whole) // 2, len(whole) - 10):
        path.write_bytes(whole[:size])
        with pytest.raises(ConfigError):
            load_policy(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", json.dumps({"embodichain": NOTE}))
        archive.writestr("policy.pth", b"\x80")
    with pytest.raises(ConfigError, match=r"cannot be loaded"):
        load_policy(path)


def test_policy_of_another_task_names_both_shapes(run_dir):
    env = CountingEnv([0])
    flat_rows = env.observation_manager.flat_rows
    env.observation_manager.group_terms = lambda group: ("time",)
    env.observation_manager.flat_rows = lambda obs, group: flat_rows(obs, group)[:, 1:]
    with pytest.raises(ConfigError, match=r"has observations \(3,\), this task has \(2,\)"):
        load_policy(run_dir, env)
    late = load_policy(run_dir)
    with pytest.raises(ConfigError, match=r"has observations \(3,\), this task has \(2,\)"):
        late(env.reset()[0], env)


ANY = {
    "trpo": {"n_steps": 4, "batch_size": 8},
    "tqc": {"buffer_size": 100, "learning_starts": 4},
    "crossq": {"buffer_size": 100, "learning_starts": 4},
    "recurrent_ppo": {"n_steps": 4, "batch_size": 8},
    "a2c": {"n_steps": 4},
    "sac": {"buffer_size": 100, "learning_starts": 4},
    "td3": {"buffer_size": 100, "learning_starts": 4},
    "ddpg": {"buffer_size": 100, "learning_starts": 4},
}


@pytest.mark.parametrize("algo", ANY)
def test_zips_of_other_algorithms_are_played(tmp_path, algo, caplog):
    made = getattr(stable_baselines3, algo.upper(), None)
    if made is None:
        named = {"crossq": "CrossQ", "recurrent_ppo": "RecurrentPPO"}
        made = getattr(pytest.importorskip("sb3_contrib"), named.get(algo, algo.upper()))
    vec_env = SB3VecEnv(CountingEnv([0, 3]))
    policy = "MlpLstmPolicy" if algo == "recurrent_ppo" else "MlpPolicy"
    model = made(policy, vec_env, device="cpu", **ANY[algo]).learn(8)
    model.save(tmp_path / "mine.zip")
    env = CountingEnv([0, 3])
    obs, _ = env.reset()
    played = load_policy(tmp_path / "mine.zip", env)(obs, env)
    means, _ = model.predict(np.float32([[0, 0, 0], [1, 0, 0]]), deterministic=True)
    np.testing.assert_allclose(played.numpy(), means, atol=1e-6)
    assert "would run" not in caplog.text


@pytest.fixture
def normalized(tmp_path):
    """A run folder whose training normalized observations, and what it was trained with."""
    vec_env = VecNormalize(SB3VecEnv(CountingEnv([0, 3])), clip_obs=1.5)
    arguments = {"policy": "MlpPolicy", "n_steps": 4, "batch_size": 8}
    model = Algorithm("ppo", arguments).build(vec_env, 0).learn(16)
    path = tmp_path / "run/checkpoints/final.zip"
    save_checkpoint(model, path, NOTE)
    save_statistics(statistics_path(path), vec_env)
    (tmp_path / "run/config.yaml").write_text("algo: {name: ppo, normalize: obs}\n")
    return path, model, vec_env


def test_observations_are_normalized_as_in_training(normalized, caplog):
    path, model, vec_env = normalized
    env = CountingEnv([0, 3])
    obs, _ = env.reset()
    seen = vec_env.normalize_obs(np.float32([[0, 0, 0], [1, 0, 0]]))
    means, _ = model.predict(seen, deterministic=True)
    np.testing.assert_allclose(load_policy(path, env)(obs, env).numpy(), means, atol=1e-6)
    assert "trust" not in caplog.text


def test_missing_statistics_are_one_error(normalized):
    path, _, _ = normalized
    statistics_path(path).unlink()
    with pytest.raises(ConfigError, match=r"final\.normalize\.npz is missing") as caught:
        load_policy(path.parent.parent)
    assert len(caught.value.problems) == 1
    (path.parent.parent / "config.yaml").write_text("algo: {name: ppo, normalize: reward}\n")
    load_policy(path)  # rewards are of no use when playing


def test_statistics_of_another_task(normalized):
    path, _, _ = normalized
    other = VecNormalize(SB3VecEnv(CountingEnv([0])))
    other.obs_rms.mean, other.obs_rms.var = np.zeros(2), np.ones(2)
    save_statistics(statistics_path(path), other)
    with pytest.raises(ConfigError, match=r"observations \(3,\), its statistics are for \(2,\)"):
        load_policy(path)


def test_models_of_other_environments_are_refused(tmp_path):
    model = stable_baselines3.PPO("MlpPolicy", "Pendulum-v1", n_steps=4, batch_size=4, device="cpu")
    model.save(tmp_path / "pendulum.zip")
    with pytest.raises(ConfigError, match=r"acts in Box\(-2.0, 2.0.*not in \[-1, 1\]") as caught:
        load_policy(tmp_path / "pendulum.zip")
    assert len(caught.value.problems) == 1


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    contrib = pytest.importorskip("sb3_contrib")
    vec_env = SB3VecEnv(CountingEnv([0, 3]))
    contrib.RecurrentPPO("MlpLstmPolicy", vec_env, device="cpu").save(tmp_path / "mine.zip")
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)
    with pytest.raises(ConfigError, match="pip install sb3-contrib"):
        load_policy(tmp_path / "mine.zip")


def test_loading_takes_no_memory_for_a_replay_buffer(tmp_path):
    vec_env = SB3VecEnv(CountingEnv([0, 3]))
    model = stable_baselines3.SAC("MlpPolicy", vec_env, buffer_size=50, device="cpu")
    model.buffer_size = 10**12
    model.save(tmp_path / "sac.zip")
    assert load_policy(tmp_path / "sac.zip").model.replay_buffer.buffer_size == 1

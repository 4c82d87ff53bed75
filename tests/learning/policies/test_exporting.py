"""Exported policies: as the model, with everything baked in, and without Stable-Baselines3."""

import json
import subprocess
import sys

import numpy as np
import pytest
import stable_baselines3
import torch
from stable_baselines3.common.vec_env import VecNormalize

from embodichain.learning import LearnedPolicy, SB3VecEnv, load_policy
from embodichain.learning.checkpoints.checkpoint import save_checkpoint
from embodichain.learning.policies.exported import METADATA, load_exported
from embodichain.learning.policies.exporting import FORMATS, export_policy
from embodichain.learning.sb3.normalization import save_statistics, statistics_path
from embodichain.utils.errors import ConfigError
from tests.learning.counting import CountingEnv

pytestmark = pytest.mark.slow

OBS = np.random.default_rng(4).normal(size=(9, 3)).astype(np.float32) * 8
ALGORITHMS = {
    "ppo": {"n_steps": 4, "batch_size": 8, "policy_kwargs": {"log_std_init": 0.5}},
    "a2c": {"n_steps": 4, "use_sde": True},
    "sac": {"buffer_size": 100, "learning_starts": 4},
    "td3": {"buffer_size": 100, "learning_starts": 4},
    "ddpg": {"buffer_size": 100, "learning_starts": 4},
}


def make_env():
    return CountingEnv([0, 3], low=np.float32([-3.0, 0.5]), high=np.float32([1.0, 20.0]))


@pytest.fixture
def saved(tmp_path):
    """Writes a short training's checkpoint, normalized, and returns its path and its model."""

    def save(algo="ppo", normalized=True):
        vec_env = SB3VecEnv(make_env())
        if normalized:
            vec_env = VecNormalize(vec_env, clip_obs=2.0)
        made = getattr(stable_baselines3, algo.upper())
        model = made("MlpPolicy", vec_env, seed=1, device="cpu", **ALGORITHMS[algo]).learn(32)
        path = tmp_path / "run/checkpoints/final.zip"
        note = {"algo": algo, "group": "policy", "task": "counting"}
        save_checkpoint(model, path, note)
        if normalized:
            save_statistics(statistics_path(path), vec_env)
        return path, model, vec_env

    return save


def by_hand(model, vec_env, obs):
    """What Stable-Baselines3 does, and the task's bounds."""
    means, _ = model.predict(vec_env.normalize_obs(obs), deterministic=True)
    low, high = np.float32([-3.0, 0.5]), np.float32([1.0, 20.0])
    return low + (means + 1) * (high - low) / 2


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("algo", ["ppo", "a2c", "sac", "td3", "ddpg"])
def test_file_acts_as_the_model(saved, tmp_path, algo, form):
    path, model, vec_env = saved(algo)
    out = tmp_path / f"policy{FORMATS[form]}"
    worst = export_policy(load_policy(path), make_env(), out, form)
    assert worst <= 1e-4
    expected = by_hand(model, vec_env, OBS)
    np.testing.assert_allclose(load_exported(out).act(OBS), expected, atol=1e-4)
    assert [p.name for p in out.parent.iterdir() if p.is_file()] == [out.name]


@pytest.mark.parametrize("form", FORMATS)
def test_file_plays_in_the_task(saved, tmp_path, form):
    path, _, _ = saved()
    out = tmp_path / f"p{FORMATS[form]}"
    env = make_env()
    policy = load_policy(path, env)
    export_policy(policy, env, out, form)
    obs, _ = env.reset()
    played = load_policy(out, env)
    np.testing.assert_allclose(played(obs, env), policy(obs, env), atol=1e-4)
    assert played(obs, env).dtype == torch.float32
    assert played.metadata.columns == ("where/id[0]", "time[0]", "time[1]")
    assert played.metadata.task == "counting"
    assert played.metadata.action_high == (1.0, 20.0)


WITHOUT = {
    "onnx": """
import sys, json, numpy as np, onnxruntime
session = onnxruntime.InferenceSession(sys.argv[1])
action = session.run(["action"], {"observation": np.float32(json.loads(sys.argv[2]))})[0]
meta = session.get_modelmeta().custom_metadata_map["embodichain.json"]
assert "torch" not in sys.modules
""",
    "torchscript": """
import sys, json, torch
extra = {"embodichain.json": ""}
module = torch.jit.load(sys.argv[1], _extra_files=extra)
action, meta = module(torch.tensor(json.loads(sys.argv[2]))), extra["embodichain.json"]
""",
}
TELL = """
assert not {"embodichain", "stable_baselines3"} & set(sys.modules)
print(json.dumps([action.tolist(), json.loads(meta)["task"]]))
"""


@pytest.mark.unmeasured
@pytest.mark.parametrize("form", FORMATS)
def test_file_is_used_without_us(saved, tmp_path, form):
    path, model, vec_env = saved()
    out = tmp_path / f"p{FORMATS[form]}"
    export_policy(load_policy(path), make_env(), out, form, task="mine")
    code = WITHOUT[form] + TELL
    done = subprocess.run(
        [sys.executable, "-c", code, str(out), json.dumps(OBS.tolist())],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    actions, task = json.loads(done.stdout)
    np.testing.assert_allclose(actions, by_hand(model, vec_env, OBS), atol=1e-4)
    assert task == "mine"


def test_nothing_is_replaced(saved, tmp_path):
    path, _, _ = saved(normalized=False)
    out = tmp_path / "mine.pt"
    out.write_text("mine")
    with pytest.raises(ConfigError, match=r"mine\.pt exists; it is never replaced"):
        export_policy(load_policy(path), make_env(), out, "torchscript")
    assert out.read_text() == "mine"


def test_a_file_that_acts_otherwise_is_not_kept(saved, tmp_path, monkeypatch):
    path, _, _ = saved(normalized=False)
    policy = load_policy(path)
    predict = policy.predict
    # A right exporter writes no such file.
    monkeypatch.setattr(policy, "predict", lambda flat: predict(flat) + np.float32(1e-3))
    with pytest.raises(RuntimeError, match="differs from the model by"):
        export_policy(policy, make_env(), tmp_path / "p.pt", "torchscript")
    assert [p for p in tmp_path.iterdir() if p.is_file()] == []


def test_drawn_actions_are_not_exported(saved, tmp_path):
    path, _, _ = saved(normalized=False)
    with pytest.raises(ConfigError, match="only deterministic"):
        export_policy(load_policy(path, deterministic=False), make_env(), tmp_path / "p.pt", "onnx")


@pytest.mark.parametrize("package", ["onnx", "onnxruntime"])
def test_missing_packages_are_named(saved, tmp_path, monkeypatch, package):
    path, _, _ = saved(normalized=False)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ConfigError, match=rf"{package}: pip install 'embodichain\[export\]'"):
        export_policy(load_policy(path), make_env(), tmp_path / "p.onnx", "onnx")


@pytest.mark.parametrize("suffix", [".onnx", ".pt", ".ts"])
def test_files_that_are_no_policies(tmp_path, suffix):
    path = tmp_path / f"policy{suffix}"
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(ConfigError, match="is not a policy: it is not") as caught:
        load_policy(path)
    assert str(path) in str(caught.value)
    assert len(caught.value.problems) == 1


def test_other_observations_of_the_same_width(saved, tmp_path):
    path, _, _ = saved()
    out = tmp_path / "p.pt"
    export_policy(load_policy(path), make_env(), out, "torchscript")
    env = make_env()
    env.observation_manager.group_terms = lambda group: ("other", "where/id")
    with pytest.raises(ConfigError, match=r"column 0 of 3 was where/id\[0\], this task has other"):
        load_policy(out, env)


def test_files_of_others_are_tried(tmp_path):
    class Double(torch.nn.Module):
        def forward(self, obs):
            return 2 * obs[:, 1:]

    class Wide(torch.nn.Module):
        def forward(self, obs):
            return obs @ torch.ones(4, 2)

    for name, module in (("double", Double()), ("wide", Wide()), ("narrow", torch.nn.Identity())):
        torch.jit.save(torch.jit.script(module), tmp_path / f"{name}.pt")
    env = make_env()
    obs, _ = env.reset()
    action = load_policy(tmp_path / "double.pt", env)(obs, env)
    assert action.tolist() == [[0.0, 0.0], [0.0, 0.0]]
    with pytest.raises(ConfigError, match=r"does not take this task's observations \(2, 3\)"):
        load_policy(tmp_path / "wide.pt", env)
    with pytest.raises(ConfigError, match=r"gives actions \(2, 3\), this task needs \(2, 2\)"):
        load_policy(tmp_path / "narrow.pt", env)
    with pytest.raises(ConfigError, match="mean actions only"):
        load_policy(tmp_path / "double.pt", env, deterministic=False)


def test_damaged_metadata(tmp_path):
    module = torch.jit.script(torch.nn.Identity())
    torch.jit.save(module, tmp_path / "p.pt", _extra_files={METADATA: '{"task": 1}'})
    with pytest.raises(ConfigError, match="its metadata are damaged"):
        load_policy(tmp_path / "p.pt")


def test_recurrent_policies_remember_and_are_not_exported(tmp_path):
    contrib = pytest.importorskip("sb3_contrib")
    vec_env = SB3VecEnv(make_env())
    model = contrib.RecurrentPPO("MlpLstmPolicy", vec_env, n_steps=4, seed=1, device="cpu")
    env = make_env()
    obs, _ = env.reset()
    policy = LearnedPolicy(model, "policy")
    flat = np.float32([[0, 0, 0], [1, 0, 0]])
    first, second = policy(obs, env), policy(obs, env)
    _, state = model.predict(flat, episode_start=np.ones(2, bool), deterministic=True)
    means, _ = model.predict(flat, state, episode_start=np.zeros(2, bool), deterministic=True)
    low, high = np.float32([-3.0, 0.5]), np.float32([1.0, 20.0])
    np.testing.assert_allclose(second, low + (means + 1) * (high - low) / 2, atol=1e-5)
    policy.reset(np.array([1]))
    third = policy(obs, env)
    assert torch.equal(third[1], first[1])  # forgot
    assert not torch.equal(third[0], first[0])
    with pytest.raises(ConfigError, match="is recurrent"):
        export_policy(policy, env, tmp_path / "p.pt", "torchscript")

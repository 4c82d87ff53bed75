"""Each reader of other people's files, with a payload in it: nothing is run unless it is trusted.

The rows of the table "What is read, and how" in SECURITY.md.
"""

import io
import json
import os
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from stable_baselines3.common.policies import ActorCriticPolicy

from embodichain.learning import SB3VecEnv, load_policy
from embodichain.learning.checkpoints.checkpoint import save_checkpoint, save_script
from embodichain.learning.checkpoints.curriculum_stage import stage_path
from embodichain.learning.checkpoints.inert_pickle import read_inert
from embodichain.learning.checkpoints.plain_state import read_tree
from embodichain.learning.checkpoints.trust import NeedsTrust
from embodichain.learning.policies.exported import load_exported
from embodichain.learning.policies.policy import load_model
from embodichain.learning.sb3.algorithms import Algorithm, algorithm_class
from embodichain.learning.sb3.normalization import load_statistics, statistics_path
from embodichain.learning.sb3.training_state import load_parameters
from embodichain.utils.errors import ConfigError
from tests.helpers.planted import NAME, Payload, pickled, plant, replace, was_run
from tests.helpers.planted_networks import Writes, WritesAtLoading, WritesInABranch, onnx_beside
from tests.learning.counting import CountingEnv

pytestmark = pytest.mark.slow

NOTE = {"algo": "ppo", "group": "policy", "task": "counting"}
UNNEEDED = ("action_noise", "lr_schedule", "clip_range", "ep_info_buffer", "_last_obs", "mine")
NEEDED = ("policy_class", "policy_kwargs", "observation_space", "action_space")


class MyPolicy(ActorCriticPolicy):
    """A class of a policy that is in no register."""


def make(policy="MlpPolicy"):
    arguments = {"policy": policy, "n_steps": 4, "batch_size": 8, "policy_kwargs": {}}
    return Algorithm("ppo", arguments).build(SB3VecEnv(CountingEnv([0, 3])), 0)


@pytest.fixture
def path(tmp_path):
    save_checkpoint(make().learn(8), tmp_path / "run/checkpoints/final.zip", NOTE)
    return tmp_path / "run/checkpoints/final.zip"


def test_the_payload_is_one():
    pickle.loads(pickled(Payload()))
    assert was_run()


# --------------------------------------------------------------------- zips of Stable-Baselines3


def test_pickles_that_acting_does_not_need_are_not_read(path, caplog):
    before = load_model(path).model.policy.state_dict()
    plant(path, UNNEEDED)
    for trust in (False, True):  # what can be read without is read without
        after = load_model(path, trust=trust).model.policy.state_dict()
        assert all(torch.equal(before[name], after[name]) for name in before)
        assert not was_run()
    for name in UNNEEDED:
        assert f"its {name} would run {NAME}: it is not read" in caplog.text


@pytest.mark.parametrize("name", NEEDED)
def test_pickles_that_acting_needs_are_data_or_refused(path, name):
    plant(path, [name])
    for folder in (path, path.parent.parent):
        with pytest.raises(NeedsTrust, match=f"its {name} is made by {NAME}.*It would run {NAME}"):
            load_policy(folder)
        assert not was_run()
    with pytest.raises(ConfigError, match="trust=true"):
        load_policy(path, deterministic=False)
    with pytest.raises(ConfigError):  # the payload is not a policy
        load_policy(path, trust=True)
    assert was_run()


@pytest.mark.parametrize("value", ["nested", "state", "item", "called"])
def test_payloads_inside_of_data_are_refused(path, value):
    class Deep:
        def __reduce__(self):
            return {
                "nested": (dict, ([("net_arch", Payload())],)),
                "state": (type("x", (), {}), (), {"a": Payload()}),
                "item": (dict, (), None, None, iter([("a", Payload())])),
                "called": (pickle.loads, (pickled(Payload()),)),
            }[value]

    plant(path, ["policy_kwargs"], Deep())
    with pytest.raises(ConfigError):
        load_policy(path)
    assert not was_run()


def test_a_class_of_its_own_needs_trust_and_acts_with_it(tmp_path, caplog):
    env = CountingEnv([0, 3])
    model = make().learn(8)
    own = MyPolicy(model.observation_space, model.action_space, lambda _: 0.1)
    own.load_state_dict(model.policy.state_dict())
    model.policy_class, model.policy = MyPolicy, own
    model.save(tmp_path / "mine.zip")
    with pytest.raises(NeedsTrust, match=r"tests\.learning\.checkpoints\.test_trust\.MyPolicy"):
        load_policy(tmp_path / "mine.zip")
    policy = load_policy(tmp_path / "mine.zip", env, trust=True)
    assert "trust=true" in caplog.text and "MyPolicy" in caplog.text
    obs, _ = env.reset()
    means, _ = model.predict(np.float32([[0, 0, 0], [1, 0, 0]]), deterministic=True)
    np.testing.assert_array_equal(policy.predict(policy.observed(obs, env)), means)


def test_a_damaged_pickle_names_what_comes_before_the_damage(path):
    found = read_inert(pickle.dumps(Payload(), protocol=2)[:-2])
    assert found.names == [NAME] and found.damage
    assert read_inert(b"").damage and not was_run()


@pytest.mark.parametrize("name", ["policy.pth", "policy.optimizer.pth", "pytorch_variables.pth"])
@pytest.mark.parametrize("trust", [False, True])
def test_weights_are_read_as_weights_alone(path, name, trust):
    stream = io.BytesIO()
    torch.save({"a": Payload()}, stream)
    replace(path, {name: stream.getvalue()})
    with pytest.raises(ConfigError, match=f"its weights would run {NAME}"):
        load_policy(path, trust=trust)
    with pytest.raises(ConfigError, match=f"its weights would run {NAME}"):
        load_parameters(make(), path)
    assert not was_run()


ALGORITHMS = {
    "ppo": {"use_sde": True, "policy_kwargs": {"activation_fn": torch.nn.ELU, "net_arch": [8]}},
    "a2c": {"n_steps": 4},
    "sac": {"ent_coef": "auto_0.1", "policy_kwargs": {"optimizer_class": torch.optim.AdamW}},
    "td3": {},
    "ddpg": {},
    "trpo": {},
    "tqc": {},
    "crossq": {},
    "recurrent_ppo": {"policy": "MlpLstmPolicy"},
}


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_the_model_is_that_of_stable_baselines_to_the_bit(tmp_path, algo, caplog):
    try:
        cls = algorithm_class(algo)
    except ConfigError as error:
        pytest.skip(str(error))
    arguments = {"policy": "MlpPolicy", **ALGORITHMS[algo]}
    model = cls(env=SB3VecEnv(CountingEnv([0, 3])), seed=1, device="cpu", **arguments)
    model.save(tmp_path / "mine.zip")
    mine, its = (
        load_model(tmp_path / "mine.zip").model,
        cls.load(tmp_path / "mine.zip", device="cpu"),
    )
    assert mine.observation_space == its.observation_space
    assert mine.action_space == its.action_space
    weights, others = mine.policy.state_dict(), its.policy.state_dict()
    assert list(weights) == list(others)
    assert all(torch.equal(weights[name], others[name]) for name in weights)
    obs = np.random.default_rng(0).normal(size=(16, 3)).astype(np.float32)
    for deterministic in (True, False):
        actions = []
        for one in (mine, its):
            torch.manual_seed(3)
            if getattr(one, "use_sde", False):
                one.policy.reset_noise()
            actions.append(one.predict(obs, deterministic=deterministic)[0])
        np.testing.assert_array_equal(*actions)
    assert "would run" not in caplog.text


# ------------------------------------------------------------------------------ files of numpy


@pytest.mark.parametrize("where", ["statistics", "stage", "tree"])
def test_arrays_of_objects_are_not_read(path, where):
    entries = {"tree": np.array([Payload()], object)}
    target = {"statistics": statistics_path, "stage": stage_path}.get(
        where, lambda p: p.with_name("final.state.npz")
    )(path)
    np.savez(target, allow_pickle=True, **entries)
    read = {"statistics": load_statistics, "tree": read_tree}.get(
        where, lambda p: load_policy(path)
    )
    with pytest.raises(ConfigError, match="Object arrays cannot be loaded"):
        read(target)
    assert not was_run()
    np.load(target, allow_pickle=True)["tree"]
    assert was_run()


# ------------------------------------------------------------------------- TorchScript and ONNX


SCRIPTS = {
    Writes: "does more than compute.*aten::from_file",
    WritesInABranch: "does more than compute.*aten::from_file",
    WritesAtLoading: "runs while it is loaded.*__setstate__",
}


@pytest.mark.parametrize("kind", SCRIPTS)
@pytest.mark.parametrize("inside", [False, True])
def test_torchscript_that_does_more_than_compute_needs_trust(tmp_path, kind, inside):
    stream = io.BytesIO()
    torch.jit.save(torch.jit.script(kind()), stream)
    path = tmp_path / ("final.zip" if inside else "policy.pt")
    if inside:
        save_script(stream.getvalue(), path, {**NOTE, "algo": "rsl_rl_ppo"})
    else:
        path.write_bytes(stream.getvalue())
    with pytest.raises(NeedsTrust, match=SCRIPTS[kind]):
        load_policy(path)
    assert not was_run()
    policy = load_policy(path, trust=True)
    policy.network(np.zeros((1, 2), np.float32))
    assert was_run() == (kind is not WritesAtLoading)


def test_save_of_torchscript_needs_trust(tmp_path):
    class Saves(torch.nn.Module):
        def forward(self, x: torch.Tensor) -> torch.Tensor:
            return x

    module = torch.jit.script(Saves())
    module.define(
        "def forward2(self, x: Tensor) -> Tensor:\n  torch.save(x, 'PWNED')\n  return x\n"
    )
    module.save(str(tmp_path / "policy.pt"))
    with pytest.raises(NeedsTrust, match="aten::save"):
        load_exported(tmp_path / "policy.pt")


@pytest.mark.parametrize("location", ["secret.bin", "../secret.bin", "{here}/secret.bin"])
def test_onnx_reads_no_other_file(tmp_path, location):
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    Path("secret.bin").write_bytes(np.ones(2, np.float32).tobytes())
    model = onnx_beside(location.format(here=Path.cwd()))
    (tmp_path / "policy.onnx").write_bytes(model)
    with pytest.raises(ConfigError, match="is not a policy"):
        load_policy(tmp_path / "policy.onnx")


def test_a_pickle_of_torch_is_no_policy(tmp_path):
    torch.save(Payload(), tmp_path / "policy.pt")
    with pytest.raises(ConfigError, match="it is not a TorchScript file"):
        load_policy(tmp_path / "policy.pt", trust=True)
    (tmp_path / "policy.pt").write_bytes(pickled(Payload()))
    with pytest.raises(ConfigError, match="it is not a TorchScript file"):
        load_policy(tmp_path / "policy.pt", trust=True)
    assert not was_run()


def test_the_note_is_plain_json(path):
    with zipfile.ZipFile(path) as archive:
        data = json.loads(archive.read("data"))
    data["embodichain"] = {"algo": f"{os.__name__}:system", "group": "policy"}
    replace(path, {"data": json.dumps(data).encode()})
    with pytest.raises(ConfigError, match="unknown algorithm"):
        load_policy(path)

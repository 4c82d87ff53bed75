"""Trainings with rsl_rl and skrl: checkpoints that play, go on and are exported; mistakes."""

import csv
import dataclasses
import functools
import importlib.util
import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

import embodichain
from embodichain.config import make_env, resolve
from embodichain.config.keys.check_types import check_types
from embodichain.config.keys.learners import LEARNERS
from embodichain.learning import evaluate, export_policy, load_policy
from embodichain.learning.checkpoints.checkpoint import DIGEST, read_note
from embodichain.learning.checkpoints.plain_state import read_tree, write_tree
from embodichain.learning.evaluation.episodes import TrainStatistics
from embodichain.learning.policies.exported import load_exported
from embodichain.learning.policies.exporting import FORMATS
from embodichain.learning.sb3.vec_env import ENDS
from embodichain.learning.tensors.tensor_env import TensorEnv
from embodichain.learning.training.keeper import state_path
from embodichain.learning.training.tensor_training import TensorAlgorithm, TensorSession
from embodichain.learning.training.train import TrainSummary, check_algorithm, train
from embodichain.utils.errors import ConfigError
from tests.helpers.extras import needs
from tests.learning.counting import CountingEnv
from tests.learning.interrupted import interrupt_and_resume

pytestmark = [needs("rsl_rl", "skrl"), pytest.mark.slow]

LINES = ("task=reach", "task.max_episode_steps=7", "num_envs=4", "sim.num_threads=1", "seed=1")
RSL_RL = ("algo=rsl_rl_ppo", "algo.num_steps_per_env=8", "algo.num_learning_epochs=2")
SKRL = ("algo=skrl_ppo", "algo.rollouts=8", "algo.learning_epochs=2")
SMALL = ("algo.hidden_dims=[8]",)
BOTH = pytest.mark.parametrize("algo", [RSL_RL, SKRL], ids=["rsl_rl", "skrl"])
TWO, FOUR = "total_timesteps=64", "total_timesteps=128"
STEP_32 = "checkpoints/step_000000000032"
FILES = {
    *("summary.json", "progress.csv", "checkpoints/best.zip"),
    *("checkpoints/final.zip", "checkpoints/final.state.npz"),
    *(f"{STEP_32}.zip", f"{STEP_32}.state.npz"),
}


def config(*lines):
    return resolve([*LINES, *SMALL, *lines], "train")


def folder(tmp_path, name):
    path = tmp_path / name
    path.mkdir()
    return path


def files(run):
    found = {p.relative_to(run).as_posix() for p in run.rglob("*") if p.is_file()}
    return {n for n in found if not n.startswith(("tensorboard/", "curves.png"))}


def everything(run):
    """Networks, normalization, optimizer, environment and generators, as one array."""

    def leaves(value):
        if isinstance(value, dict):
            return [x for part in value.values() for x in leaves(part)]
        if isinstance(value, (list, tuple)):
            return [x for part in value for x in leaves(part)]
        return (
            [np.ravel(np.float64(value))] if isinstance(value, (np.ndarray, torch.Tensor)) else []
        )

    return np.concatenate(leaves(read_tree(run / "checkpoints/final.state.npz")["training"]))


@dataclasses.dataclass(frozen=True)
class Trained:
    """A training of two updates that has ended, for tests that only read its folder.

    Attributes:
        folder: Its folder.
        summary: What `train` returned.
        seen: Steps and episodes at each call of `progress`.
    """

    folder: Path
    summary: TrainSummary
    seen: list[tuple[int, int]]


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Trains with an algorithm, once."""

    @functools.cache
    def of(algo):
        path, seen = tmp_path_factory.mktemp("trained"), []

        def progress(statistics):
            seen.append((statistics.env_steps, statistics.episodes))

        return Trained(path, train(config(*algo, TWO), path, progress), seen)

    return of


@BOTH
def test_checkpoint_of_two_updates_plays(trained, algo):
    run, resolved = trained(algo), config(*algo, TWO)
    summary, seen = run.summary, run.seen
    assert files(run.folder) == FILES
    assert [steps for steps, _ in seen] == list(range(4, 65, 4))
    assert seen[7][1] == 0 and seen[8][1] == 4  # episodes are counted at the end of a rollout
    assert (summary.env_steps, summary.episodes, summary.status) == (64, 8, "finished")
    assert json.loads((run.folder / "summary.json").read_text()) == dataclasses.asdict(summary)
    assert sum(summary.time_fractions.values()) == pytest.approx(1, abs=1e-3)
    note = read_note(run.folder / summary.checkpoint)
    assert note.pop("trained_in").startswith('{"format":1,')
    assert note == {"algo": algo[0][5:], "group": "policy", "task": "reach", "env_steps": 64}
    env = make_env(resolved)
    try:
        policy = load_policy(run.folder, env)
        obs, _ = env.reset()
        low, high = map(
            torch.from_numpy, (env.single_action_space.low, env.single_action_space.high)
        )
        for _ in range(8):
            action = policy(obs, env)
            assert action.shape == (4, 6) and ((low <= action) & (action <= high)).all()
            obs, *_ = env.step(action)
    finally:
        env.close()


@BOTH
def test_progress_has_the_columns_of_other_trainings(trained, algo):
    with (trained(algo).folder / "progress.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [int(row["time/total_timesteps"]) for row in rows] == [32, 64]
    last = {name: float(value) for name, value in rows[-1].items() if value}
    assert last["rollout/ep_len_mean"] == 7.0
    assert sum(last[f"Episode_Termination/{kind}"] for kind in ENDS) == 1.0
    assert 0.0 <= last["rollout/success_rate"] <= 1.0
    assert last["Episode_Reward/distance"] < 0 and last["train/value_loss"] > 0
    assert 0 < last["train/learning_rate"] <= 1e-2 and 0.8 < last["train/std"] < 1.2


@BOTH
def test_resumed_tensor_training_equals_uninterrupted(tmp_path, algo):
    here = functools.partial(config, *algo, FOUR)
    runs = interrupt_and_resume(here, tmp_path, at=40)  # within an episode
    assert json.loads((runs.first / "summary.json").read_text())["env_steps"] == 64
    summary = runs.summary
    assert summary.resumed_from == str(runs.first / "checkpoints/final.zip")
    np.testing.assert_array_equal(everything(runs.second), everything(runs.whole))
    before = json.loads((runs.whole / "summary.json").read_text())
    assert [summary.episodes, summary.mean_return] == [before["episodes"], before["mean_return"]]


@BOTH
def test_seed_decides_everything(tmp_path, algo):
    folders = [folder(tmp_path, name) for name in ("first", "again", "other")]
    for path, seed in zip(folders, (1, 1, 2), strict=True):
        torch.rand(3)
        train(config(*algo, "total_timesteps=32", f"seed={seed}"), path)
    first, again, other = map(everything, folders)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_state_of_another_network_is_refused(trained, tmp_path):
    run, other = tmp_path / "run", folder(tmp_path, "other")
    shutil.copytree(trained(RSL_RL).folder, run)
    with pytest.raises(ConfigError, match="its state does not fit: .*size mismatch"):
        train(config(*RSL_RL, FOUR, "algo.hidden_dims=[9]", f"resume={run}"), other)
    path = state_path(run / "checkpoints/final.zip")
    state = read_tree(path)
    del state["training"]["returns"]
    write_tree(path, state)
    with pytest.raises(ConfigError, match="its state does not fit: 'returns'"):
        train(config(*RSL_RL, FOUR, f"resume={run}"), other)
    assert list(other.iterdir()) == []


@BOTH
@pytest.mark.parametrize("form", FORMATS)
def test_exported_files_act_as_the_checkpoint(trained, tmp_path, algo, form):
    run = trained(algo).folder
    out = tmp_path / f"policy{FORMATS[form]}"
    env = embodichain.make("reach", 3, ["seed=2", "task.max_episode_steps=7"])
    try:
        policy = load_policy(run, env)
        assert export_policy(policy, env, out, form) < 1e-5
        obs, _ = env.reset()
        exported = load_policy(out, env)
        np.testing.assert_allclose(exported(obs, env), policy(obs, env), atol=1e-5)
        assert exported.metadata == policy.metadata and exported.algo == algo[0][5:]
        with pytest.raises(ConfigError, match="it is never replaced"):
            export_policy(policy, env, out, form)
        if form == "onnx":
            with pytest.raises(ConfigError, match="is a file of ONNX already"):
                export_policy(exported, env, tmp_path / "again.onnx", form)
    finally:
        env.close()


def test_a_checkpoint_gives_mean_actions_and_runs_no_code(trained, tmp_path, caplog):
    final = trained(RSL_RL).folder / "checkpoints/final.zip"
    with zipfile.ZipFile(final) as archive:
        assert archive.namelist() == ["data", "policy.pt"]
    alone = tmp_path / "elsewhere.zip"
    shutil.copy(final, alone)
    load_policy(alone)
    assert "runs code" not in caplog.text
    with pytest.raises(ConfigError, match="mean actions only: leave deterministic=false out"):
        load_policy(alone, deterministic=False)


def test_a_checkpoint_acts_as_the_actor_did_in_training(tmp_path):
    low, high = np.float32([-3.0, 0.5]), np.float32([1.0, 20.0])
    env = TensorEnv(CountingEnv([0, 3], low=low, high=high), action_scale=0.25)
    keys = {"name": "skrl_ppo", "hidden_dims": [4]}
    cfg = check_types({"task": {}, "algo": keys}).root.algo
    learner = TensorAlgorithm.of(cfg).build(env, 3)
    session = TensorSession(learner, env, TrainStatistics(100), tmp_path)
    note = {"algo": "skrl_ppo", "group": "policy", "task": "counting", DIGEST: None}
    session.save(tmp_path / "policy.zip", note, resumable=False, rolling=False)
    seen = torch.tensor([[1.0, 20.0, -7.0], [0.5, 0.0, 3.0]])
    with torch.no_grad():
        actions = (0.25 * learner.actor()(seen)).clamp(-1, 1).numpy()
    found = load_exported(tmp_path / "policy.zip")
    np.testing.assert_allclose(
        found.act(seen.numpy()), low + (actions + 1) * (high - low) / 2, atol=1e-5
    )
    assert found.metadata.action_high == (1.0, 20.0)
    assert found.metadata.columns == ("where/id[0]", "time[0]", "time[1]")


def test_checkpoint_of_another_task_is_refused(trained):
    env = embodichain.make("reach", 2, ["task.max_episode_steps=9"])
    try:
        with pytest.raises(ConfigError, match="max_episode_steps 7 -> 9"):
            load_policy(trained(SKRL).folder, env)
    finally:
        env.close()


@BOTH
def test_learned_policy_balances_the_pole(tmp_path, algo):
    """11 updates lead from 20 steps on average to hundreds; but for the noise as shipped."""
    steps = algo[1].replace("=8", "=24")
    lines = ["task=cart_pole", algo[0], steps, "algo.action_scale=1.0", "total_timesteps=4224"]
    resolved = resolve([*lines, "seed=1", "sim.num_threads=1"], "train")
    train(resolved, tmp_path)
    env = make_env(resolved)
    try:
        found = evaluate(env, load_policy(tmp_path, env), episodes=16, seed=0)
        assert found.length.mean > 300
        assert evaluate(env, "random", episodes=16, seed=0).length.mean < 60
    finally:
        env.close()


@BOTH
def test_critic_reads_its_own_groups(tmp_path, algo):
    state = ["task.observations.to_goal.group=critic", "algo.critic_groups=[policy,critic]"]
    train(config(*algo, *state, TWO), tmp_path)
    # 18 + 3 numbers for the critic, 18 for the actor.
    saved = read_tree(tmp_path / "checkpoints/final.state.npz")["training"]["learner"]
    names = {
        "rsl_rl_ppo": [("actor_state_dict", "mlp.0.weight"), ("critic_state_dict", "mlp.0.weight")],
        "skrl_ppo": [("policy", "net.0.weight"), ("value", "net.0.weight")],
    }
    widths = [saved[part][name].shape[1] for part, name in names[algo[0][5:]]]
    assert widths == [18, 21]
    deployed = ["~task.observations.to_goal", "task.max_episode_steps=7"]
    env = embodichain.make("reach", 2, deployed)  # without the critic's group
    try:
        obs, _ = env.reset()
        assert load_policy(tmp_path, env)(obs, env).shape == (2, 6)
    finally:
        env.close()


# -- mistakes -------------------------------------------------------------------------------------


def problems(*lines):
    try:
        resolved = config(*lines, TWO)
        env = make_env(resolved)
        try:
            check_algorithm(resolved, env)
        finally:
            env.close()
    except ConfigError as error:
        return {p.path: p.message for p in error.problems}
    return {}


def test_training_mistakes_are_reported_before_it_begins(tmp_path):
    assert problems(*RSL_RL) == {}
    found = problems(*RSL_RL, "algo.critic_groups=[critics]")
    assert found["algo.critic_groups"].startswith("no observation is in group 'critics'")
    assert problems(*RSL_RL, "algo.num_mini_batches=33") == {
        "algo.num_mini_batches": "a rollout has 32 steps in all environments, 33 batches need more"
    }
    assert "algo.mini_batches" in problems(*SKRL, "algo.mini_batches=33")
    (tmp_path / "demonstrations").touch()
    found = problems(*SKRL, f"dataset={tmp_path / 'demonstrations'}")
    assert found["dataset"].startswith("skrl_ppo learns from its own steps alone")
    found = problems(*RSL_RL, "checkpoint.replay_buffer=true")
    assert found["checkpoint.replay_buffer"] == "rsl_rl_ppo learns from no replay buffer"


@pytest.mark.parametrize("name", ["rsl_rl_ppo", "skrl_ppo"])
def test_missing_package_of_an_algorithm_is_named(monkeypatch, name):
    checked = check_types({"task": {}, "algo": {"name": name}})
    assert checked.problems == []
    assert TensorAlgorithm.of(checked.root.algo).name == name
    # As if the package were not installed.
    monkeypatch.setattr(importlib.util, "find_spec", lambda package: None)
    with pytest.raises(ConfigError) as caught:
        TensorAlgorithm.of(checked.root.algo)
    assert str(caught.value) == (
        f"algo.name: {name} needs a package: pip install '{LEARNERS[name].requires}'"
    )


def test_settings_are_checked_as_those_of_other_algorithms():
    def wrong(**keys):
        found = check_types({"task": {}, "algo": keys}).problems
        return {p.path: p for p in found}

    found = wrong(name="rsl_rl_ppo", gamma=1.5, hidden_dims=[], activation="elo", lamm=0.9)
    assert set(found) == {f"algo.{k}" for k in ("gamma", "hidden_dims", "activation", "lamm")}
    assert found["algo.lamm"].hint == "Did you mean 'lam'?"
    assert "algo.gamma" in wrong(name="skrl_ppo", gamma=0.9)  # skrl's is discount_factor


def test_generators_of_a_learner_are_seeded():
    cfg = check_types({"task": {}, "algo": {"name": "rsl_rl_ppo", "hidden_dims": [4]}}).root.algo

    def weights(seed):
        learner = TensorAlgorithm.of(cfg).build(TensorEnv(CountingEnv([0, 3])), seed)
        return torch.cat([p.detach().flatten() for p in learner.actor().parameters()])

    assert torch.equal(weights(3), weights(3)) and not torch.equal(weights(3), weights(4))

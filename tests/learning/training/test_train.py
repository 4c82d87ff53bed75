"""From a config to a checkpoint that plays; two updates with tiny sizes."""

import csv
import dataclasses
import json
import zipfile

import numpy as np
import pytest
import torch
from PIL import Image

from embodichain.config import make_env, resolve
from embodichain.learning import load_policy
from embodichain.learning.checkpoints.checkpoint import read_note
from embodichain.learning.evaluation.plots import draw_curves
from embodichain.learning.sb3.normalization import load_statistics
from embodichain.learning.sb3.vec_env import ENDS
from embodichain.learning.training.train import TORCH_THREADS, train
from embodichain.utils.errors import ConfigError

pytestmark = pytest.mark.slow

TINY = (
    "task=reach",
    "task.max_episode_steps=5",
    "num_envs=4",
    "algo.n_steps=8",
    "algo.batch_size=16",
    "algo.n_epochs=2",
    "sim.num_threads=1",
)
CONTRIB = ("trpo", "tqc", "crossq", "recurrent_ppo")
TWO_UPDATES = 2 * 4 * 8
FILES = {
    "summary.json",
    "progress.csv",
    *("checkpoints/final.zip", "checkpoints/final.state.npz", "checkpoints/best.zip"),
    *("checkpoints/step_000000000032.zip", "checkpoints/step_000000000032.state.npz"),
}


def config(*overrides):
    return resolve([*TINY, f"total_timesteps={TWO_UPDATES}", "seed=1", *overrides], "train")


def files(folder):
    """What a training left, without what optional packages write."""
    found = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    return {n for n in found if not n.startswith(("tensorboard/", "curves.png"))}


def parameters(folder):
    policy = load_policy(folder).model.policy
    return torch.cat([p.detach().flatten() for p in policy.parameters()])


def test_two_updates_make_a_checkpoint_that_plays(tmp_path):
    resolved = config()
    seen = []

    def progress(statistics):
        seen.append((statistics.env_steps, statistics.episodes, statistics.mean_return))

    summary = train(resolved, tmp_path, progress)
    assert files(tmp_path) == FILES
    assert summary.env_steps == TWO_UPDATES
    assert [steps for steps, _, _ in seen] == list(range(4, TWO_UPDATES + 1, 4))
    assert seen[3][2] is None and seen[4][1] == 4 and seen[-1][1] == summary.episodes == 12
    env = make_env(resolved)
    try:
        policy = load_policy(tmp_path, env)
        obs, _ = env.reset()
        for _ in range(6):
            obs, reward, *_ = env.step(policy(obs, env))
        assert torch.isfinite(reward).all()
    finally:
        env.close()


def test_summary_says_what_happened(tmp_path):
    summary = train(config(), tmp_path)
    assert json.loads((tmp_path / "summary.json").read_text()) == dataclasses.asdict(summary)
    assert (summary.task, summary.algo, summary.seed, summary.num_envs) == ("reach", "ppo", 1, 4)
    assert summary.status == "finished"
    assert summary.success_rate is not None and 0 <= summary.success_rate <= 1
    assert summary.mean_return is not None and np.isfinite(summary.mean_return)
    assert summary.train_seconds > 0
    rate = summary.env_steps / summary.train_seconds
    assert summary.env_steps_per_second == pytest.approx(rate)
    note = {"algo": "ppo", "group": "policy", "task": "reach", "env_steps": TWO_UPDATES}
    found = read_note(tmp_path / summary.checkpoint)
    assert found.pop("trained_in").startswith('{"format":1,')
    assert found == note


def test_the_algorithms_arguments_are_used(tmp_path):
    kwargs = "algo.policy_kwargs={net_arch: [8], activation_fn: relu, log_std_init: -1.5}"
    train(config(kwargs, "algo.gamma=0.5"), tmp_path)
    with zipfile.ZipFile(tmp_path / "checkpoints/final.zip") as archive:
        data = json.loads(archive.read("data"))
    assert data["gamma"] == 0.5 and data["n_steps"] == 8
    network = load_policy(tmp_path).model.policy
    assert [type(m).__name__ for m in network.mlp_extractor.policy_net] == ["Linear", "ReLU"]
    assert network.mlp_extractor.policy_net[0].out_features == 8
    np.testing.assert_allclose(network.log_std.detach().numpy(), -1.5, atol=0.1)


def test_seed_decides_everything(tmp_path):
    folders = [tmp_path / name for name in ("first", "again", "other")]
    for folder, seed in zip(folders, (1, 1, 2), strict=True):
        folder.mkdir()
        torch.rand(3)  # what was drawn before does not matter
        train(config(f"seed={seed}"), folder)
    first, again, other = map(parameters, folders)
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_threads_of_torch_are_given_back(tmp_path):
    torch.set_num_threads(2)
    try:
        during = []
        train(config(), tmp_path, lambda _: during.append(torch.get_num_threads()))
        assert set(during) == {TORCH_THREADS}
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(1)


def test_an_interrupt_lets_the_update_finish_and_saves(tmp_path):
    def interrupt(statistics):
        if statistics.env_steps == 4:  # in the first rollout
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(config(), tmp_path, interrupt)
    assert files(tmp_path) == FILES
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["status"], summary["env_steps"]) == ("interrupted", 32)
    whole = tmp_path / "whole"
    whole.mkdir()
    train(config("total_timesteps=32"), whole)
    assert torch.equal(parameters(tmp_path), parameters(whole))


def test_a_failure_leaves_no_checkpoint(tmp_path):
    def fail(statistics):
        raise RuntimeError("broken")

    with pytest.raises(RuntimeError, match="broken"):
        train(config(), tmp_path, fail)
    assert files(tmp_path) == {"progress.csv"}


def test_a_log_of_every_rollout(tmp_path):
    train(config(), tmp_path)
    with (tmp_path / "progress.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["time/total_timesteps"] for row in rows] == ["32", "64"]
    for row in rows:
        assert float(row["Episode_Reward/distance"]) < 5
        ends = [float(row[f"Episode_Termination/{kind}"]) for kind in ENDS]
        assert ends == [0.0, 0.0, 0.0, 1.0]


def test_curves_are_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    train(config("total_timesteps=96"), tmp_path)
    with Image.open(tmp_path / "curves.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3)
        assert picture.size == (1500, 350)  # return, success, length
    assert len(np.unique(pixels, axis=0)) > 20
    rows = (tmp_path / "progress.csv").read_text().splitlines()
    # The terms of a curriculum share one more plot.
    cells = [",Curriculum/level/mean,Curriculum/level/stairs", ",0.5,0", ",0.7,0", ",1,1"]
    lines = [row + cell for row, cell in zip(rows, cells, strict=True)]
    (tmp_path / "progress.csv").write_text("\n".join(lines))
    draw_curves(tmp_path)
    with Image.open(tmp_path / "curves.png") as picture:
        assert picture.size == (2000, 350)
        shown = np.asarray(picture.convert("RGB"))[40:300, 1560:1980].reshape(-1, 3)
    colours = {tuple(row) for row in np.unique(shown, axis=0).tolist()}
    assert {(0x1F, 0x77, 0xB4), (0xFF, 0x7F, 0x0E)} <= colours  # matplotlib's first two
    (tmp_path / "curves.png").unlink()
    (tmp_path / "progress.csv").write_text("time/total_timesteps\n32\n")
    assert draw_curves(tmp_path) is None and len(rows) == 4


def test_checkpoints_are_made_when_due_and_the_oldest_go(tmp_path):
    train(config("total_timesteps=160", "checkpoint.every_steps=33", "checkpoint.keep=1"), tmp_path)
    steps = {name for name in files(tmp_path) if "/step_" in name}
    assert steps == {
        "checkpoints/step_000000000128.zip",
        "checkpoints/step_000000000128.state.npz",
    }  # and one at 64, which went


@pytest.mark.parametrize("what", ["obs", "reward", "both"])
def test_statistics_of_normalized_trainings_stand_beside_every_checkpoint(tmp_path, what):
    train(config(f"algo.normalize={what}", "algo.normalize_kwargs={clip_obs: 5}"), tmp_path)
    for name in ("final", "best", "step_000000000032"):
        found = load_statistics(tmp_path / f"checkpoints/{name}.normalize.npz")
        assert (found.norm_obs, found.norm_reward) == (what != "reward", what != "obs")
        assert (found.clip_obs, found.gamma) == (5.0, 0.9)  # the task's gamma
        assert found.ret_count > 30
        assert np.isfinite(found.obs_var).all()


@pytest.mark.parametrize("algo", ["a2c", "sac", "td3", "ddpg", *CONTRIB])
def test_every_algorithm_learns_what_plays(tmp_path, algo):
    if algo in CONTRIB:
        pytest.importorskip("sb3_contrib")
    on_policy = algo in ("a2c", "trpo", "recurrent_ppo")
    own = ["algo.n_steps=8"] if on_policy else ["algo.learning_starts=16", "algo.buffer_size=100"]
    own += ["+algo.noise_type=normal"] if algo in ("td3", "ddpg") else []
    lines = [line for line in TINY if not line.startswith("algo.")]
    lines += [f"algo={algo}", "algo.policy_kwargs.net_arch=[8]", "total_timesteps=64", "seed=1"]
    resolved = resolve([*lines, *own], "train")
    summary = train(resolved, tmp_path)
    assert (summary.algo, summary.env_steps) == (algo, 64)
    env = make_env(resolved)
    try:
        obs, _ = env.reset()
        assert torch.isfinite(load_policy(tmp_path, env)(obs, env)).all()
    finally:
        env.close()


def change(resolved, **root):
    """A config that `resolve` would not let through, as Python users can make one."""
    changed = dataclasses.replace(resolved.root, **root)
    return type("Changed", (), {"root": changed, "task_name": "reach"})()


def test_mistakes_are_told_together_and_nothing_is_written(tmp_path):
    resolved = config("algo.policy_kwargs={net_arch: [0], activatio_fn: relu}")
    broken = change(resolved, total_timesteps=None, seed=2**40, resume="last")
    with pytest.raises(ConfigError) as caught:
        train(broken, tmp_path)
    problems = {p.path: p for p in caught.value.problems}
    assert set(problems) == {
        "total_timesteps",
        "seed",
        "resume",
        "algo.policy_kwargs.net_arch",
        "algo.policy_kwargs.activatio_fn",
    }
    assert problems["algo.policy_kwargs.activatio_fn"].hint == "Did you mean 'activation_fn'?"
    assert files(tmp_path) == set()


def test_a_task_that_cannot_be_learned_says_why(tmp_path):
    overrides = ["~task.observations.qpos", "~task.observations.qvel", "~task.observations.to_goal"]
    with pytest.raises(ConfigError, match="no observation is in group 'policy'; there are: none"):
        train(config(*overrides, "~task.observations.action"), tmp_path)
    assert files(tmp_path) == set()

"""A training interrupted and resumed equals the uninterrupted one, to the bit."""

import csv
import functools
import io
import json
import shutil
import signal
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from embodichain.config import resolve
from embodichain.learning.checkpoints.checkpoint import read_note
from embodichain.learning.checkpoints.plain_state import read_tree, write_tree
from embodichain.learning.policies.policy import load_model
from embodichain.learning.sb3.normalization import load_statistics
from embodichain.learning.training.keeper import find_resumable, state_path
from embodichain.learning.training.train import train
from embodichain.utils.errors import ConfigError
from tests.learning.interrupted import interrupt_and_resume

pytestmark = pytest.mark.slow

# Episodes of 7 steps across rollouts of 8; commands, noise and terms with a memory in the second.
REACH = ("task=reach", "task.max_episode_steps=7", "num_envs=4", "sim.num_threads=1", "seed=1")
PPO = ("algo.n_steps=8", "algo.batch_size=16", "algo.n_epochs=2", "checkpoint.every_steps=1")
A2C = ("algo=a2c", "algo.n_steps=8", "checkpoint.every_steps=1")
RSL_RL = (
    *("algo=rsl_rl_ppo", "algo.num_steps_per_env=8", "algo.num_mini_batches=2"),
    "algo.hidden_dims=[8]",
)
LSTM = (
    *("algo=recurrent_ppo", "algo.n_steps=8", "algo.batch_size=16", "algo.n_epochs=2"),
    *("algo.policy_kwargs={lstm_hidden_size: 8, net_arch: [8]}", "checkpoint.every_steps=1"),
)
OFF = ("algo.learning_starts=16", "algo.batch_size=16", "algo.policy_kwargs.net_arch=[8]")
KEEP = "checkpoint.replay_buffer=true"
ONCE = "checkpoint.every_steps=64"
BOTH = ("algo.normalize=both",)
FOUR, TWO = "total_timesteps=128", "total_timesteps=64"


def config(*overrides):
    return resolve([*REACH, *overrides], "train")


def folder(tmp_path, name):
    path = tmp_path / name
    path.mkdir()
    return path


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """The folder of a finished training with PPO; tests that change it take a copy."""
    run = tmp_path_factory.mktemp("short")
    train(config(*PPO, TWO), run)
    return run


def everything(run):
    """Networks, optimizer, and statistics where there are some."""
    model = load_model(run / "checkpoints/final.zip").model
    found = [p.detach().numpy().ravel() for p in model.policy.parameters()]
    owner = model.policy if hasattr(model.policy, "optimizer") else model.policy.actor
    for entry in owner.optimizer.state_dict()["state"].values():
        found += [np.ravel(v) for v in entry.values()]
    path = run / "checkpoints/final.normalize.npz"
    if path.is_file():
        kept = load_statistics(path)
        found += [kept.obs_mean, kept.obs_var, kept.ret_var.ravel(), kept.returns]
    return np.concatenate(found)


def same_log_columns(run):
    summary = json.loads((run / "summary.json").read_text())
    return [summary[key] for key in ("env_steps", "episodes", "success_rate", "mean_return")]


@pytest.mark.parametrize(
    "algo",
    [
        pytest.param(PPO, marks=pytest.mark.unmeasured),
        (*PPO, *BOTH),
        pytest.param(
            (*PPO, "algo.use_sde=true", "algo.learning_rate=lin_1e-3"),
            marks=pytest.mark.unmeasured,
        ),
        pytest.param(A2C, marks=pytest.mark.unmeasured),
        pytest.param((*A2C, *BOTH), marks=pytest.mark.unmeasured),
        (*LSTM, *BOTH),
    ],
    ids=["ppo", "ppo-normalized", "ppo-sde-schedule", "a2c", "a2c-normalized", "recurrent"],
)
def test_resumed_training_equals_uninterrupted(tmp_path, algo):
    runs = interrupt_and_resume(functools.partial(config, *algo, FOUR), tmp_path, at=40)
    assert runs.summary.resumed_from == str(runs.first / "checkpoints/final.zip")
    np.testing.assert_array_equal(everything(runs.second), everything(runs.whole))
    assert same_log_columns(runs.second) == same_log_columns(runs.whole)


# A step pays less and less, so the first checkpoint has the best score.
FADING = (
    "task.metrics.success.shape.below=1e-9",
    "+task.rewards.pay={func: constant, weight: 9}",
    "+task.curriculum.fade={func: modify_reward_weight,"
    " params: {term_name: pay, weight: 0, num_steps: 100, interpolate: true}}",
)
OF_THE_CLOCK = {
    *("time/fps", "time/time_elapsed", "time/physics_fraction", "time/environment_fraction"),
    *("time/policy_fraction", "time/update_fraction", "train_seconds", "env_steps_per_second"),
    *("time_fractions", "resumed_from", "seconds", "t"),
}


def without_clock(tree):
    """A tree of plain values as path -> value, without what is of the wall time."""
    if isinstance(tree, dict):
        items = [(key, value) for key, value in tree.items() if key not in OF_THE_CLOCK]
    elif isinstance(tree, (list, tuple)):
        items = list(enumerate(tree))
    else:
        return {"": tree.detach().numpy() if isinstance(tree, torch.Tensor) else tree}
    return {
        f"/{key}{path}": leaf for key, value in items for path, leaf in without_clock(value).items()
    }


def content(path):
    """What a file of a training says, apart from the wall time."""
    if path.suffix == ".zip":
        note = read_note(path)
        with zipfile.ZipFile(path) as archive:
            torch_files = [name for name in archive.namelist() if name.endswith(".pth")]
            networks = {n: torch.load(io.BytesIO(archive.read(n))) for n in torch_files}
        return without_clock({"note": note, "networks": networks})
    if path.suffix == ".npz":
        return without_clock(read_tree(path))
    if path.suffix == ".json":
        return without_clock(json.loads(path.read_text()))
    if path.suffix == ".csv":
        with path.open(newline="") as stream:
            return without_clock(list(csv.DictReader(stream)))
    return {"": path.read_bytes()}


@pytest.mark.parametrize(
    "algo",
    [
        (*PPO[:3], *BOTH, "algo.learning_rate=lin_1e-3"),
        RSL_RL,
        pytest.param(
            (
                *("algo=sac", "algo.normalize=obs", "algo.buffer_size=500"),
                *(
                    "algo.learning_starts=16",
                    "algo.batch_size=16",
                    "algo.policy_kwargs.net_arch=[8]",
                ),
                *("algo.gradient_steps=1", "checkpoint.replay_buffer=true"),
            ),
            marks=pytest.mark.unmeasured,
        ),
    ],
    ids=["ppo", "rsl_rl", "sac"],
)
def test_stopped_five_times_it_leaves_the_same_files(tmp_path, algo):
    if "algo=rsl_rl_ppo" in algo:
        pytest.importorskip("rsl_rl")
    whole, cut = folder(tmp_path, "whole"), folder(tmp_path, "cut")
    lines = (*algo, *FADING, "total_timesteps=352", "checkpoint.every_steps=48")
    train(config(*lines), whole)
    for steps in (36, 100, 136, 208, 300):

        def stop(statistics, steps=steps):
            if statistics.env_steps >= steps:
                raise KeyboardInterrupt

        again = [f"resume={cut}"] if (cut / "summary.json").exists() else []
        with pytest.raises(KeyboardInterrupt):
            train(config(*lines, *again), cut, stop)
    train(config(*lines, f"resume={cut}"), cut)

    def files(run):
        found = {path.relative_to(run) for path in run.rglob("*") if path.is_file()}
        return {path for path in found if path.parts[0] != "tensorboard"}  # one for each start

    assert files(cut) == files(whole)
    for path in sorted(files(whole)):
        np.testing.assert_equal(content(cut / path), content(whole / path), str(path))
    first = 64 if "algo=sac" not in algo else 48  # a rollout of PPO is 32 steps
    assert read_note(cut / "checkpoints/best.zip")["env_steps"] == first


def test_the_best_checkpoint_comes_along_into_another_folder(tmp_path):
    first, second, third = (folder(tmp_path, n) for n in ("first", "second", "third"))
    lines = (*PPO[:3], *BOTH, *FADING, "checkpoint.every_steps=32")
    train(config(*lines, "total_timesteps=96"), first)
    summary = train(config(*lines, FOUR, f"resume={first}"), second)
    assert summary.best == "checkpoints/best.zip"
    for name in ("best.zip", "best.normalize.npz", "best.curriculum.npz"):
        before, after = (run / "checkpoints" / name for run in (first, second))
        assert before.read_bytes() == after.read_bytes()
    (second / "checkpoints/best.zip").unlink()
    longer = config(*lines, "total_timesteps=160", f"resume={second}")
    train(longer, third)
    # An uninterrupted training is judged after 128 steps too, and further ones pay less.
    assert read_note(third / "checkpoints/best.zip")["env_steps"] == 128


@pytest.mark.parametrize("before", [None, 2])
def test_what_was_chosen_for_the_first_part_stays(tmp_path, before):
    """The config of the folder says it; one that an older version wrote has the library's own."""
    written = config("algo=sac", TWO).tree["algo"]
    assert written["gradient_steps"] == 4  # one for each of four environments
    (tmp_path / "config.yaml").write_text(
        f"algo: {{name: sac, gradient_steps: {before or 'null'}}}"
    )
    resumed = config("algo=sac", FOUR, f"resume={tmp_path}")
    assert resumed.tree["algo"]["gradient_steps"] == before
    given = config("algo=sac", FOUR, f"resume={tmp_path}", "algo.gradient_steps=3")
    assert given.tree["algo"]["gradient_steps"] == 3


ENDED = {
    "ppo": (*PPO, "algo.normalize=both"),
    "sac": ("algo=sac", "algo.learning_starts=32", "algo.policy_kwargs.net_arch=[8]"),
    "rsl_rl": RSL_RL,
}
"""Algorithm -> what a training with it is told; with rollouts of 32 steps, 72 take 96."""


@pytest.fixture(scope="module", params=ENDED)
def ended(request, tmp_path_factory):
    """What a training is told, and the folder that it finished in."""
    if request.param == "rsl_rl":
        pytest.importorskip("rsl_rl")
    run = tmp_path_factory.mktemp("ended")
    job = (*ENDED[request.param], "total_timesteps=72")
    train(config(*job), run)
    return job, run


@pytest.mark.parametrize("left", [None, "failed"], ids=["killed", "disk full"])
def test_a_training_whose_results_were_not_written_is_ended(tmp_path, ended, left):
    """After its last checkpoint: by a kill, or by a full disk."""
    job, finished = ended
    whole = Path(shutil.copytree(finished, tmp_path / "whole"))
    second = folder(tmp_path, "second")
    wanted = same_log_columns(whole)
    if left is None:
        (whole / "summary.json").unlink()
    else:
        (whole / "summary.json").write_text(json.dumps({"status": left}))
    summary = train(config(*job, f"resume={whole}"), second)
    assert summary.status == "finished"
    assert same_log_columns(second) == wanted
    for name in ("policy.pth", "policy.pt"):
        parts = [in_zip(run / "checkpoints/final.zip", name) for run in (whole, second)]
        assert parts[0] == parts[1]
    with pytest.raises(ConfigError, match="steps already: give more"):
        train(config(*job, f"resume={second}"), folder(tmp_path, "third"))


def in_zip(path, name):
    """Weights of a checkpoint, by name; None without such a file."""
    with zipfile.ZipFile(path) as archive:
        if name not in archive.namelist():
            return None
        stream = io.BytesIO(archive.read(name))
    state = torch.load(stream) if name.endswith("pth") else torch.jit.load(stream).state_dict()
    return {key: value.numpy().tobytes() for key, value in state.items()}


def test_a_finished_training_can_be_made_longer(tmp_path, short):
    whole, second = (folder(tmp_path, name) for name in ("whole", "second"))
    train(config(*PPO, FOUR), whole)
    with pytest.raises(ConfigError, match="has 64 steps already"):
        train(config(*PPO, TWO, f"resume={short}"), second)
    train(config(*PPO, FOUR, f"resume={short}"), second)
    np.testing.assert_array_equal(everything(second), everything(whole))


def test_terms_with_a_memory_go_on_too(tmp_path):
    go2 = ("task=quadruped_velocity", "num_envs=3", "sim.num_threads=1", "seed=2", *PPO)
    go2 += ("algo.learning_rate=1e-3",)  # the task's falls until the last of its steps
    whole, first, second = (folder(tmp_path, n) for n in ("whole", "first", "second"))
    train(resolve([*go2, "total_timesteps=96"], "train"), whole)
    train(resolve([*go2, "total_timesteps=48"], "train"), first)
    lines = [*go2, "total_timesteps=96", f"resume={first}"]
    train(resolve(lines, "train"), second)
    np.testing.assert_array_equal(everything(second), everything(whole))


def test_a_broken_checkpoint_is_passed_over(tmp_path, short):
    run = Path(shutil.copytree(short, tmp_path / "run"))
    final, step = run / "checkpoints/final.zip", run / "checkpoints/step_000000000032.zip"
    assert find_resumable(run)[0] == final
    shutil.copy(state_path(step), state_path(final))  # killed between the two files
    assert find_resumable(run)[0] == step
    state_path(step).unlink()
    with pytest.raises(ConfigError, match="has no checkpoint that a training can continue from"):
        find_resumable(run)


def test_a_state_of_other_code_is_refused(tmp_path, short):
    first = Path(shutil.copytree(short, tmp_path / "first"))
    path, state = find_resumable(first)
    del state["training"]["env"]["streams"]["seed"]
    write_tree(state_path(path), state)
    with pytest.raises(ConfigError, match="its state has no 'seed'.*versions.json.*`policy=`"):
        train(config(*PPO, FOUR, f"resume={first}"), folder(tmp_path, "other"))


def test_off_policy_trainings_go_on(tmp_path):
    sac = ("algo=sac", *OFF, "algo.buffer_size=500", "algo.normalize=obs", ONCE)
    first, second = folder(tmp_path, "first"), folder(tmp_path, "second")
    train(config(*sac, TWO), first)
    summary = train(config(*sac, FOUR, f"resume={first}"), second)
    assert summary.env_steps == 128
    assert not np.array_equal(everything(first), everything(second))


def kept(run, name="final"):
    return read_tree(run / f"checkpoints/{name}.replay.npz")


@pytest.mark.parametrize(
    "algo",
    [
        ("algo=sac", "algo.buffer_size=500", "algo.normalize=obs"),
        ("algo=sac", "algo.buffer_size=500", "algo.use_sde=true", "algo.train_freq=3"),
        ("algo=td3", "algo.buffer_size=60", "+algo.noise_type=ornstein-uhlenbeck"),
        ("algo=ddpg", "algo.buffer_size=500", "algo.n_steps=3"),
    ],
    ids=["sac-normalized", "sac-sde", "td3-full-noise", "ddpg-n-steps"],
)
def test_with_its_replay_buffer_resumed_equals_uninterrupted(tmp_path, algo):
    whole, first, second = (folder(tmp_path, n) for n in ("whole", "first", "second"))
    lines = (*algo, *OFF, KEEP, ONCE)
    train(config(*lines, FOUR), whole)
    train(config(*lines, "total_timesteps=72"), first)
    train(config(*lines, FOUR, f"resume={first}"), second)
    np.testing.assert_equal(kept(second), kept(whole))
    np.testing.assert_array_equal(everything(second), everything(whole))
    assert same_log_columns(second) == same_log_columns(whole)


def test_replay_buffers_come_back_whole(tmp_path):
    sac = ("algo=sac", *OFF, "algo.buffer_size=400", "checkpoint.every_steps=16")
    first, second = folder(tmp_path, "first"), folder(tmp_path, "second")
    train(config(*sac, KEEP, "checkpoint.keep=1", TWO), first)
    names = {path.name for path in (first / "checkpoints").glob("*.replay.npz")}
    assert names == {"final.replay.npz", "step_000000000048.replay.npz"}  # best needs none
    found = kept(first)
    assert (found["env_steps"], found["pos"], found["full"]) == (64, 16, False)
    assert found["arrays"]["observations"].shape == (17, 4, 21)  # of 100 rows: those in use
    resumed = config(*sac, FOUR, f"resume={first}")  # and goes on without keeping it
    summary = train(resumed, second)
    assert summary.env_steps == 128 and not list(second.rglob("*.replay.npz"))
    with pytest.raises(ConfigError, match="do not fit in algo.buffer_size"):
        smaller = config(*sac, FOUR, f"resume={first}", "algo.buffer_size=16")
        train(smaller, folder(tmp_path, "smaller"))
    shutil.copy(first / "checkpoints/step_000000000048.replay.npz", first / "other.npz")
    (first / "other.npz").replace(first / "checkpoints/final.replay.npz")
    with pytest.raises(ConfigError, match="it is of 48 steps, the checkpoint of 64"):
        train(resumed, folder(tmp_path, "mixed"))
    (first / "checkpoints/final.replay.npz").unlink()
    with pytest.raises(ConfigError, match="has no state of a training"):
        train(resumed, folder(tmp_path, "missing"))
    with pytest.raises(ConfigError, match="ppo learns from no replay buffer"):
        train(config(*PPO, KEEP, TWO), folder(tmp_path, "ppo"))


def test_trees_come_back_to_the_bit(tmp_path):
    tree = {
        "a": np.array([1.5, np.nan]),
        "big": 2**127 + 1,
        "floats": (0.1, float("inf"), -0.0),
        "deep": {"tensor": torch.arange(3, dtype=torch.uint8), "none": [None, True, "text"]},
        "scalar": np.float32(0.1),
        "u": np.array([2**64 - 1], np.uint64),
    }
    write_tree(tmp_path / "t.npz", tree)
    found = read_tree(tmp_path / "t.npz")
    assert torch.equal(found["deep"].pop("tensor"), tree["deep"].pop("tensor"))
    np.testing.assert_equal(found, tree)
    assert found["scalar"].dtype == np.float32 and isinstance(found["floats"], tuple)
    with pytest.raises(TypeError, match=r"state\.x\[0\] is object"):
        write_tree(tmp_path / "u.npz", {"x": [object()]})
    assert not (tmp_path / "u.npz").exists()
    (tmp_path / "t.npz").write_bytes(b"no")
    with pytest.raises(ConfigError, match="has no state of a training"):
        read_tree(tmp_path / "t.npz")


SMALL = (
    *("task=reach", "num_envs=4", "sim.num_threads=1", "seed=1", *PPO, "algo.normalize=both"),
    "eval.episodes=0",
)
ENDLESS = ("total_timesteps=1_000_000", "checkpoint.every_steps=32")


def wait_for(pattern, process, seconds=120):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = sorted(Path("outputs").rglob(pattern))
        if found:
            return found[-1]
        if process.poll() is not None:
            pytest.fail(f"ended with {process.returncode}: {process.communicate()[1]}")
        time.sleep(0.01)
    pytest.fail(f"no {pattern} after {seconds} s")


def resume(commands, *overrides):
    done = commands.run("train", *overrides, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.unmeasured
def test_killed_and_resumed_equals_uninterrupted(tmp_path, monkeypatch, commands):
    monkeypatch.chdir(folder(tmp_path, "here"))
    process = commands.start("train", *SMALL, *ENDLESS, "--quiet")
    checkpoint = wait_for("step_*.zip", process)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    run = checkpoint.parent.parent
    assert not (run / "checkpoints/final.zip").exists()
    steps = read_tree(state_path(find_resumable(run)[0]))["env_steps"]
    # What came before does not depend on how long the training was meant to be: nothing decays.
    total = f"total_timesteps={steps + 64}"
    summary = resume(commands, "resume=last", total)
    assert summary["resumed_from"].startswith(str(run.resolve()))
    assert Path(summary["folder"]).resolve() != run.resolve()
    whole = folder(tmp_path, "whole")
    train(resolve([*SMALL, total], "train"), whole)
    np.testing.assert_array_equal(everything(Path(summary["folder"])), everything(whole))


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.unmeasured)]
)
def test_signals_write_a_checkpoint_and_end_with_130(tmp_path, monkeypatch, commands, number):
    monkeypatch.chdir(folder(tmp_path, "here"))
    process = commands.start("train", *SMALL, *ENDLESS, "--quiet")
    run = wait_for("step_*.zip", process).parent.parent
    process.send_signal(number)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130, error
    assert find_resumable(run)[0].name == "final.zip"
    assert json.loads((run / "summary.json").read_text())["status"] == "interrupted"


def test_only_few_keys_may_change(tmp_path, monkeypatch, capsys):
    from embodichain.cli import main

    monkeypatch.chdir(folder(tmp_path, "here"))
    assert main(["train", "resume=last"]) == 2
    assert "there is no training to resume yet" in capsys.readouterr().err
    assert main(["train", *SMALL, TWO, "--quiet"]) == 0
    assert main(["train", "resume=last", "seed=3", "algo.gamma=0.5"]) == 2
    error = capsys.readouterr().err
    assert "seed: a resumed training keeps" in error and "algo.gamma: a resumed" in error
    assert main(["train", "resume=last"]) == 2
    assert "has 64 steps already: give more" in capsys.readouterr().err
    assert main(["train", "-m", "resume=last", "total_timesteps=96,128"]) == 2
    assert "no --multirun" in capsys.readouterr().err
    assert main(["train", "resume=nowhere"]) == 2
    assert "'nowhere' is not a training's folder" in capsys.readouterr().err


def test_a_buffer_with_less_memory_goes_on_too(tmp_path, caplog):
    lines = (
        "algo=sac",
        "algo.buffer_size=100",
        "algo.optimize_memory_usage=true",
        *OFF,
        KEEP,
        ONCE,
    )
    whole, first, second = (folder(tmp_path, n) for n in ("whole", "first", "second"))
    train(config(*lines, FOUR), whole)
    assert "an episode that is cut off counts as terminated" in caplog.text
    assert "next_observations" not in kept(whole)["arrays"]
    train(config(*lines, TWO), first)
    train(config(*lines, FOUR, f"resume={first}"), second)
    np.testing.assert_array_equal(everything(second), everything(whole))

"""`eval`, `play` and `export policy` on one tiny training, in this process."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

import embodichain.recording as recording
from embodichain.cli import main
from embodichain.learning.evaluation.evaluation import EVAL_SEED_OFFSET
from embodichain.recording import inspect

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a training of `reach` with episodes of 12 steps."""
    root = tmp_path_factory.mktemp("trained")
    keys = ["num_envs=4", "total_timesteps=64", "algo.n_steps=8", "algo.batch_size=16", "seed=5"]
    keys += ["task.max_episode_steps=12", "eval.episodes=0", f"output_dir={root}"]
    assert main(["train", "task=reach", "--quiet", *keys]) == 0
    return next(path.parent for path in root.glob("*/*/config.yaml"))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    return tmp_path


def told(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, object]:
    assert main([*arguments, "--json"]) == 0, capsys.readouterr().err
    data: dict[str, object] = json.loads(capsys.readouterr().out)
    return data


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(list(arguments)) == 2
    out, err = capsys.readouterr()
    assert err.count("error: ") == 1
    assert "Traceback" not in err
    return err


def test_eval_writes_what_it_says(
    trained: Path, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = told(capsys, "eval", str(trained), "episodes=6")
    assert (found["task"], found["episodes"], found["num_envs"]) == ("reach", 6, 4)
    assert found["seed"] == 5
    assert found["per_episode"]["env"] == [0, 0, 1, 1, 2, 3]
    assert found["per_episode"]["length"] == [12] * 6
    folder = Path(found["folder"])
    assert folder.parts[0] == "outputs"
    assert json.loads((folder / "eval.json").read_text()) == found
    with recording.open(folder) as log:
        drawn = [e.drawn for e in log.episodes if e.counted]
    for name, values in found["per_episode"]["drawn"].items():
        assert values == [draws[name] for draws in drawn]
    assert set(found["per_episode"]["drawn"]) == set(drawn[0]) != set()
    config = yaml.safe_load((folder / "config.yaml").read_text())
    assert config["seed"] == EVAL_SEED_OFFSET + 5
    assert config["task"]["max_episode_steps"] == 12  # the run's own config, not today's file
    ended = inspect(folder / "rollout.mcap")
    assert (len(ended.episodes), ended.counted) == (8, 6)  # two of all environments
    with recording.open(folder) as log:
        counted = {(e.env, e.episode) for e in log.episodes if e.counted}
        assert {e.counted for e in log.episodes} == {True, False}
    assert counted == {(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (3, 0)}
    assert "eval" in (folder / "command.txt").read_text()


def test_eval_repeats_and_changes_with_its_keys(
    trained: Path, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = ("eval", str(trained), "episodes=2", "record=none")
    first = told(capsys, *common)
    assert first["log"] is None
    assert not list(Path(str(first["folder"])).glob("*.mcap"))
    assert told(capsys, *common)["per_episode"] == first["per_episode"]
    assert told(capsys, *common)["folder"] != first["folder"]
    assert told(capsys, *common, "seed=6")["per_episode"] != first["per_episode"]
    drawn = told(capsys, *common, "deterministic=false")
    assert drawn["per_episode"] != first["per_episode"]
    assert drawn["per_episode"] == told(capsys, *common, "deterministic=false")["per_episode"]
    more = told(capsys, *common, "task.max_episode_steps=3", "num_envs=1", "allow_changed=true")
    assert more["per_episode"]["length"] == [3, 3]
    assert more["per_episode"]["env"] == [0, 0]


def test_eval_prints_a_table(trained: Path, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["eval", str(trained), "episodes=4", "record=none"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"success +0.0%  \[0.0%, 49.0%\]  0 of 4", text)
    assert re.search(r"return mean +-\d+\.\d+  \[-\d+\.\d+, -\d+\.\d+\]", text)
    assert re.search(r"return IQM +-\d", text)
    assert re.search(r"reward distance +-\d", text)


def test_a_checkpoint_is_played_by_its_name(
    trained: Path, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = shutil.copytree(trained, here / "run")
    shutil.copy(run / "checkpoints/final.zip", run / "checkpoints/mine.zip")
    keys = ("episodes=1", "record=none")
    for name in ("run/mine", "run/checkpoints/mine"):
        found = told(capsys, "eval", name, *keys)
        assert str(found["policy"]).endswith("run/checkpoints/mine.zip")
    task = ("task=reach", "task.max_episode_steps=12", *keys)
    found = told(capsys, "run", "policy=run/mine", *task)
    assert str(found["policy"]).endswith("run/checkpoints/mine.zip")


def test_last_is_the_newest_training(
    trained: Path, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "no training in outputs yet" in refused(capsys, "eval", "last")
    shutil.copytree(trained, here / "outputs/2026-01-01/00-00-00_reach")
    for _ in range(2):  # the first evaluation's folder is newer, and no training
        found = told(capsys, "eval", "last", "episodes=1", "record=none")
        assert "2026-01-01/00-00-00_reach/checkpoints/final.zip" in str(found["policy"])


def test_eval_of_other_policies(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keys = ("task=reach", "episodes=3", "num_envs=2", "record=none", "task.max_episode_steps=4")
    found = told(capsys, "eval", "zero", *keys)
    assert (found["policy"], found["seed"], found["episodes"]) == ("zero", 0, 3)
    (here / "mine.py").write_text("def half(obs, env):\n    return env.rand('x', (6,), 0.5, 0.5)\n")
    assert told(capsys, "eval", "mine:half", *keys)["policy"] == "mine:half"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["eval"], "evaluate what? One of: RUN"),
        (["eval", "a", "b"], "evaluate what?"),
        (["eval", "no/such.zip"], "no such file or folder: no/such.zip"),
        (["eval", "zero"], "zero is not in the folder of a run: give the task, task=NAME"),
        (["eval", "zer", "task=reach"], "unknown policy 'zer'"),
        (["eval", "RUN", "episodes=0"], "episodes: must be an integer of at least 1, got '0'"),
        (["eval", "RUN", "episodes=x"], "episodes: must be an integer of at least 1, got 'x'"),
        (["eval", "RUN", "seed=-1"], "seed: must be an integer of at least 0, got '-1'"),
        (["eval", "RUN", "seed=4294967296"], "seed: must be from 0 to 4294967295"),
        (["eval", "RUN", "deterministic=perhaps"], "deterministic: must be true or false"),
        (["eval", "RUN", "task.max_episode_steps=x"], "command line: task.max_episode_steps"),
        (["eval", "RUN", "algo=ppo"], "algo: `eval` does not read it: a policy is played"),
        (["eval", "RUN", "eval.episodes=2"], "eval.episodes: it belongs to `train`, for the "),
        (["eval", "RUN", "max_steps=2"], "max_steps: `eval` does not read it"),
        (["eval", "zero", "task=reach", "policy=random"], "policy: `eval` does not read it"),
        (["play", "RUN", "+algo.gamma=0.5"], "algo.gamma: `play` does not read it"),
        (["play", "RUN", "eval.seed=2"], "eval.seed: it belongs to `train`"),
        (["run", "task=reach", "total_timesteps=9"], "total_timesteps: `run` does not read it"),
        (["run", "task=reach", "eval.episodes=9"], "for a run, give episodes=9 alone"),
        (["train", "task=reach", "max_steps=9"], "max_steps: `train` does not read it"),
        (["train", "-m", "task=reach", "seed=1,2", "episodes=9"], "has eval.episodes=9"),
        (["eval", "RUN", "task=cart_pole"], "has observations (21,), this task has (4,)"),
        (["eval", "RUN", "task=cart_pole"], "observations only in training: qpos (6), "),
        (["eval", "RUN", "task=cart_pole"], "only here: qpos (2), qvel (2); actions only in "),
        (["export", "policy", "zero"], "policy: only zips of trainings are exported"),
        (["export", "policy"], "export what?"),
        (["export"], "export what? One of: policy RUN"),
        (["export", "policy", "RUN", "task=cart_pole"], "has observations (21,)"),
        (["play"], "play what? One of: RUN"),
        (["play", "RUN"], "there is no display to open a window on"),
    ],
)
def test_mistakes(
    trained: Path,
    here: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    words = [str(trained) if word == "RUN" else word for word in arguments]
    assert message in refused(capsys, *words)
    assert not list(here.glob("outputs/*/*/*"))  # what is refused leaves no folder
    assert not Path("outputs/latest").is_symlink()


def test_play_without_a_window_is_a_run(
    trained: Path, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = told(capsys, "play", str(trained), "--episodes", "2", "viewer=none")
    assert (found["episodes"], found["num_envs"], found["status"]) == (2, 1, "finished")
    assert str(found["policy"]).endswith("checkpoints/final.zip")
    assert not list(Path(str(found["folder"])).glob("*.mcap"))


@pytest.mark.parametrize(("form", "suffix"), [("onnx", ".onnx"), ("torchscript", ".pt")])
def test_exported_policy_is_evaluated_as_the_checkpoint(
    trained: Path, here: Path, capsys: pytest.CaptureFixture[str], form: str, suffix: str
) -> None:
    out = here / f"reach{suffix}"
    arguments = ("export", "policy", str(trained), "--format", form, "-o", str(out))
    facts = told(capsys, *arguments)
    assert facts["task"] == "reach"
    assert float(str(facts["largest_difference"])) <= 1e-5
    assert "exists; it is never replaced" in refused(capsys, *arguments)
    keys = ("episodes=2", "record=none", "seed=1")
    of_file = told(
        capsys, "eval", str(out), "task=reach", "task.max_episode_steps=12", "num_envs=2", *keys
    )
    of_run = told(capsys, "eval", str(trained), *keys)
    np.testing.assert_allclose(
        of_file["per_episode"]["return"], of_run["per_episode"]["return"], atol=1e-3
    )
    assert "only zips" in refused(capsys, "export", "policy", str(out), "task=reach")
    assert "made for other observations" in refused(capsys, "eval", str(out), "task=cart_pole")


def test_export_goes_into_the_runs_folder(
    trained: Path, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = shutil.copytree(trained, here / "run")
    assert main(["export", "policy", "run"]) == 0
    assert re.match(r".*policy\.onnx: reach, ppo, at most .* from", capsys.readouterr().out)
    found = told(capsys, "eval", str(run / "policy.onnx"), "episodes=1", "record=none")
    assert found["task"] == "reach"


def test_eval_after_train_says_that_its_episodes_are_the_same(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = ["num_envs=4", "total_timesteps=64", "algo.n_steps=8", "algo.batch_size=16", "seed=5"]
    keys += ["task.max_episode_steps=12", "eval.episodes=6", "record=none", "--quiet"]
    assert main(["train", "task=reach", *keys]) == 0
    (run,) = [path.parent for path in here.glob("outputs/*/*/summary.json")]
    own = json.loads((run / "summary.json").read_text())["eval"]
    same = "the same episodes as at the end of the training, no confirmation: seed=6"
    assert main(["eval", str(run), "episodes=6", "record=none", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["returns"] == own["returns"] and same in err
    for other in ("seed=6", "episodes=4", "deterministic=false", "num_envs=2"):
        words = [str(run), *(["episodes=6"] if "episodes" not in other else []), other]
        assert main(["eval", *words, "record=none", "--json"]) == 0
        assert "same episodes" not in capsys.readouterr().err
    assert main(["eval", str(run), "episodes=6", "record=none"]) == 0
    assert same in " ".join(capsys.readouterr().out.split())

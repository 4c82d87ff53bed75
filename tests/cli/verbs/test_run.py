"""One run's files, output and exit codes; each process start is shared by several checks."""

import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from PIL import Image

from embodichain.cli import main
from embodichain.recording import inspect
from embodichain.utils.errors import ConfigError
from tests.helpers.commands import Command, Commands

pytestmark = pytest.mark.slow

TINY = ("task=random_reach", "num_envs=2", "task.max_episode_steps=5", "seed=3")
FILES = {
    *("config.yaml", "overrides.yaml", "command.txt", "versions.json", "rollout.mcap"),
    *("foxglove_layout.json", "scene.png", "summary.json", "run.log"),
}


@pytest.fixture(scope="module")
def finished(
    embodichain: Callable[..., subprocess.CompletedProcess[str]],
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[subprocess.CompletedProcess[str], Path]:
    cwd = tmp_path_factory.mktemp("finished")
    return embodichain("run", *TINY, "episodes=3", "--json", cwd=cwd), cwd


def folder_of(cwd: Path) -> Path:
    return (cwd / "outputs" / "latest").resolve()


def test_json_is_one_object_and_nothing_else(finished) -> None:
    done, cwd = finished
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n") == 1
    summary = json.loads(done.stdout)
    assert summary["task"] == "random_reach"
    assert summary["status"] == "finished"
    assert (summary["episodes"], summary["episodes_wanted"], summary["num_envs"]) == (6, 6, 2)
    assert (summary["control_steps"], summary["env_steps"], summary["seed"]) == (15, 30, 3)
    assert inspect(folder_of(cwd) / "rollout.mcap").counted == 6
    assert summary["length"] == {"mean": 5.0, "std": 0.0, "min": 5.0, "max": 5.0}
    assert summary["fps"] > 0
    assert json.loads((folder_of(cwd) / "summary.json").read_text()) == summary


def test_run_folder_holds_what_it_takes_to_run_again(finished) -> None:
    _, cwd = finished
    folder = folder_of(cwd)
    assert re.fullmatch(
        r"outputs/\d{4}-\d\d-\d\d/\d\d-\d\d-\d\d_random_reach", str(folder.relative_to(cwd))
    )
    assert {path.name for path in folder.iterdir()} == FILES
    config = yaml.safe_load((folder / "config.yaml").read_text())
    assert (config["seed"], config["num_envs"], config["episodes"]) == (3, 2, 3)
    assert config["task"]["max_episode_steps"] == 5
    overrides = yaml.safe_load((folder / "overrides.yaml").read_text())
    assert overrides[: len(TINY)] == list(TINY)
    command = (folder / "command.txt").read_text().splitlines()[-1]
    assert command.endswith(f"run {' '.join(TINY)} episodes=3 --json")
    versions = json.loads((folder / "versions.json").read_text())
    assert versions["mujoco"].startswith("4.")
    assert "command: " in (folder / "run.log").read_text()


def test_picture_shows_the_scene(finished) -> None:
    _, cwd = finished
    with Image.open(folder_of(cwd) / "scene.png") as picture:
        assert picture.size == (1280, 960)
        assert len(picture.convert("RGB").getcolors(maxcolors=2**24) or ()) > 1000


def test_no_picture_on_request_and_no_return_without_rewards(tmp_path: Path, capsys) -> None:
    root = f"output_dir={tmp_path}"
    assert main(["run", *TINY, "scene_png=false", "record=none", root, "episodes=1"]) == 0
    (summary,) = tmp_path.rglob("summary.json")
    assert not (summary.parent / "scene.png").exists()
    table = capsys.readouterr().out
    assert "metric target_error" in table
    assert "return" not in table


def test_its_log_is_read_and_verified(finished, embodichain) -> None:
    _, cwd = finished
    told = embodichain("replay", "last", "--json", "--env", "1", cwd=cwd)
    assert told.returncode == 0, told.stderr
    data = json.loads(told.stdout)
    assert (data["steps"], data["complete"], data["warnings"]) == (15, True, [])
    assert [(e["env"], e["episode"], e["steps"]) for e in data["episodes"]] == [
        (1, 0, 5),
        (1, 1, 5),
        (1, 2, 5),
    ]
    verified = embodichain("replay", str(folder_of(cwd)), "--verify", cwd=cwd)
    assert verified.returncode == 0, verified.stderr
    assert verified.stdout == "verified: 15 steps of 2 environments are identical to the bit\n"


@pytest.mark.unmeasured
def test_same_seed_same_run(finished, embodichain, tmp_path: Path) -> None:
    """Without a log and with the closing table this time: neither changes what happens."""
    done, _ = finished
    again = embodichain("run", *TINY, "episodes=3", "record=none", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    summary = json.loads((folder_of(tmp_path) / "summary.json").read_text())
    first = json.loads(done.stdout)
    same = ("return", "length", "metrics", "rewards", "control_steps")
    assert {k: summary[k] for k in same} == {k: first[k] for k in same}
    assert not (folder_of(tmp_path) / "rollout.mcap").exists()
    assert "log" not in summary
    assert re.search(r"^ +episodes +6 of 6 \(2 environments\)", again.stdout, re.MULTILINE)
    assert re.search(r"^ +FPS +[\d,]+ environment steps/s", again.stdout, re.MULTILINE)
    assert "random_reach: outputs/" in again.stderr


def test_hydras_run_dir_is_the_run_folder(tmp_path: Path, capsys) -> None:
    line = ["run", "task=cart_pole", "num_envs=1", "max_steps=2", "scene_png=false", "--json"]
    line.append(f"hydra.run.dir={tmp_path / 'mine'}")
    assert main(line) == 0
    assert json.loads(capsys.readouterr().out)["folder"] == str(tmp_path / "mine")
    assert (tmp_path / "mine" / "rollout.mcap").exists()
    assert main(line) == 2
    assert "contains a run already" in (said := capsys.readouterr().err)
    assert "-m hydra.sweep.dir=FOLDER" in said


def test_sweep_runs_each_value_in_its_own_folder(embodichain, tmp_path: Path) -> None:
    swept = ("run", "-m", *TINY[:3], "seed=0,1", "record=none", "hydra/launcher=basic", "--json")
    done = embodichain(*swept, "episodes=1", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    summaries = [json.loads(line) for line in done.stdout.splitlines()]
    assert [s["seed"] for s in summaries] == [0, 1]
    folders = [Path(s["folder"]) for s in summaries]
    assert [f.name for f in folders] == ["0", "1"]
    assert folders[0].parent == folders[1].parent
    assert folders[0].is_relative_to(tmp_path / "outputs" / "sweeps")
    for folder, seed in zip(folders, (0, 1), strict=True):
        assert yaml.safe_load((folder / "config.yaml").read_text())["seed"] == seed


def steps_of(log: Path) -> int:
    """Steps that a growing log can give."""
    try:
        return inspect(log).steps
    except ConfigError:
        return 0  # its beginning is not there yet


@pytest.fixture
def started(commands: Commands, tmp_path: Path):
    """A run without an end, started and given back once its log grows."""
    processes: list[Command] = []

    def start() -> tuple[Command, Path]:
        process = commands.start("run", *TINY, "episodes=1000000", "--json", cwd=tmp_path)
        processes.append(process)
        log = tmp_path / "outputs" / "latest" / "rollout.mcap"
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and process.poll() is None:
            if log.exists() and steps_of(log):
                return process, log.resolve()
            time.sleep(0.05)
        process.kill()
        raise AssertionError(f"no log grew: {process.communicate()}")

    yield start
    for process in processes:
        if process.poll() is None:
            process.kill()
            process.communicate()


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.unmeasured)]
)
def test_interrupted_run_finishes_its_log(started, embodichain, tmp_path: Path, number) -> None:
    process, log = started()
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    summary = json.loads(out)
    assert (summary["status"], summary["signal"]) == ("interrupted", number.name)
    assert summary["control_steps"] > 0
    assert f"interrupted ({number.name})" in err
    assert "Traceback" not in err
    told = embodichain("replay", str(log), "--json", cwd=tmp_path)
    data = json.loads(told.stdout)
    assert (told.returncode, data["complete"], data["warnings"]) == (0, True, [])
    assert data["steps"] == summary["control_steps"]


@pytest.mark.unmeasured  # tests/learning/training/test_resume.py measures such a training
def test_interrupted_training_keeps_what_it_learned(commands: Commands, tmp_path: Path) -> None:
    words = ("task=reach", "num_envs=4", "algo.n_steps=8", "algo.batch_size=16")
    process = commands.start("train", *words, "total_timesteps=100000000", cwd=tmp_path)
    try:
        for line in process.stderr or ():  # progress: it learns by now
            if " steps  steps/s " in line:
                break
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert re.search(r"^ +status +interrupted$", out, re.MULTILINE)
    summary = json.loads((folder_of(tmp_path) / "summary.json").read_text())
    assert summary["env_steps"] > 0
    assert (folder_of(tmp_path) / summary["checkpoint"]).is_file()


@pytest.mark.unmeasured  # what a killed process has measured is lost
def test_killed_run_leaves_a_log_that_reads_up_to_its_end(
    started, embodichain, tmp_path: Path
) -> None:
    process, log = started()
    process.kill()
    process.communicate()
    told = embodichain("replay", str(log), "--json", cwd=tmp_path)
    assert told.returncode == 0, told.stderr
    assert told.stderr.startswith(f"warning: {log}: ")
    steps = json.loads(told.stdout)["steps"]
    assert steps > 0
    verified = embodichain("replay", str(log), "--verify", cwd=tmp_path)
    assert verified.returncode == 1
    assert f"the log ends after step {steps - 1}" in verified.stderr
    assert "Traceback" not in verified.stderr


def test_failed_run_says_one_line_and_keeps_the_traceback(embodichain, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "def explode(obs, env):\n    raise RuntimeError('the policy\\nexploded')\n"
    )
    env = {"PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])}
    done = embodichain("run", *TINY, "policy=mine:explode", "--quiet", cwd=tmp_path, env=env)
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr == (
        "error: RuntimeError: the policy exploded\n(--traceback shows where it happened)\n"
    )
    folder = folder_of(tmp_path)
    assert "in explode" in (folder / "run.log").read_text()
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["status"] == "failed"
    assert "exploded" in summary["error"]
    log = embodichain("replay", "last", "--json", cwd=tmp_path)
    assert json.loads(log.stdout)["complete"] is True

"""`eval`, `play`, `policy=`, exports and resumes where model or MDP is another than in training."""

import json
import shutil
import zipfile
from pathlib import Path

import pytest

from embodichain.cli import main

pytestmark = pytest.mark.slow

TASK = "task=reach"
SMALL = ["task.max_episode_steps=12"]
KEYS = ["record=none", "--json"]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a training of `reach` with episodes of 12 steps, and its policy as ONNX."""
    root = tmp_path_factory.mktemp("trained")
    keys = ["num_envs=4", "total_timesteps=64", "algo.n_steps=8", "algo.batch_size=16", "seed=5"]
    keys += [*SMALL, "eval.episodes=0", f"output_dir={root}"]
    assert main(["train", TASK, "--quiet", *keys]) == 0
    run = next(path.parent for path in root.glob("*/*/config.yaml"))
    assert main(["export", "policy", str(run)]) == 0
    return run


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[str]:
    """The lines that name what changed."""
    assert main(list(arguments)) == 2
    out, err = capsys.readouterr()
    assert out == ""
    lines = err[err.index("error: ") :].splitlines()
    assert "was trained in another task (training -> now):" in lines[0]
    assert lines[-1] == "  allow_changed=true accepts this"
    return [line.strip() for line in lines[1:-1]]


def played(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[dict[str, object], str]:
    assert main(list(arguments)) == 0, capsys.readouterr().err
    out, err = capsys.readouterr()
    return json.loads(out), err


CHANGES = {
    "task.robot.drive_pros.armature=0.25": None,  # one line for each joint
    "task.physics.gravity=[0,0,-5]": ["option: gravity[2] -9.81 -> -5"],
    "task.sim_steps_per_control=5": ["task.sim_steps_per_control 4 -> 5"],
    "task.max_episode_steps=13": ["task.max_episode_steps 12 -> 13"],
    "task.observations.qvel.scale=0.5": ["task.observations.qvel.scale 0.1 -> 0.5"],
    "+task.actions.arm.delay=2": ["task.actions.arm.delay 0 -> 2"],
}


@pytest.mark.parametrize("change", list(CHANGES))
def test_what_changed_is_named(
    trained: Path, capsys: pytest.CaptureFixture[str], change: str
) -> None:
    lines = refused(capsys, "eval", str(trained), "episodes=1", change, *KEYS)
    if CHANGES[change] is not None:
        assert lines == CHANGES[change]
    else:
        assert len(lines) == 6
        assert lines[0].startswith("joint robot/")
        assert {line.partition(": ")[2].split()[0] for line in lines} == {"armature"}
    found, err = played(
        capsys, "eval", str(trained), "episodes=1", change, "allow_changed=true", *KEYS
    )
    assert found["changed"] == lines
    assert err.count("changed since training") == len(lines)


def test_an_evaluation_may_have_its_own_seed_number_and_noise(
    trained: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = ("episodes=3", "num_envs=3", "seed=77", "sim.num_threads=1", "+task.description=mine")
    found, err = played(capsys, "eval", str(trained), *keys, "record=mcap", "--json")
    assert (found["changed"], found["num_envs"]) == ([], 3)
    assert "changed" not in err
    # Rewards are told: a policy acts as before, its return is another number.
    found, err = played(
        capsys, "eval", str(trained), "episodes=1", "task.rewards.distance.weight=-3", *KEYS
    )
    assert found["changed"] == ["task.rewards.distance.weight -1 -> -3"]
    assert "changed since training: task.rewards.distance.weight -1 -> -3" in err


@pytest.mark.parametrize("file", ["checkpoints/final.zip", "policy.onnx"])
def test_every_door_compares(
    trained: Path, here: Path, capsys: pytest.CaptureFixture[str], file: str
) -> None:
    policy = str(trained / file)
    wanted = ["task.max_episode_steps 12 -> 9"]
    changed = "task.max_episode_steps=9"
    assert refused(capsys, "run", TASK, changed, f"policy={policy}", *KEYS) == wanted
    play = ("play", policy, changed, "viewer=none", "--json")
    assert refused(capsys, *play) == wanted
    assert main([*play, "allow_changed=true"]) == 0
    capsys.readouterr()
    assert main(["run", TASK, changed, "--quiet", "policy=zero"]) == 0
    log = next(here.glob("outputs/*/*/rollout.mcap"))
    replay = ["replay", str(log), "--policy", policy, "--quiet"]
    assert refused(capsys, *replay) == wanted
    assert main([*replay, "--allow-changed"]) == 0


def test_exports_and_resumes_compare(
    trained: Path, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wanted = ["option: gravity[2] -9.81 -> -5"]
    export = ("export", "policy", str(trained), "-o", "mine.onnx", "task.physics.gravity=[0,0,-5]")
    assert refused(capsys, *export) == wanted
    assert main([*export, "allow_changed=true"]) == 0
    capsys.readouterr()
    # The file says what its policy was trained in, not what it was exported with.
    assert refused(capsys, "eval", "mine.onnx", TASK, *SMALL, *KEYS, export[-1]) == wanted
    found, _ = played(capsys, "eval", "mine.onnx", TASK, *SMALL, *KEYS, "episodes=1")
    assert found["changed"] == []
    run = shutil.copytree(trained, here / "run")
    config = run / "config.yaml"
    text = config.read_text()
    assert "max_episode_steps: 12" in text
    config.write_text(text.replace("max_episode_steps: 12", "max_episode_steps: 10"))
    resume = ("train", f"resume={run}", "total_timesteps=96", "--quiet")
    assert refused(capsys, *resume) == ["task.max_episode_steps 12 -> 10"]
    assert main([*resume, "allow_changed=true"]) == 0


def test_a_file_without_a_digest_says_so_and_plays(
    trained: Path, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = shutil.copytree(trained, here / "run")
    final = run / "checkpoints/final.zip"
    with zipfile.ZipFile(final) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    data = json.loads(members["data"])
    del data["embodichain"]["trained_in"]
    members["data"] = json.dumps(data).encode()
    with zipfile.ZipFile(final, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    found, err = played(
        capsys, "eval", str(run), "episodes=1", "task.physics.gravity=[0,0,-5]", *KEYS
    )
    assert found["changed"] == []
    assert err.count("does not say what it was trained in: the task is not compared") == 1
    data["embodichain"]["trained_in"] = "{"
    members["data"] = json.dumps(data).encode()
    with zipfile.ZipFile(final, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    assert main(["eval", str(run), "episodes=1", *KEYS]) == 2
    assert "its digest of the task is damaged" in capsys.readouterr().err

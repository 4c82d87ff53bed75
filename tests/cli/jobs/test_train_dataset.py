"""`train dataset=`: logs of runs as demonstrations, and data sets that do not fit."""

import json
from pathlib import Path

import pytest
import yaml

from embodichain.cli import main

pytestmark = pytest.mark.slow

HOLD = ("task=hold_still", "task.max_episode_steps=8", "num_envs=3", "sim.num_threads=1", "seed=1")
BC = ("algo=bc", "total_timesteps=512", "algo.batch_size=64", "algo.validation_share=0.3")


def newest(root):
    return (root / "latest").resolve()


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory):
    """The folder of a run in which every episode is a success."""
    root = tmp_path_factory.mktemp("held")
    assert main(["run", *HOLD, "episodes=1", "scene_png=false", "-q", f"output_dir={root}"]) == 0
    return newest(root)


def mistakes(capsys, *arguments):
    assert main([*arguments, "--json"]) == 2
    return [(m["path"], m["message"]) for m in json.loads(capsys.readouterr().out)["mistakes"]]


def test_a_log_is_cloned_and_played(demonstrations, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(demonstrations.parent)
    given = f"dataset={demonstrations.name}"  # the config keeps the whole path
    assert main(["validate", "--train", *HOLD, *BC, given]) == 0
    words = [*HOLD, *BC, given, "eval.episodes=3", "--json", f"output_dir={tmp_path}"]
    capsys.readouterr()
    assert main(["train", *words]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["demonstrations"], told["episodes"], told["eval"]["episodes"]) == (3, 24, 3)
    run = newest(tmp_path)
    assert yaml.safe_load((run / "config.yaml").read_text())["dataset"] == [str(demonstrations)]
    monkeypatch.chdir(tmp_path)
    assert main(["run", *HOLD, f"policy={run}", "max_steps=3", "record=none", "-q"]) == 0


def test_replay_buffer_begins_with_a_log(demonstrations, tmp_path):
    sac = ("algo=sac", "algo.buffer_size=100", "total_timesteps=6", "eval.episodes=0")
    given = (f"dataset={demonstrations}", f"output_dir={tmp_path}", "-q")
    assert main(["train", *HOLD, *sac, *given]) == 0
    log = (newest(tmp_path) / "run.log").read_text()
    assert "the replay buffer begins with 24 transitions, of 3 demonstrations" in log


def test_data_sets_that_do_not_fit(demonstrations, tmp_path, capsys):
    given = f"dataset={demonstrations}"
    changed = [word.replace("=8", "=9") for word in HOLD]
    found = mistakes(capsys, "validate", "--train", *changed, *BC, given)
    assert len(found) == 1 and found[0][0] == "dataset"
    assert "was recorded in another task (recording -> now):" in found[0][1]
    assert main(["validate", "--train", *changed, *BC, given, "allow_changed=true"]) == 0
    capsys.readouterr()
    (found,) = mistakes(capsys, "validate", "--train", "task=reach", *BC, given, "num_envs=2")
    assert "was recorded in another task" in found[1]

    main(["run", *HOLD, "policy=random", "scene_png=false", "-q", f"output_dir={tmp_path}"])
    failed = newest(tmp_path)
    capsys.readouterr()
    before = sorted(Path(failed).iterdir())
    words = [*HOLD, *BC, f"dataset={failed}", f"output_dir={tmp_path}"]
    assert main(["train", *words]) == 2
    assert "none of its 3 episodes succeeded" in capsys.readouterr().err
    assert sorted(Path(failed).iterdir()) == before


def test_a_log_under_variations_is_cloned(tmp_path, capsys):
    varied = [*HOLD, "variation=mass", "task.variations.mass.strength=0.1"]
    assert main(["run", *varied, "scene_png=false", "-q", f"output_dir={tmp_path}"]) == 0
    given = f"dataset={newest(tmp_path)}"
    capsys.readouterr()
    assert main(["validate", "--train", *HOLD, *BC, given]) == 0, capsys.readouterr().err
    assert "variations change what was in recording: task.events.robot_mass_" in (
        capsys.readouterr().err
    )
    assert main(["validate", "--train", *varied, *BC, given]) == 0
    assert "variations change" not in capsys.readouterr().err
    changed = [word.replace("=8", "=9") for word in HOLD]
    (mistake,) = mistakes(capsys, "validate", "--train", *changed, *BC, given)
    assert "max_episode_steps 8 -> 9" in mistake[1]

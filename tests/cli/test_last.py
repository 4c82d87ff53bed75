"""`last`: which run it is, after refusals, evaluations and sweeps."""

import os
from pathlib import Path

import pytest

from embodichain.cli.app import main

SHORT = ["num_envs=2", "task.max_episode_steps=20", "record=none", "-q"]
TRAIN = ["train", "task=cart_pole", "total_timesteps=64", "algo.n_steps=16", *SHORT]


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def folders():
    return sorted(str(path) for path in Path("outputs").glob("2*/*"))


def latest():
    return str(Path("outputs/latest").resolve().relative_to(Path.cwd()))


def test_a_refused_command_leaves_no_folder(capsys):
    refused = ["run", "task=cart_pole", "policy=embodichain.none:none", *SHORT]
    assert main(refused) == 2
    assert not Path("outputs").exists()
    assert main(["run", "task=cart_pole", "episodes=1", *SHORT]) == 0
    one = folders()
    assert len(one) == 1 and latest() == one[0]
    target = os.readlink("outputs/latest")
    # Refused when it is built: the policy is of another task.
    assert main(["train", "task=cart_pole", "total_timesteps=32", "algo.n_steps=16", *SHORT]) == 0
    two = folders()
    assert main(["eval", "last", "task=reach", "num_envs=1", "record=none", "-q"]) == 2
    assert "cart_pole" in capsys.readouterr().err
    assert folders() == two and len(two) == 2
    assert latest() != one[0] and os.readlink("outputs/latest") != target


def test_verbs_say_which_run_last_is_and_the_report_shows_all(capsys):
    assert main([*TRAIN, "eval.episodes=0"]) == 0
    (trained,) = folders()
    capsys.readouterr()
    loud = [word for word in SHORT[1:] if word != "-q"]
    assert main(["eval", "last", "episodes=2", *loud]) == 0
    assert f"last: {trained}\n" in capsys.readouterr().err
    evaluated = next(path for path in folders() if path != trained)
    assert main(["report", "last"]) == 0
    assert capsys.readouterr().err == f"last: {evaluated}\n"
    page = Path(evaluated, "report.html").read_text(encoding="utf-8")
    assert "Training of the policy" in page and f"embodichain report {trained}" in page
    assert "n updates" in page or "env steps" in page
    assert f"embodichain eval {trained} episodes=2" in page
    assert "eval last" not in page
    assert main(["run", "task=cart_pole", "policy=last", "episodes=1", *loud]) == 0
    err = capsys.readouterr().err
    assert f"last: {trained}\n" in err
    assert "episodes of 1 environment" in err or "episodes of " in err
    played = latest()
    assert f"policy={trained}" in Path(played, "command.txt").read_text()


def test_after_a_sweep_last_is_the_sweep(capsys):
    words = [word for word in TRAIN if word != "-q"]
    assert main([*words, "-m", "seed=1,2", "eval.episodes=0", "-q"]) == 0
    capsys.readouterr()
    assert main(["compare", "last", "--json"]) == 0
    said = capsys.readouterr()
    assert '"seeds": [1, 2]' in said.out
    assert said.err.startswith("last: outputs/sweeps/") and said.err.count("\n") == 1
    assert main(["report", "last"]) == 0
    assert capsys.readouterr().err == said.err

"""`last`: which run it is, after refusals, evaluations and sweeps."""

import os
from pathlib import Path

import pytest

from embodichain.cli.app import main

pytestmark = pytest.mark.slow

SHORT = ["num_envs=2", "task.max_episode_steps=20", "record=none", "-q"]
TRAIN = ["train", "task=cart_pole", "total_timesteps=64", "algo.n_steps=16", "eval.episodes=0"]
TRAIN += SHORT


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
    assert main(TRAIN) == 0
    two = folders()
    assert main(["eval", "last", "task=reach", "num_envs=1", "record=none", "-q"]) == 2
    assert "cart_pole" in capsys.readouterr().err
    assert folders() == two and len(two) == 2
    assert latest() != one[0] and os.readlink("outputs/latest") != target


def test_verbs_say_which_run_last_is_and_the_report_shows_all(capsys):
    assert main(TRAIN) == 0
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
    sweep = ["-m", "seed=1,2", "hydra/launcher=basic"]
    assert main([*words, *sweep, "-q"]) == 0
    capsys.readouterr()
    assert main(["compare", "last", "--json"]) == 0
    said = capsys.readouterr()
    assert '"seeds": [1, 2]' in said.out
    assert said.err.startswith("last: outputs/sweeps/") and said.err.count("\n") == 1
    assert main(["report", "last"]) == 0
    assert capsys.readouterr().err == said.err


SIDE = "+task.rewards.side={func: position, weight: 1, params: {of: {uid: cart_pole}}}"


@pytest.mark.parametrize("where", ["hydra.run.dir=a/b/c", "output_dir=a/b/c", "hydra.run.dir=mine"])
def test_a_refusal_while_building_leaves_a_given_folder_as_it_was(where, capsys):
    Path("mine").mkdir()
    Path("mine/notes").touch()
    before = sorted(Path().rglob("*"))
    words = ["run", "task=cart_pole", "episodes=1", where, *SHORT]
    for _ in range(2):  # the second is no run in a used folder
        assert main([*words, SIDE]) == 2
        said = capsys.readouterr().err
        assert said.startswith("error: command line: task.rewards.side.shape: ")
        assert sorted(Path().rglob("*")) == before
    assert main(words) == 0
    assert Path("mine/notes").exists()
    assert len(list(Path().rglob("summary.json"))) == 1


def test_a_folder_named_by_the_time_is_the_only_one(capsys):
    words = ["run", "task=cart_pole", "episodes=1", "hydra.run.dir=x/${now:%H-%M-%S-%f}", *SHORT]
    before = sorted(Path().iterdir())
    assert main([*words, SIDE]) == 2
    assert sorted(Path().iterdir()) == before
    assert main(words) == 0
    assert len(list(Path("x").iterdir())) == 1


def test_validate_and_show_say_which_run_last_is(capsys):
    assert main(TRAIN) == 0
    (trained,) = folders()
    capsys.readouterr()
    loud = [word for word in SHORT[:-1] if word != "record=none"]
    for words in (["validate"], ["show", "--config"]):
        assert main([*words, "task=cart_pole", "policy=last", *loud]) == 0
        said = capsys.readouterr()
        assert f"last: {trained}\n" in said.err
    assert f"policy: {Path(trained).resolve()}\n" in said.out

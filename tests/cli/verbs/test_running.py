"""A run that is still going is not called damaged or unfinished."""

from pathlib import Path

import pytest

from embodichain.cli import main
from embodichain.cli.pages.run_record import read_record
from embodichain.config.run_folder import is_running, marked_as_running

WORDS = ("task=cart_pole", "num_envs=1", "episodes=1", "seed=1", "scene_png=false", "--quiet")
LOOKING = """\
from pathlib import Path

import torch

from embodichain.config.run_folder import is_running


def looking(obs, env):
    Path("running.txt").write_text(str(is_running("run")))
    return torch.zeros(env.action_space.shape)
"""


def test_a_log_that_is_being_written(empty_cwd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", *WORDS, "policy=zero", "hydra.run.dir=run"]) == 0
    folder = Path("run")
    log = folder / "rollout.mcap"
    log.write_bytes(log.read_bytes()[:-200])  # as if it was not closed yet
    (folder / "summary.json").unlink()
    capsys.readouterr()
    with marked_as_running(folder):
        assert read_record(folder).status == "running"
        assert main(["replay", "run", "--verify"]) == 1
        err = capsys.readouterr().err
        assert "the run is still going: verify its log when it has ended (" in err
        assert "NOT verified" not in err
        assert main(["replay", "run"]) == 0
        out, err = capsys.readouterr()
        assert "the run is still going; this is what it has written so far" in err
        assert "not complete yet" in out
        assert "ends early" not in out + err
        log.write_bytes(log.read_bytes()[:-1000])  # in the middle of a record
        assert main(["replay", "run", "--verify"]) == 1
        err = capsys.readouterr().err
        assert "the run is still going" in err and "NOT verified" not in err
        assert main(["report", "."]) == 0
        page = Path("index.html").read_text()
        assert '<span class="badge">running</span>' in page
    assert read_record(folder).status == "unfinished"
    capsys.readouterr()
    assert main(["replay", "run", "--verify"]) == 1
    assert "the file ends early" in capsys.readouterr().err


def test_a_run_says_that_it_is_running(empty_cwd: Path) -> None:
    Path("my_looking_policy.py").write_text(LOOKING)
    words = [*WORDS, "policy=my_looking_policy:looking", "record=none", "hydra.run.dir=run"]
    assert main(["run", *words]) == 0
    assert Path("running.txt").read_text() == "True"
    assert not is_running("run")
    assert not list(Path("run").glob(".*"))

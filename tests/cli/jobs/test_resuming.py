"""``resume=RUN``: which keys may change, and which run is meant; for trainings and collections."""

import os
from pathlib import Path
from typing import Any

import pytest

from embodichain.cli import main
from embodichain.cli.jobs.resuming import (
    find_resumed_folder,
    parse_changes,
    resuming_overrides,
    with_changes,
)
from embodichain.cli.verb import JobOptions
from embodichain.utils.errors import ConfigError

pytestmark = pytest.mark.slow


def options(*words: str, **flags: Any) -> JobOptions:
    return JobOptions(words=words, **flags)


def test_changes_are_read_in_hydras_grammar() -> None:
    words = ["episodes=1_000", "collect.give_up_after=null", "record=none", "sim={num_threads: 2}"]
    changes = parse_changes(words, ("episodes", "collect"), "a resumed collection")
    assert changes == {
        "episodes": 1000,
        "collect.give_up_after": None,
        "record": "none",
        "sim": {"num_threads": 2},
    }


@pytest.mark.parametrize(
    ("word", "says"),
    [
        ("seed=3", "seed: a resumed training keeps its config; what may change: total_timesteps"),
        ("task.physics.dt=1", "task.physics.dt: a resumed training keeps its config"),
        ("~eval", "a resumed training takes no deletions and no sweeps: '~eval'"),
        ("eval.episodes=1,2", "no sweeps: 'eval.episodes=1,2'"),
    ],
)
def test_what_may_not_change_is_said(word: str, says: str) -> None:
    with pytest.raises(ConfigError) as error:
        parse_changes([word], ("total_timesteps", "eval"), "a resumed training")
    assert says in str(error.value)


def test_every_key_that_may_not_change_is_said() -> None:
    with pytest.raises(ConfigError) as error:
        parse_changes(["seed=3", "policy=zero", "episodes=4"], ("episodes",), "a resumed run")
    assert [problem.path for problem in error.value.problems] == ["seed", "policy"]


def test_changes_are_put_into_a_copy() -> None:
    tree = {"record": {"format": "mcap", "every": 1}, "episodes": 3, "video": None}
    changes = {"record": "none", "episodes": 4, "video.every": 2, "record.every": 5}
    assert with_changes(tree, changes) == {
        "record": {"format": "none", "every": 5},
        "episodes": 4,
        "video": {"every": 2},
    }
    assert tree == {"record": {"format": "mcap", "every": 1}, "episodes": 3, "video": None}


def test_a_command_without_resume_resumes_nothing() -> None:
    assert resuming_overrides(options("task=reach", "episodes=3")) is None


@pytest.mark.parametrize(
    ("words", "flags"),
    [
        (("resume=last",), {"multirun": True}),
        (("resume=last", "hydra.run.dir=here"), {}),
        (("resume=last",), {"cfg": "job"}),
        (("resume=last",), {"gym_config": "gym.yaml"}),
    ],
)
def test_one_run_is_resumed_at_a_time(words: tuple[str, ...], flags: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="resume continues one run: no --multirun"):
        resuming_overrides(options(*words, **flags))


def test_the_folder_that_is_meant(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    with pytest.raises(ConfigError, match="is not a collection's folder: it has no config.yaml"):
        find_resumed_folder(str(run), None, "collection")
    (run / "config.yaml").touch()
    assert find_resumed_folder(str(run), None, "collection") == run
    assert find_resumed_folder(os.path.relpath(run), None, "collection") == run
    assert find_resumed_folder("last", run, "collection") == run
    with pytest.raises(ConfigError, match="there is no collection to resume yet"):
        find_resumed_folder("last", None, "collection")


@pytest.mark.parametrize("verb", ["train", "collect"])
def test_verbs_resume_only_their_own(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["task=reach", "policy=zero", "num_envs=1", "max_steps=2", "record=none", "--quiet"]
    assert main(["run", *words, "scene_png=false"]) == 0
    assert main([verb, "resume=last"]) == 2
    assert f"there is no {'training' if verb == 'train' else verb + 'ion'}" in (
        capsys.readouterr().err
    )
    assert main([verb, "resume=outputs/latest"]) == 2
    assert main([verb, "resume=outputs/latest", "-m"]) == 2
    assert "resume continues one run" in capsys.readouterr().err

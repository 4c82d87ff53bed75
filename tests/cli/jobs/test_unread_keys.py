"""Keys that a verb does not read are refused by every verb that takes keys; others are taken."""

from pathlib import Path

import pytest
import yaml

from embodichain.cli import main
from embodichain.cli.jobs.unread_keys import refuse_unread
from embodichain.utils.errors import ConfigError

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("run task=reach resume=last", "resume: `run` does not read it"),
        ("collect task=reach algo=sac", "algo: `collect` does not read it: a policy is played"),
        ("collect task=reach total_timesteps=9", "total_timesteps: `collect` does not read it"),
        ("collect task=reach eval.episodes=9", "eval.episodes: `collect` does not read it"),
        ("collect task=reach scene_png=true", "scene_png: `collect` does not read it"),
        ("collect -m task=reach seed=1,2 wandb.project=a", "wandb.project: `collect` does not"),
        ("train task=reach policy=zero", "policy: `train` does not read it: it learns one"),
        ("train task=reach scene_png=false", "scene_png: `train` does not read it"),
        ("bench task=reach episodes=9", "episodes: `bench` does not read it: it measures"),
        ("bench task=reach record.every=2", "record.every: `bench` does not read it: it writes no"),
        ("bench task=reach algo=ppo", "algo: `bench` does not read it"),
        ("render task=reach a.png max_steps=9", "max_steps: `render` does not read it: it draws"),
        ("render task=reach a.png viewer=web", "viewer: `render` does not read it"),
        ("render task=reach a.png video=true", "video: `render` does not read it"),
        ("bench task=reach viewer=web", "viewer: `bench` does not read it: it shows nothing"),
        ("demo reach --web algo=sac", "algo: `demo` does not read it: a policy is played"),
        ("demo reach --film collect.wait_steps=9", "collect.wait_steps: `demo` does not read it"),
        ("demo reach --web record=mcap", "record: a page does not read it, `embodichain demo"),
        ("validate --train task=reach max_steps=9", "max_steps: `train` does not read it"),
        ("validate --train task=reach policy=zero", "policy: `train` does not read it"),
        ("validate --collect task=reach eval.episodes=9", "eval.episodes: `collect` does not"),
    ],
)
def test_it_is_refused_and_nothing_is_written(
    words: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words.split()) == 2
    err = capsys.readouterr().err
    assert says in err and "Traceback" not in err
    assert not list(Path().iterdir())  # tests run in an empty folder


def test_all_of_them_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "task=reach", "algo.gamma=1", "+resume=a", "video=true"]) == 2
    err = capsys.readouterr().err
    assert all(f"{key}: `bench` does not read it" in err for key in ("algo.gamma", "video"))
    assert "resume: `bench` does not read it" in err


@pytest.mark.parametrize(
    "words",
    [
        "validate task=reach algo=sac total_timesteps=5000 max_steps=9 collect.wait_steps=2",
        "validate --train task=reach algo=sac total_timesteps=5000 eval.episodes=3",
        "validate --collect task=pick_place policy=zero collect.wait_steps=2 max_steps=9",
        "show task=reach algo=sac eval.episodes=3 record=none --config",
        "bench task=cart_pole num_envs=1 --rounds 1 policy=zero seed=1 device=cpu sim=default",
    ],
)
def test_what_is_read_is_taken(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words.split()) == 0, capsys.readouterr().err


def test_an_algorithm_is_checked_and_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", "task=reach", "algo=sac", "algo.clip_range=0.1"]) == 2
    assert "clip_range" in capsys.readouterr().err  # SAC has none
    assert main(["show", "task=reach", "algo=sac", "algo.gamma=0.5", "--config"]) == 0
    shown = yaml.safe_load(capsys.readouterr().out)["algo"]
    assert (shown["name"], shown["gamma"]) == ("sac", 0.5)


READ = {
    "run": "task sim record viewer num_envs seed device episodes max_steps policy allow_changed"
    " trust video scene_png gym_config output_dir quiet json traceback",
    "eval": "task sim record viewer num_envs seed device episodes allow_changed trust video"
    " output_dir gym_config deterministic quiet",
    "play": "task sim record viewer num_envs seed device episodes max_steps allow_changed trust"
    " video scene_png gym_config output_dir quiet",
    "train": "task sim record viewer algo num_envs seed device total_timesteps allow_changed"
    " dataset resume checkpoint eval wandb video gym_config output_dir quiet",
    "collect": "task sim record viewer num_envs seed device episodes max_steps policy resume"
    " allow_changed trust collect video gym_config output_dir quiet",
    "demo": "task sim record viewer num_envs seed device episodes max_steps policy allow_changed"
    " trust video scene_png gym_config output_dir quiet",
    "demo --web": "task sim viewer num_envs seed device episodes policy allow_changed trust"
    " output_dir",
    "bench": "task sim num_envs seed device policy allow_changed trust output_dir gym_config",
    "render": "task sim seed device policy allow_changed trust output_dir gym_config",
    "export policy": "task sim allow_changed trust output_dir gym_config",
}
"""Verb -> root keys that have an effect on it."""


@pytest.mark.parametrize("verb", READ)
def test_no_key_that_is_read_is_refused(verb: str) -> None:
    words = [f"{key}=x" for key in READ[verb].split()]
    nested = ["task.events.push.params.policy=1", "~task.rewards.eval", "experiment=mine"]
    refuse_unread(verb, [*words, *nested, "sim.engine=warp", "hydra.sweep.dir=collect"])


def test_export_of_a_policy(capsys: pytest.CaptureFixture[str]) -> None:
    Path("mine.zip").write_bytes(b"")
    for key in ("algo=sac", "policy=zero", "record=none", "episodes=2", "viewer=web"):
        with pytest.raises(ConfigError, match="`export policy` does not read it"):
            refuse_unread("export policy", [key])
        assert main(["export", "policy", "mine.zip", "task=reach", key]) == 2
        assert "`export policy` does not read it" in capsys.readouterr().err

"""Trained policies under variations: what those draw is allowed, and said; columns are not."""

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

import embodichain
from embodichain.cli import main
from embodichain.learning.policies.policy import load_policy
from embodichain.utils.errors import ConfigError

pytestmark = pytest.mark.slow

SMALL = ["num_envs=4", "total_timesteps=64", "algo.n_steps=8", "algo.batch_size=16", "seed=5"]
TRAIN = ["train", "task=reach", "--quiet", "eval.episodes=0", "task.max_episode_steps=12", *SMALL]
EVAL = ["episodes=4", "record=none", "--json"]
MASS = "task.events.robot_mass_robot"


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a training without variations."""
    root = tmp_path_factory.mktemp("trained")
    assert main([*TRAIN, f"hydra.run.dir={root / 'run'}"]) == 0
    return root / "run"


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def evaluated(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[dict[str, Any], str]:
    """The content of `eval.json`, and what was said."""
    assert main(["eval", *words, *EVAL]) == 0, capsys.readouterr().err
    out, err = capsys.readouterr()
    return json.loads(out), err


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["eval", *words, *EVAL]) == 2
    return capsys.readouterr().err


def events_of(result: dict[str, Any]) -> dict[str, Any]:
    """The events of the task in which a policy was evaluated."""
    config = yaml.safe_load((Path(result["folder"]) / "config.yaml").read_text())
    return dict(config["task"]["events"])


def test_a_run_is_evaluated_under_variations(
    trained: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clean, err = evaluated(capsys, str(trained))
    assert (clean["changed"], "variations" in err) == ([], False)
    varied = [str(trained), "variation=[mass,noise,delay]"]
    found, err = evaluated(capsys, *varied)
    assert f"{MASS} none -> randomize" in found["changed"]
    assert "task.actions.arm.delay none -> [0, 2]" in found["changed"]
    assert f"variations change what was in training: task.actions.arm.delay, {MASS}" not in err
    (said,) = [line for line in err.splitlines() if "variations change" in line]
    assert MASS in said
    assert "task.observations.qpos.noise" in said
    assert found["per_episode"]["return"] != clean["per_episode"]["return"]
    # At strength 0 the episodes are those without variations.
    weak = [f"task.variations.{name}.strength=0" for name in ("mass", "noise", "delay")]
    found, _ = evaluated(capsys, *varied, *weak)
    assert found["per_episode"]["return"] == clean["per_episode"]["return"]


def test_every_door_takes_variations(
    trained: Path, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    task = ["task=reach", "task.max_episode_steps=12"]
    half = ["variation=mass", "task.variations.mass.strength=0.5"]
    file = str(trained / "checkpoints/final.zip")
    found, _ = evaluated(capsys, file, *task, *half)
    assert found["changed"] == [f"{MASS} none -> randomize"]
    assert events_of(found)["robot_mass_robot"]["strength"] == 0.5
    assert main(["run", *task, *half, f"policy={file}", "--quiet", "record=none"]) == 0
    assert f"variations change what was in training: {MASS}" in capsys.readouterr().err
    assert main(["play", str(trained), *half, "viewer=none", "--quiet", "record=none"]) == 0
    assert f"variations change what was in training: {MASS}" in capsys.readouterr().err
    env = embodichain.make("reach", overrides=[*task[1:], *half])
    try:
        (change,) = load_policy(file, env).changed
    finally:
        env.close()
    assert str(change) == f"{MASS} none -> randomize"


def test_policies_that_ship_take_variations(capsys: pytest.CaptureFixture[str]) -> None:
    found, err = evaluated(
        capsys, "pretrained", "task=press_button", "variation=[clutter,friction]"
    )
    assert "body clutter_can none -> here" in found["changed"]
    assert "variations change what was in training: body clutter_can" in err
    assert "changed since training" not in err


def test_what_else_differs_is_refused_as_without_variations(
    trained: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = ["task.observations.qvel.scale=0.5", "+task.actions.arm.delay=2"]
    err = refused(capsys, str(trained), "variation=mass", *wrong)
    lines = [line.strip() for line in err[err.index("error: ") :].splitlines()[1:-1]]
    assert sorted(lines) == [
        "task.actions.arm.delay 0 -> 2",
        "task.observations.qvel.scale 0.1 -> 0.5",
    ]


def test_a_training_with_a_variation_is_evaluated_at_other_strengths_and_without(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = here / "run"
    half = ["variation=mass", "task.variations.mass.strength=0.5"]
    assert main([*TRAIN, *half, f"hydra.run.dir={run}"]) == 0
    capsys.readouterr()
    found, err = evaluated(capsys, str(run))
    assert events_of(found)["robot_mass_robot"]["strength"] == 0.5
    assert found["changed"] == []
    found, err = evaluated(capsys, str(run), "variation=mass")
    assert found["changed"] == [f"{MASS}.strength 0.5 -> 1"]
    assert "strength" not in events_of(found)["robot_mass_robot"]
    assert "takes the place of what the run has of it: robot_mass_robot" in err
    clean = ["task=reach", "task.max_episode_steps=12"]
    found, err = evaluated(capsys, str(run), *clean)
    assert found["changed"] == [f"{MASS} randomize -> none"]
    assert "robot_mass_robot" not in events_of(found)


def test_mistakes_in_variations_of_a_run_are_reported_once(
    trained: Path, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = str(trained)
    err = refused(capsys, run, "variation=mas")
    assert "variation: unknown option 'mas'" in err
    assert "Did you mean 'mass'?" in err
    err = refused(capsys, run, "task.variations.mass.strength=0.5")
    assert "no such variation is chosen" in err
    folder = here / "conf" / "variation"
    folder.mkdir(parents=True)
    dim = {"events": {"dim": {"func": "randomize_light", "params": {"of": {"uid": "sun"}}}}}
    (folder / "lost.yaml").write_text(yaml.safe_dump(dim))
    assert "its first line must be `# @package task.variations.lost`" in refused(
        capsys, run, "variation=lost"
    )
    wrong = {"events": {"dim": {"func": "randomize_lights"}}}
    (folder / "dim.yaml").write_text("# @package task.variations.dim\n" + yaml.safe_dump(wrong))
    err = refused(capsys, run, "variation=dim")
    assert "conf/variation/dim.yaml:4: task.events.dim" in err
    again = {"actions": {"arm": {"delay": 1}}}
    (folder / "late.yaml").write_text("# @package task.variations.late\n" + yaml.safe_dump(again))
    err = refused(capsys, run, "variation=[late,delay]")
    assert err.count("task.actions.arm.delay is set already (conf/variation/late.yaml:4)") == 1


def test_a_policy_does_not_fit_another_environment(trained: Path) -> None:
    """A variation is allowed where the environment says that it was chosen."""
    env = embodichain.make("reach", overrides=["task.max_episode_steps=13", "variation=mass"])
    try:
        with pytest.raises(ConfigError, match="max_episode_steps 12 -> 13"):
            load_policy(trained, env)
    finally:
        env.close()


def test_a_log_under_variations_is_repeated_by_a_policy(
    trained: Path, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    task = ["task=reach", "task.max_episode_steps=12", "seed=3"]
    run = here / "varied"
    words = [*task, "variation=[mass,delay]", "policy=zero", "--quiet"]
    assert main(["run", *words, f"hydra.run.dir={run}"]) == 0
    capsys.readouterr()
    assert main(["replay", str(run), "--policy", str(trained)]) == 0, capsys.readouterr().err
    err = capsys.readouterr().err
    assert "variations change what was in training: task.actions.arm.delay" in err
    assert MASS in err
    # What no variation has set is refused as without variations.
    words = [*words, "task.observations.qvel.scale=0.5"]
    run = here / "other"
    assert main(["run", *words, f"hydra.run.dir={run}"]) == 0
    capsys.readouterr()
    assert main(["replay", str(run), "--policy", str(trained)]) == 2
    refusal = capsys.readouterr().err
    assert "task.observations.qvel.scale 0.1 -> 0.5" in refusal
    assert MASS not in refusal


def test_a_log_lists_what_variations_have_set(here: Path) -> None:
    for words, expected in (([], frozenset()), (["variation=mass"], {MASS})):
        env = embodichain.make("reach", overrides=words)
        path = here / f"{len(words)}.mcap"
        env.add_observer(embodichain.recording.McapRecorder(path, env))
        env.close()
        with embodichain.recording.open(path) as log:
            assert log.varied == expected
            assert ("varied.yaml" in log.attachments) == bool(words)

"""`new` for an arm whose URDF has limits of 0, as CAD exporters write it."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import pytest
import yaml

import embodichain
from embodichain.cli import main
from embodichain.cli.new_task import task_kinds
from embodichain.cli.new_task.task_trials import Trial
from tests.helpers.cad_robots import clamp_arm

pytestmark = [pytest.mark.unmeasured]

JOINTS = [*(f"Revolute_{i}" for i in range(1, 6)), "Slider_1", "Slider_2"]


@pytest.fixture(autouse=True)
def arm(empty_cwd: Path) -> None:
    """The arm's file lies in the working directory."""
    Path("arm.urdf").write_text(clamp_arm())


def new(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert main(["new", *words, "--robot", "arm.urdf", "--json"]) == 0, capsys.readouterr().err
    facts: dict[str, Any] = json.loads(capsys.readouterr().out)
    return facts


def drives_of(capsys: pytest.CaptureFixture[str]) -> tuple[Any, str]:
    """The `drive_pros` of a new embodiment, and what they were guessed from."""
    facts = new(capsys, "embodiment", "mine")
    robot = yaml.safe_load(Path("conf/embodiment/mine.yaml").read_text())["robot"]
    Path("conf/embodiment/mine.yaml").unlink()
    (why,) = (guess["why"] for guess in facts["guessed"] if guess["key"] == "drive_pros")
    return robot["drive_pros"], why


def try_nothing(monkeypatch: pytest.MonkeyPatch, trial: Trial, other_file: str = "") -> None:
    """Let the trial of an expert end so, while another command writes the embodiment."""

    def end(*_: object) -> Trial:
        if other_file:
            path = Path("conf/embodiment/arm.yaml")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(other_file)
        return trial

    monkeypatch.setattr(task_kinds, "try_expert", end)


@pytest.mark.slow
def test_an_arm_without_limits_picks(
    capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    facts = new(capsys, "task", "mine", "--kind", "pick")
    (drives,) = (guess for guess in facts["guessed"] if guess["key"] == "drive_pros")
    assert drives["value"] == "{stiffness: 500, damping: 50, max_effort: 50}"
    several = "(Revolute_1, Revolute_2, Revolute_3 and 4 more)"
    assert f"efforts of 0, which are no limits {several}" in drives["why"]
    assert f"velocities of 0 {several}" in drives["why"]
    assert facts["expert"]["success"] >= 0.9
    assert facts["next"][-1] == "embodichain train task=mine"
    from embodichain.lab.gym.policies import resolve_policy

    with caplog.at_level(logging.WARNING, "embodichain"):
        env = embodichain.make("mine", 2, ["seed=1"])
        obs, _ = env.reset()
        resolve_policy("expert")(obs, env)
        env.close()
    notes = {record.message for record in caplog.records if "velocity" in record.message}
    (note,) = notes
    assert 'velocity="0" is taken as no limit for joints Revolute_1, Revolute_2' in note
    assert "3.14 rad/s" in note


def test_limits_of_the_file_are_taken(capsys: pytest.CaptureFixture[str]) -> None:
    """Also those of some joints, where others have none: these get what bears their weight.

    Stretched, the upper arm bears 0.78 kg m; it is ten times as heavy here, and holds that twice.
    """
    Path("arm.urdf").write_text(clamp_arm(effort=60, velocity=3))
    drives, why = drives_of(capsys)
    assert drives["max_effort"] == "file"
    assert "of 0" not in why
    text = clamp_arm(effort=60, velocity=3, scale=10)
    Path("arm.urdf").write_text(text.replace('effort="60"', 'effort="0"', 2))
    drives, why = drives_of(capsys)
    limits = drives["max_effort"]
    assert limits.pop("Revolute_1") >= limits["Revolute_2"]
    assert limits.pop("Revolute_2") == pytest.approx(2 * 9.81 * 7.8, rel=0.05)
    assert limits == dict.fromkeys(JOINTS[2:], 60)
    assert "(Revolute_1, Revolute_2)" in why


def test_an_expert_that_fails_is_a_warning(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    try_nothing(monkeypatch, Trial(0.25, "step 2, move_to goal: the gripper has lost cube", 30))
    words = ["new", "task", "mine", "--kind", "pick", "--robot", "arm.urdf"]
    assert main(words) == 0
    printed = capsys.readouterr()
    assert "warning: the task's own expert succeeds in only 25 % of 48 episodes" in printed.err
    assert "most often (30 times): step 2, move_to goal: the gripper has lost cube" in printed.err
    assert "embodichain run task=mine policy=expert video=true" in printed.err
    assert "embodichain train" not in printed.out


def test_two_kinds_at_the_same_time_share_an_embodiment(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "robot: {uid: robot, fpath: arm.urdf}\n"
    try_nothing(monkeypatch, Trial(1.0), other_file=text)
    facts = new(capsys, "task", "mine", "--kind", "push")
    assert facts["expert"] == {"success": 1, "failure": "", "failure_count": 0}
    assert facts["wrote"] == ["conf/task/mine.yaml", "tests/test_mine.py"]
    assert facts["guessed"][0]["key"] == "embodiment"
    assert Path("conf/embodiment/arm.yaml").read_text() == text


def test_another_robot_of_that_name_is_not_taken(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    try_nothing(monkeypatch, Trial(1.0), other_file="robot: {uid: robot, fpath: other/arm.urdf}\n")
    assert main(["new", "task", "mine", "--kind", "push", "--robot", "arm.urdf"]) == 2
    assert "files exist, and are never replaced: conf/embodiment" in capsys.readouterr().err
    assert not Path("conf/task/mine.yaml").exists()


def test_a_task_without_a_kind_names_its_guesses(capsys: pytest.CaptureFixture[str]) -> None:
    facts = new(capsys, "task", "mine")
    guesses = {guess["key"]: guess["value"] for guess in facts["guessed"]}
    task = yaml.safe_load(Path("conf/task/mine.yaml").read_text())
    assert json.loads(guesses["robot.init_qpos"]) == task["robot"]["init_qpos"]
    assert guesses["tool"] == "link Plate"
    assert yaml.safe_load(guesses["robot.drive_pros"]) == task["robot"]["drive_pros"]
    assert task["robot"]["drive_pros"]["max_effort"] == 50
    assert "within" in guesses["marker"]
    assert facts["physics_dt"] == task["physics"]["physics_dt"]
    assert facts["next"][-1] == "embodichain train task=mine"

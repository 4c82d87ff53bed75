"""`validate` says every mistake in one round: those of reading, of building, of first values.

Each config has mistakes of several stages. All of them are expected, by their key paths, and
nothing else: what follows from one of them is no mistake of its own.
"""

from pathlib import Path
from typing import Any

import pytest

from embodichain.cli import main
from embodichain.utils.errors import ConfigError
from embodichain.utils.system import video

pytestmark = pytest.mark.slow

PUSH = """\
defaults: [push_cube, _self_]
sensors:
  wrist: {sensor_type: camera, width: 48, height: 48, fov: 60}
events:
  colours:
    func: randomize_visual_material
    params: {entity_cfg: {uid: cube}}
  mass:
    func: randomise_masses
    params: {entity_cfg: {uid: cubee}}
observations:
  fast: {func: joint_velocity, scale: [1, 2], params: {of: {uid: robot}}}
rewards:
  reach: {weigth: 0.2}
  near:
    func: distance
    weight: 1
    params: {from: {uid: robot, site: tcp}, to: {uid: cube}}
  side: {func: position, weight: 1, params: {of: {uid: cube}}}
"""
IN_PUSH = {
    "task.sensors.wrist.fov",
    "task.events.colours.params.base_color_range",
    "task.events.mass.func",
    "task.events.mass.params.entity_cfg.uid",
    "task.observations.fast.scale",
    "task.rewards.reach.weigth",
    "task.rewards.near.params.from.site",
    "task.rewards.side.shape",
}
PICK = """\
defaults: [pick_place, _self_]
robot: {gravcmp: 1}
sensors:
  tip:
    sensor_type: contact
    entity_cfg: {uid: robot, link_names: [gripper/left_fingr]}
    against: {uid: cube}
commands:
  goal: {func: uniform_pose, params: {ranges: 3}}
events:
  colours:
    func: randomize_visual_material
    params: {entity_cfg: {uid: stand}}
observations:
  goal: {func: command, params: {command_name: goal}}
  touch: {func: contact_found, params: {sensor: tip}}
  speed:
    func: joint_velocity
    noise: {type: uniform, low: [0, 0], high: [1, 1]}
    params: {of: {uid: robot}}
rewards:
  tool:
    func: distance
    weight: 1
    params: {from: {uid: robot, link_names: [ee_lnk]}, to: {uid: cube}}
  side:
    func: relative_position
    weight: 1
    params: {from: {uid: cube}, to: {uid: stand}}
"""
IN_PICK = {
    "task.robot.gravcmp",
    "task.sensors.tip.entity_cfg.link_names",
    "task.commands.goal.params.ranges",
    "task.commands.goal.params.of",
    "task.commands.goal.params.position_range",
    "task.events.colours.params.base_color_range",
    "task.observations.speed.noise.low",
    "task.rewards.tool.params.from.link_names",
    "task.rewards.side.shape",
}


def paths_said(capsys: pytest.CaptureFixture[str], *words: str) -> list[str]:
    """The key path of each mistake; a mistake without one is its whole line."""
    capsys.readouterr()
    assert main(["validate", *words]) == 2
    lines = capsys.readouterr().err.splitlines()
    lines = lines[1:] if lines[0].endswith(" mistakes:") else lines
    found = []
    for line in lines:
        parts = line.removeprefix("error: ").strip().split(": ")
        place = parts[0] == "command line" or ".yaml" in parts[0]
        found.append(parts[1] if place else parts[0])
    return found


def write(text: str) -> str:
    file = Path("mine.yaml")
    file.write_text(text)
    return str(file)


@pytest.mark.parametrize(("text", "mistakes"), [(PUSH, IN_PUSH), (PICK, IN_PICK)])
def test_all_mistakes_of_a_newcomers_task(
    text: str, mistakes: set[str], empty_cwd: Path, capsys: Any
) -> None:
    said = paths_said(capsys, write(text))
    assert sorted(said) == sorted(mistakes)


def test_those_of_the_command_line_and_of_the_algorithm_too(empty_cwd: Path, capsys: Any) -> None:
    said = paths_said(
        capsys,
        "--train",
        *("task=reach", "record=mcpa", "num_envs=nine", "episodes=3", "algo.batchsize=64"),
        "+task.rewards.side={func: position, weight: 1, params: {of: {uid: goal}}}",
    )
    expected = ["record", "num_envs", "episodes", "algo.batchsize", "task.rewards.side.shape"]
    assert sorted(said) == sorted(expected)


def test_keys_of_policy_networks_beside_a_mistake_of_the_task(empty_cwd: Path, capsys: Any) -> None:
    said = paths_said(
        capsys,
        "--train",
        *("task=reach", "algo.policy_kwargs.net_arc=[3]", "task.max_episode_steps=0"),
    )
    assert sorted(said) == ["algo.policy_kwargs.net_arc", "task.max_episode_steps"]


def test_a_missing_package_does_not_come_alone(
    empty_cwd: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lacking(suffix: str) -> None:
        raise ConfigError("video needs a package")

    # The encoder is installed here.
    monkeypatch.setattr(video, "need_encoder", lacking)
    side = "+task.rewards.side={func: position, weight: 1, params: {of: {uid: goal}}}"
    said = paths_said(capsys, "task=reach", "video=true", side)
    assert said == ["video needs a package", "task.rewards.side.shape"]
    said = paths_said(capsys, "task=reach", "video=true", "task.rewards.near.wieght=1", side)
    assert said[0] == "task.rewards.near.wieght"
    assert sorted(said[1:]) == ["task.rewards.side.shape", "video needs a package"]


@pytest.mark.parametrize(
    ("changes", "mistakes"),
    [
        # Its observation and its rewards have nothing to read; they are right.
        (
            [
                "+task.commands.place={func: unifrm_pose}",
                "+task.observations.place={func: command, params: {command_name: place}}",
            ],
            ["task.commands.place.func"],
        ),
        # The part of the robot that other terms name.
        (["+task.robot.control_parts={arm: []}"], ["task.robot.control_parts.arm"]),
        # Actions need drives.
        (["+task.robot.drive_pros={stifness: 1}"], ["task.robot.drive_pros.stifness"]),
        (["task.objects.goal.shape.shape_type=Cub"], ["task.objects.goal.shape.shape_type"]),
    ],
)
def test_what_follows_from_a_mistake_is_none(
    changes: list[str], mistakes: list[str], empty_cwd: Path, capsys: Any
) -> None:
    assert paths_said(capsys, "task=reach_pose", *changes) == mistakes

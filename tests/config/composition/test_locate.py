"""File and line of a key: in nested files, merged anchors, after overrides; or the command line."""

from pathlib import Path

import pytest

from embodichain.config import compose
from tests.config.conftest import GOOD, WriteTask


def line_of(text: str) -> str:
    lines = [number for number, line in enumerate(GOOD.splitlines(), 1) if text in line]
    assert len(lines) == 1, text
    return f"conf/task/mine.yaml:{lines[0]}"


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("task.robot", "robot:"),
        ("task.robot.fpath", "fpath:"),
        ("task.robot.init_qpos.3", "init_qpos:"),
        ("task.robot.nothing_here", "robot:"),
        ("task.robot.nothing.here.either", "robot:"),
        ("task.objects.box.shape.size", "size:"),
        ("task.objects.ball.body_type", "ball: {shape"),
        ("task.rewards.near.params.threshold", "threshold: 0.05"),
        ("task.metrics.success.params.threshold", "threshold: 0.1"),
        ("task.metrics.success.params.target_entity_cfg.uid", "target_entity_cfg"),
    ],
)
def test_lines_of_a_task(path: str, text: str, write_task: WriteTask) -> None:
    write_task()
    assert compose(["task=mine"]).locator.source(path) == line_of(text)


def test_the_command_line_is_the_last(write_task: WriteTask) -> None:
    write_task()
    lines = ["task=mine", "task.objects.box.init_pos=[0,0,1]", "+task.rewards.new={weight: 1}"]
    source = compose([*lines, "~task.events.move"]).locator.source
    assert source("task.objects.box.init_pos") == "command line"
    assert source("task.objects.box.init_pos.2") == "command line"
    assert source("task.rewards.new.func") == "command line"
    assert source("task.events.move.mode") == "command line"
    assert source("task.objects.box.shape.size") == line_of("size:")
    assert source("task.objects.box") == line_of("box:")
    assert source("task.rewards.near.weight") == line_of("weight:")


def test_the_last_file_that_sets_a_key(write_task: WriteTask) -> None:
    write_task()
    child = "# a child\ndefaults:\n  - mine\n  - _self_\nrobot:\n  init_pos: [0, 0]\n"
    write_task(name="child", text=child)
    source = compose(["task=child"]).locator.source
    assert source("task.robot.init_pos") == "conf/task/child.yaml:6"
    assert source("task.robot.fpath") == line_of("fpath:")


def test_names_with_dots(write_task: WriteTask) -> None:
    write_task("  init_qpos: [0, -1, 1, 0, 0, 0]", "  init_qpos:\n    Joint.*: 0\n    Joint1: 1")
    source = compose(["task=mine"]).locator.source
    assert source("task.robot.init_qpos.Joint.*") == "conf/task/mine.yaml:8"
    assert source("task.robot.init_qpos.Joint1") == "conf/task/mine.yaml:9"


def test_files_outside_the_working_directory_are_absolute(tmp_path: Path) -> None:
    folder = tmp_path / "theirs"
    (folder / "task").mkdir(parents=True)
    (folder / "task" / "far.yaml").write_text(GOOD)
    source = compose(["task=far"], config_dir=folder).locator.source("task.robot")
    assert source == f"{folder}/task/far.yaml:4"

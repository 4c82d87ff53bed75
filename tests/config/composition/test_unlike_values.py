"""A map over a list, or a list over a map: the key, both places, and what is there are named."""

from pathlib import Path

import pytest

from embodichain.cli import main

MAP_OVER_LIST = "defaults: [reach, _self_]\nrobot:\n  init_qpos: {Joint1: 1}\n"
LIST_OVER_MAP = "defaults: [reach, _self_]\nviews: [{uid: here}]\n"
BELOW = "defaults: [reach, _self_]\nevents:\n  place_goal: {params: {position_range: {x: 1}}}\n"


def refusal(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["validate", *words]) == 2
    err = capsys.readouterr().err
    assert "ConfigTypeError" not in err
    assert "Traceback" not in err
    return err


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (MAP_OVER_LIST, "conf/task/mine.yaml:3: task.robot.init_qpos: expected a list, as "),
        (LIST_OVER_MAP, "conf/task/mine.yaml:2: task.views: expected a map, as "),
        (BELOW, "conf/task/mine.yaml:3: task.events.place_goal.params.position_range: expected a"),
    ],
)
def test_in_a_task(text: str, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path("conf/task")
    folder.mkdir(parents=True)
    (folder / "mine.yaml").write_text(text)
    err = refusal(capsys, "task=mine")
    assert says in err
    assert "neither takes the place of the other" in err


def test_in_an_option_of_the_user(capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path("conf/record")
    folder.mkdir(parents=True)
    (folder / "mine.yaml").write_text("view_envs: {first: 1}\n")
    err = refusal(capsys, "task=reach", "record=mine")
    assert "conf/record/mine.yaml:1: record.view_envs: expected a list, as " in err
    assert "got a map" in err


@pytest.mark.parametrize(
    ("word", "says"),
    [
        ("task.robot.init_qpos={Joint1: 1}", "task.robot.init_qpos: the map {'Joint1': 1} cannot"),
        ("task.views.default=[1]", "task.views.default: the list [1] cannot be merged"),
        ("task.robot.init_qpos.Joint1=1", "expected the number of an item, got 'Joint1'"),
        ("task.robot.init_qpos.9=1", "there is no item 9: task.robot.init_qpos has 6"),
    ],
)
def test_on_the_command_line(word: str, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert says in refusal(capsys, "task=reach", word)


def test_the_hint_works() -> None:
    words = ["~task.robot.init_qpos", "task.robot.init_qpos={Joint1: 1}"]
    assert main(["validate", "task=reach", *words]) == 0


def test_a_null_and_a_scalar_are_replaced_by_either(capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path("conf/task")
    folder.mkdir(parents=True)
    (folder / "first.yaml").write_text("defaults: [reach, _self_]\nrobot: {init_qpos: null}\n")
    (folder / "mine.yaml").write_text(
        "defaults: [first, _self_]\nrobot: {init_qpos: {Joint1: 0.5}}\n"
    )
    assert main(["validate", "task=mine"]) == 0, capsys.readouterr().err

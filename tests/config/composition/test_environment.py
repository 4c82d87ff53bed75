"""Variables of the environment: text keeps its interpolation, numbers and flags are resolved."""

import copy
import pickle

import pytest
import yaml

from embodichain.config import resolve, resolve_tree
from embodichain.config.composition.composed import compose
from embodichain.config.resolved import dump_yaml
from embodichain.utils.env_text import EnvText, env_texts
from embodichain.utils.errors import ConfigError


@pytest.fixture(autouse=True)
def variables(monkeypatch):
    values = {
        "PLANTED": "hunter2-of-a-test",
        "PLANTED_NAME": "PLANTED",
        "PLANTED_LIST": "[7, hunter3-of-a-test, {deep: hunter4-of-a-test}]",
        "PLANTED_STEPS": "12",
        "PLANTED_FLAG": "true",
        "PLANTED_WORD": "'hunter5-of-a-test'",
    }
    for name, value in values.items():
        monkeypatch.setenv(name, value)


def tree_of(*overrides):
    return resolve(["task=reach", *overrides]).tree


DESCRIPTIONS = {
    "${oc.env:PLANTED}": ("hunter2-of-a-test", "${oc.env:PLANTED}"),
    "to ${oc.env:PLANTED}!": ("to hunter2-of-a-test!", "to ${oc.env:PLANTED}!"),
    "${oc.env:${oc.env:PLANTED_NAME}}": (
        "hunter2-of-a-test",
        "${oc.env:${oc.env:PLANTED_NAME}}",
    ),
    "${oc.env:PLANTED_NOT,'a, b'}": ("a, b", "${oc.env:PLANTED_NOT,'a, b'}"),
    "${oc.env:PLANTED_NOT,${oc.env:PLANTED}}": (
        "hunter2-of-a-test",
        "${oc.env:PLANTED_NOT,${oc.env:PLANTED}}",
    ),
    "${oc.decode:${oc.env:PLANTED_WORD}}": (
        "hunter5-of-a-test",
        "${oc.decode:${oc.env:PLANTED_WORD}}",
    ),
    "${policy}": ("hunter2-of-a-test", "${oc.env:PLANTED}"),
    "${task.max_episode_steps} ${policy}": ("100 hunter2-of-a-test", "100 ${oc.env:PLANTED}"),
    "\\${oc.env:PLANTED}": ("${oc.env:PLANTED}", "\\${oc.env:PLANTED}"),
    "\\${foo} ${oc.env:PLANTED}": ("${foo} hunter2-of-a-test", "\\${foo} ${oc.env:PLANTED}"),
    "\\${foo}": ("${foo}", "${foo}"),
}


@pytest.mark.parametrize("written", DESCRIPTIONS)
def test_text_keeps_its_interpolation(written, tmp_path):
    value, record = DESCRIPTIONS[written]
    task = {"defaults": ["reach"], "description": written}
    (tmp_path / "task").mkdir()
    (tmp_path / "task/mine.yaml").write_text(yaml.safe_dump(task))
    lines = ["task=mine", "policy=${oc.env:PLANTED}"]
    tree = compose(lines, "run", tmp_path).tree
    assert tree["task"]["description"] == value
    found = yaml.safe_load(dump_yaml({"description": tree["task"]["description"]}))
    assert found == {"description": record}
    # What a record has gives the same value again.
    again = resolve_tree({**yaml.safe_load(dump_yaml(tree)), "policy": None}, "record")
    assert again.root.task.description == value
    assert yaml.safe_load(dump_yaml(again.tree))["task"]["description"] == record


def test_numbers_and_flags_are_resolved():
    tree = tree_of(
        'max_steps="${oc.decode:${oc.env:PLANTED_STEPS}}"',
        'quiet="${oc.decode:${oc.env:PLANTED_FLAG}}"',
    )
    assert tree["max_steps"] == 12 and tree["quiet"] is True
    assert "oc.env" not in dump_yaml(tree)


def test_parts_of_a_list(tmp_path):
    tree = compose(['+x="${oc.decode:${oc.env:PLANTED_LIST}}"', "task=reach"]).tree
    assert tree["x"] == [7, "hunter3-of-a-test", {"deep": "hunter4-of-a-test"}]
    text = dump_yaml(tree["x"])
    assert "hunter" not in text
    written = yaml.safe_load(text)
    assert written[0] == 7 and "PLANTED_LIST" in written[1]
    again = resolve_tree(
        {
            **resolve(["task=reach"]).tree,
            "wandb": {"tags": written[1:2], "name": written[2]["deep"]},
        },
        "record",
    )
    assert again.root.wandb.tags == ["hunter3-of-a-test"]
    assert again.root.wandb.name == "hunter4-of-a-test"


def test_copies_and_processes_keep_both():
    text = EnvText("value", "${oc.env:PLANTED}")
    for again in (copy.deepcopy(text), pickle.loads(pickle.dumps(text))):
        assert again == "value" and again.written == "${oc.env:PLANTED}"
    assert repr(text) == "'<env PLANTED>'"


def test_a_record_takes_todays_value_and_says_so(monkeypatch):
    written = yaml.safe_load(dump_yaml(tree_of("task.description=${oc.env:PLANTED}")))
    monkeypatch.setenv("PLANTED", "another-of-a-test")
    again = resolve_tree(written, "record")
    assert again.root.task.description == "another-of-a-test"
    said = [note.message for note in again.notes if "today" in note.message]
    assert said == ["PLANTED is taken from today's environment"]
    assert [path for path, _ in env_texts(again.tree)] == ["task.description"]
    monkeypatch.delenv("PLANTED")
    with pytest.raises(ConfigError, match=r"task.description: PLANTED is not set") as error:
        resolve_tree(written, "record")
    assert error.value.problems[0].source == "record"


def test_a_record_takes_nothing_else(tmp_path):
    tree = {**tree_of(), "output_dir": "${oc.decode:${oc.env:PLANTED}} ${now:%Y}"}
    with pytest.raises(ConfigError, match="takes only variables of the environment"):
        resolve_tree(tree, "record")
    tree = {**tree_of(), "output_dir": "${now:%Y}"}
    assert resolve_tree(tree, "record").root.output_dir == "${now:%Y}"


def test_messages_hide_values():
    with pytest.raises(ConfigError) as error:
        tree_of("max_steps=${oc.env:PLANTED}", "task.robot.fpath=${oc.env:PLANTED}/x.urdf")
    assert "hunter" not in str(error.value) and "hunter" not in repr(error.value.problems)
    assert "<env PLANTED>" in str(error.value)

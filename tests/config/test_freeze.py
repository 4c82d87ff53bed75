"""Frozen trees cannot change, and their text is the same whenever they are."""

import pytest
import yaml

from embodichain.config import dump_yaml, freeze, resolve, resolve_tree, thaw
from embodichain.utils.errors import ConfigError
from tests.config.conftest import WriteTask


def test_frozen_means_frozen_all_the_way_down() -> None:
    source = {"a": {"b": [1, {"c": 2}]}}
    frozen = freeze(source)
    source["a"]["b"].append(3)
    assert thaw(frozen) == {"a": {"b": [1, {"c": 2}]}}
    with pytest.raises(TypeError):
        frozen["a"]["x"] = 1
    with pytest.raises(TypeError):
        frozen["a"]["b"][1]["c"] = 3
    with pytest.raises(AttributeError):
        frozen["a"]["b"].append(3)


def test_a_resolved_config_cannot_change(write_task: WriteTask) -> None:
    write_task()
    resolved = resolve(["task=mine", "seed=1"])
    before = dump_yaml(resolved.tree)
    with pytest.raises(TypeError):
        resolved.tree["task"]["robot"]["uid"] = "other"  # type: ignore[index]
    cfg = resolved.env_cfg
    cfg.robot = None
    cfg.objects.clear()
    assert dump_yaml(resolved.tree) == before
    assert list(resolved.env_cfg.objects) == ["ball", "box"]


def test_text_is_deterministic_and_loads_back(write_task: WriteTask) -> None:
    write_task()
    texts = {dump_yaml(resolve(["task=mine", "seed=1"]).tree) for _ in range(3)}
    assert len(texts) == 1
    text = texts.pop()
    assert "&" not in text
    assert yaml.safe_load(text) == thaw(resolve(["task=mine", "seed=1"]).tree)


def test_a_dumped_config_resolves_to_itself(write_task: WriteTask) -> None:
    write_task()
    resolved = resolve(["task=mine"])
    again = resolve_tree(yaml.safe_load(dump_yaml(resolved.tree)), "config.yaml")
    assert again.tree == resolved.tree
    assert again.env_cfg == resolved.env_cfg


def test_a_dumped_config_imports_nothing(write_task: WriteTask) -> None:
    write_task("    func: within_distance", "    func: os.path:join")
    tree = yaml.safe_load(dump_yaml({"task": yaml.safe_load(write_task().read_text())}))
    tree["task"]["rewards"]["near"]["func"] = "os.path:join"
    tree["policy"] = "os:getcwd"
    with pytest.raises(ConfigError) as error:
        resolve_tree(tree, "log.mcap")
    policy, reward = str(error.value).splitlines()
    assert policy == (
        "log.mcap: policy: 'os:getcwd' would be imported, which is not allowed for this config"
    )
    assert reward.startswith("log.mcap: task.rewards.near.func: 'os.path:join'")

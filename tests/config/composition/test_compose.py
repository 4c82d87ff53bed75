"""What overrides, experiments and folders of one's own make of the tree; what Hydra keeps."""

import os
from pathlib import Path

import pytest
from hydra import compose as hydra_compose
from hydra import initialize_config_dir, initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from hydra.core.singleton import Singleton
from hydra.version import getbase
from omegaconf import OmegaConf

from embodichain.config import compose, list_options, relax, validate
from embodichain.config.composition.hydra_loader import config_loader
from embodichain.utils.errors import ConfigError
from tests.config.conftest import GOOD, WriteTask


def test_overrides_win_over_files(write_task: WriteTask) -> None:
    write_task()
    composed = compose(["task=mine", "num_envs=7", "task.rewards.near.weight=2"])
    assert composed.problems == ()
    assert composed.tree["num_envs"] == 7
    assert composed.tree["task"]["rewards"]["near"]["weight"] == 2
    assert composed.choices["task"] == "mine"


def test_a_known_key_needs_no_plus(write_task: WriteTask) -> None:
    write_task()
    composed = compose(["task=mine", "task.physics.gravity=[0,0,-1.6]", "algo.gamma=0.5"], "train")
    assert composed.problems == ()
    assert composed.tree["task"]["physics"] == {"physics_dt": 0.005, "gravity": [0, 0, -1.6]}


def test_terms_and_entities_are_added_and_deleted(write_task: WriteTask) -> None:
    write_task()
    lines = [
        "task=mine",
        "~task.events.move",
        "+task.objects.wall={shape: {shape_type: Cube, size: [1, 0.1, 1]}, body_type: static}",
        "+task.rewards.slow={func: joint_velocity_penalty, params: {entity_cfg: {uid: arm}}}",
    ]
    composed = compose(lines)
    assert validate(composed) == []
    assert composed.tree["task"]["events"] == {}
    assert list(composed.tree["task"]["objects"]) == ["ball", "box", "wall"]
    assert list(composed.tree["task"]["rewards"]) == ["near", "slow"]


def test_a_file_that_is_edited_is_read_anew(write_task: WriteTask) -> None:
    write_task("    weight: 0.5", "    weight: 0.5")
    first = compose(["task=mine"])
    file = Path("conf/task/mine.yaml")
    before = file.stat()
    write_task("    weight: 0.5", "    weight: 0.7")
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))  # the same size at the same time
    assert first.tree["task"]["rewards"]["near"]["weight"] == 0.5
    assert compose(["task=mine"]).tree["task"]["rewards"]["near"]["weight"] == 0.7


def test_a_composition_leaves_the_next_one_alone(write_task: WriteTask) -> None:
    write_task()
    Path("conf/experiment").mkdir()
    Path("conf/experiment/fast.yaml").write_text(
        "# @package _global_\ndefaults:\n  - override /task: mine\n\n"
        "task: {rewards: {near: {weight: 2}}}\n"
    )
    lines = ["experiment=fast", "+task.objects.wall={body_type: static}", "task.suggested=null"]
    first = compose(lines)
    first.tree["task"]["objects"].clear()
    compose([*lines, "~task.events.move", "task.rewards.near.weight=9", "num_envs=3"])
    last = compose(lines)
    assert last.tree["task"]["rewards"]["near"]["weight"] == 2
    assert list(last.tree["task"]["objects"]) == ["ball", "box", "wall"]
    assert "move" in last.tree["task"]["events"]
    assert last.tree["num_envs"] == first.tree["num_envs"]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("rewards:\t{}\n", "found character '\\t' that cannot start any token"),
        ("rewards: {}\nevents: {}\nrewards: {}\n", "found duplicate key rewards"),
        ("rewards: [\n", "malformed YAML: "),
        ("rewards: !!python/name:os.system {}\n", "tags are not used here"),
    ],
)
def test_malformed_files_are_refused_each_time(write_task: WriteTask, text: str, told: str) -> None:
    write_task(text=text)
    for _ in range(2):
        (problem,) = compose(["task=mine"]).problems
        assert told in problem.message
        assert problem.source.startswith("conf/task/mine.yaml")


def test_anchors_and_merge_keys(write_task: WriteTask) -> None:
    write_task()
    metric = compose(["task=mine"]).tree["task"]["metrics"]["success"]
    assert metric["params"] == {
        "source_entity_cfg": {"uid": "arm", "link_names": ["ee_link"]},
        "target_entity_cfg": {"uid": "ball"},
        "threshold": 0.1,
    }


def test_interpolation(write_task: WriteTask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOW_HEAVY", "3.5")
    write_task("    weight: 0.5", "    weight: ${oc.decode:${oc.env:HOW_HEAVY}}")
    lines = ["task=mine", "task.max_episode_steps=${task.events.move.interval_step}"]
    composed = compose(lines)
    assert validate(composed) == []
    assert composed.tree["task"]["rewards"]["near"]["weight"] == 3.5
    assert composed.tree["task"]["max_episode_steps"] == 5


def test_an_experiment_chooses_and_sets(write_task: WriteTask) -> None:
    write_task()
    Path("conf/experiment").mkdir()
    Path("conf/experiment/fast.yaml").write_text(
        "# @package _global_\ndefaults:\n  - override /task: mine\n\nnum_envs: 9\n"
        "task: {max_episode_steps: 11}\n"
    )
    composed = compose(["experiment=fast"])
    assert composed.problems == ()
    assert composed.tree["num_envs"] == 9
    assert composed.tree["task"]["max_episode_steps"] == 11
    assert composed.locator.source("num_envs") == "conf/experiment/fast.yaml:5"
    assert compose(["experiment=fast", "num_envs=2"]).tree["num_envs"] == 2


def test_config_dir_before_conf_before_the_package(tmp_path: Path, write_task: WriteTask) -> None:
    def described(config_dir: Path | None = None) -> str:
        text: str = compose(["task=reach"], config_dir=config_dir).tree["task"]["description"]
        return text

    assert described().startswith("Bring the tool")
    write_task(name="reach", text="description: from ./conf\n")
    assert described() == "from ./conf"
    mine = tmp_path / "elsewhere"
    (mine / "task").mkdir(parents=True)
    (mine / "task" / "reach.yaml").write_text("description: from --config-dir\n")
    assert described(mine) == "from --config-dir"
    assert described() == "from ./conf"
    assert compose(["task=random_reach"], config_dir=mine).problems == ()


def test_a_config_dir_that_is_missing() -> None:
    with pytest.raises(ConfigError, match="--config-dir nowhere: no such folder"):
        compose(["task=reach"], config_dir="nowhere")


def test_a_package_brings_yaml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "site" / "their_conf"
    (package / "task").mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "task" / "theirs.yaml").write_text(GOOD)
    info = tmp_path / "site" / "theirs-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[embodichain.conf]\ntheirs = their_conf\n")
    monkeypatch.syspath_prepend(tmp_path / "site")

    assert "theirs" in list_options("task")
    assert validate(compose(["task=theirs"])) == []


def test_options_are_listed() -> None:
    assert {"push_cube", "random_reach", "reach"} <= set(list_options("task"))
    assert list_options("record") == ["mcap", "none"]
    assert list_options("nothing") == []


def test_hydras_state_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Another test of this process may have left Hydra's own singleton: begin without.
    monkeypatch.delitem(Singleton._instances, GlobalHydra, raising=False)
    compose(["task=reach"])
    # Hydra offers no way to ask that does not create it.
    assert GlobalHydra not in Singleton._instances
    (tmp_path / "app.yaml").write_text("x: 1\n")
    with initialize_config_dir(str(tmp_path), version_base="1.2"):
        before = (GlobalHydra.instance().hydra, getbase())
        compose(["task=reach"])
        compose(["task=nope"])
        assert (GlobalHydra.instance().hydra, getbase()) == before
        assert hydra_compose("app") == {"x": 1}


def test_hydra_1_4_is_not_asked_for_a_version(monkeypatch: pytest.MonkeyPatch) -> None:
    """There the base is a string, and setting one warns of its removal in Hydra 1.5."""

    def deprecated(base: str) -> None:
        raise AssertionError(base)

    # What Hydra 1.4 answers, with whichever version is installed.
    monkeypatch.setattr("hydra.version.getbase", lambda: "1.4")
    monkeypatch.setattr("hydra.version.setbase", deprecated)
    assert "reach" in list_options("task")


def test_relaxed_overrides_do_the_same_in_hydra() -> None:
    lines = ["task=reach", "num_envs=3", "task.physics.gravity=[0,0,0]", "~task.events", "a=1,2"]
    with config_loader() as loader:
        relaxed = relax(lines, loader)
        again = relax(relaxed, loader)
    assert relaxed == [
        "task=reach",
        "++num_envs=3",
        "++task.physics.gravity=[0,0,0]",
        "~task.events",
        "++a=1,2",
    ]
    assert again == relaxed


@pytest.mark.parametrize("config_name", ["run", "train"])
def test_hydra_makes_no_folders_and_sets_no_logging(config_name: str) -> None:
    with initialize_config_module("embodichain.conf", version_base="1.3"):
        hydra = hydra_compose(config_name, ["task=reach"], return_hydra_config=True).hydra
    assert hydra.job.chdir is False
    assert hydra.output_subdir is None
    assert hydra.run.dir == "."
    assert OmegaConf.to_container(hydra.job_logging)["root"] is None
    assert OmegaConf.to_container(hydra.hydra_logging)["root"] is None


def test_not_text(write_task: WriteTask) -> None:
    write_task(text="").write_bytes(b"\xff\xfe\x00")
    assert [str(p) for p in compose(["task=mine"]).problems] == [
        "conf/task/mine.yaml: not UTF-8 text"
    ]

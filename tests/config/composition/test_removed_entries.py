"""`null` removes an inherited entry of a map keyed by name, and keeps its meaning elsewhere."""

from pathlib import Path

import pytest

from embodichain.config import compose, resolve, validate
from tests.config.conftest import GOOD, WriteTask

PARTS = GOOD.replace(
    "  init_qpos:",
    "  control_parts: {arm: [Joint.*], wrist: [Joint6]}\n"
    "  attach: {hand: {fpath: ParallelGripper/parallel_gripper.xml, to: ee_link}}\n  init_qpos:",
).replace("actions:", "sensors: {touch: {sensor_type: contact, entity_cfg: {uid: box}}}\nactions:")


def child(text: str) -> None:
    """Write the task `child`, which inherits from `mine`."""
    Path("conf/task/child.yaml").write_text(f"defaults: [mine, _self_]\n{text}")


@pytest.mark.parametrize(
    ("path", "left"),
    [
        ("rewards.near", []),
        ("events.move", []),
        ("objects.box", ["ball"]),
        ("sensors.touch", []),
        ("robot.attach.hand", []),
        ("robot.control_parts.wrist", ["arm"]),
    ],
)
def test_an_entry_is_removed(write_task: WriteTask, path: str, left: list[str]) -> None:
    write_task(text=PARTS)
    line = f"{path.rpartition('.')[0].replace('.', ': {')}: {{{path.rpartition('.')[2]}: null}}"
    child(line + "}" * path.rpartition(".")[0].count(".") + "\n")
    removes_box = [] if path != "objects.box" else ["~task.sensors.touch"]
    for lines in (["task=child"], ["task=mine", f"task.{path}=null"]):
        composed = compose([*lines, *removes_box])
        assert validate(composed) == []
        section = composed.tree["task"]
        for key in path.split(".")[:-1]:
            section = section[key]
        assert list(section) == left


def test_an_arranged_object_is_removed(empty_cwd: Path) -> None:
    Path("conf/task").mkdir(parents=True)
    text = "defaults: [clutter_pick, _self_]\nevents: {layout: {params: {objects: {NAME: null}}}}\n"
    Path("conf/task/child.yaml").write_text(text.replace("NAME", "bottle"))
    composed = compose(["task=child"])
    assert validate(composed) == []
    objects = composed.tree["task"]["events"]["layout"]["params"]["objects"]
    assert list(objects) == ["cube", "stand", "bowl", "mug", "ball"]
    Path("conf/task/child.yaml").write_text(text.replace("NAME", "botle"))
    (problem,) = validate(compose(["task=child"]))
    assert "there is no 'botle' in task.events.layout.params.objects" in str(problem)
    assert "Did you mean 'bottle'?" in str(problem)


def test_an_entry_that_is_not_inherited(write_task: WriteTask) -> None:
    write_task(text=PARTS)
    child("rewards: {naer: null}\nrobot:\n  attach: {gripper: null}\n")
    told = "null removes an inherited entry, and there is no"
    assert [str(p) for p in validate(compose(["task=child"]))] == [
        f"conf/task/child.yaml:4: task.robot.attach.gripper: {told} 'gripper' in "
        "task.robot.attach; there are: hand",
        f"conf/task/child.yaml:2: task.rewards.naer: {told} 'naer' in task.rewards; there are: "
        "near. Did you mean 'near'?",
    ]
    for key in ("task.rewards.naer", "+task.rewards.naer", "++task.rewards.naer"):
        assert [str(p) for p in validate(compose(["task=mine", f"{key}=null"]))] == [
            f"command line: task.rewards.naer: {told} 'naer' in task.rewards; there are: near. "
            "Did you mean 'near'?"
        ]


def test_a_whole_section_is_no_entry(write_task: WriteTask) -> None:
    write_task(text=PARTS)
    child("rewards: null\nrobot: {attach: null}\n")
    hint = "expected a map, got null. Null takes out single entries: NAME: null."
    assert {str(p) for p in validate(compose(["task=child"]))} == {
        f"conf/task/child.yaml:2: task.rewards: {hint}",
        f"conf/task/child.yaml:3: task.robot.attach: {hint}",
    }


def test_a_term_within_a_term(write_task: WriteTask) -> None:
    term = "{func: within_distance, params: *pair}"
    terms = f"{{far: {term}, near: {term}}}"
    both = f"  both: {{func: all_of, params: {{terms: {terms}}}}}\nsuggested:"
    write_task("suggested:", both)
    child("metrics: {both: {params: {terms: {far: null}}}}\n")
    composed = compose(["task=child"])
    assert validate(composed) == []
    assert list(composed.tree["task"]["metrics"]["both"]["params"]["terms"]) == ["near"]
    child("metrics: {both: {params: {terms: {fa: null}}}}\n")
    (problem,) = validate(compose(["task=child"]))
    path = "task.metrics.both.params.terms"
    assert str(problem) == (
        f"conf/task/child.yaml:2: {path}.fa: null removes an inherited entry, and there is no "
        f"'fa' in {path}; there are: far, near. Did you mean 'far'?"
    )


def test_a_later_file_adds_it_again(write_task: WriteTask) -> None:
    write_task()
    child("rewards: {near: null}\n")
    again = "rewards: {near: {func: joint_velocity, params: {of: {uid: arm}}, shape: l2}}\n"
    Path("conf/task/third.yaml").write_text(f"defaults: [child, _self_]\n{again}")
    reward = compose(["task=third"]).tree["task"]["rewards"]["near"]
    assert reward == {"func": "joint_velocity", "params": {"of": {"uid": "arm"}}, "shape": "l2"}
    assert validate(compose(["task=third"])) == []


def test_elsewhere_null_is_a_value(write_task: WriteTask) -> None:
    write_task(text=PARTS)
    child("physics: {solver: null}\nextensions: {own: null}\n")
    tree = resolve(compose(["task=child", "record.images=null"])).tree
    assert tree["task"]["physics"]["solver"] is None
    assert tree["task"]["extensions"] == {"own": None}
    assert tree["record"]["images"] is None


def test_an_own_option_is_merged_over_the_packages(write_task: WriteTask) -> None:
    write_task()
    for group, text in {
        "sim": "num_threads: 2\n",
        "record": "view_hz: 5\n",
        "viewer": "port: 9000\n",
    }.items():
        Path(f"conf/{group}").mkdir()
        Path(f"conf/{group}/one.yaml").write_text(text)
    resolved = resolve(compose(["task=mine", "sim=one", "record=one", "viewer=one"]))
    tree = resolved.tree
    assert (tree["sim"]["num_threads"], tree["sim"]["first_env"]) == (2, 0)
    assert tree["sim"]["warp"]["arrays"] == "auto"
    assert tree["sim"]["engine"] == "mujoco"
    assert (tree["record"]["view_hz"], tree["record"]["format"]) == (5, "mcap")
    assert (tree["viewer"]["port"], tree["viewer"]["name"]) == (9000, "none")
    lines = ["task=mine", "sim=one", "sim.num_threads=3"]
    assert resolve(compose(lines)).tree["sim"]["num_threads"] == 3
    Path("conf/sim/one.yaml").write_text("num_thread: 2\n")
    (problem,) = validate(compose(["task=mine", "sim=one"]))
    assert problem.source == "conf/sim/one.yaml:1"

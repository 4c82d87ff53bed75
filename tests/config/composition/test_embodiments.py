"""Embodiments: a task's robot by ``embodiment=NAME``, and what is said where that cannot be."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import embodichain
from embodichain.cli import main
from embodichain.config import compose, list_options, validate
from embodichain.config.resolved import resolve
from embodichain.data.pretrained import pretrained
from embodichain.learning import load_policy
from embodichain.utils.errors import ConfigError

CONF = Path(embodichain.__file__).parent / "conf"
ARMS = ("reach", "reach_pose", "reach_workspace", "push_cube")
GRASPS = ("pick_place", "stack_cubes", "peg_in_hole", "press_button", "open_drawer", "lift_cube")
WALKS = ("quadruped_velocity", "quadruped_rough")
MINE = """\
defaults: [/embodiment@_here_: ur10, _self_]
description: Bring the tool somewhere.
robot: {init_pos: [0, 0, 1]}
actions: {arm: {func: joint_action, params: {of: {uid: robot, control_parts: arm}, centre: home}}}
observations: {tool: {func: position, params: {of: {uid: robot, link: tool}}}}
rewards: {up: {func: height, params: {of: {uid: robot, link: tool}}}}
"""


def said(capsys, *words):
    """What `validate` says of a config with mistakes, on one line."""
    assert main(["validate", *words]) == 2
    return " ".join(capsys.readouterr().err.split())


def write(folder: Path, name: str, text: str) -> None:
    path = folder / f"{name}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


@pytest.mark.parametrize("name", list_options("embodiment"))
def test_a_file_names_no_object_and_no_task(name):
    text = (CONF / "embodiment" / f"{name}.yaml").read_text()
    assert "@package" not in text
    tree = compose(["task=reach", f"embodiment={name}"]).tree["task"]
    robots = tree.get("robots") or {"robot": tree["robot"]}
    for robot in robots.values():
        assert {"base"} <= robot["names"].keys()
        assert robot["control_parts"]


def table_cells():
    """The (task, embodiment) pairs of docs/tasks.md that have a rate of success."""
    page = (Path(__file__).parents[3] / "docs" / "tasks.md").read_text(encoding="utf-8")
    table = page.partition("<!-- experts:")[2].partition("<!-- end of experts -->")[0]
    head, _, *rows = [line for line in table.splitlines() if line.startswith("|")]
    names = [word.strip(" `") for word in head.strip("|").split("|")][1:]
    pairs = []
    for row in rows:
        task, *cells = [word.strip(" `") for word in row.strip("|").split("|")]
        rates = [(name, cell) for name, cell in zip(names, cells, strict=True) if "%" in cell]
        pairs += [(task, name) for name, cell in rates if float(cell.rstrip(" %")) >= 95]
    return pairs


PAIRS = (
    *((task, arm) for task in ARMS for arm in ("ur10", "panda", "ur5e", "ur10_gripper")),
    *((task, arm) for task in GRASPS for arm in ("ur10_gripper", "panda", "ur5e")),
    *((task, robot) for task in WALKS for robot in ("go2", "go1")),
    ("reach", "so101"),
    ("hand_over", "dual_ur10"),
    ("humanoid_velocity", "g1"),
)
PLAYED = table_cells()
"""Pairs that an expert plays below: `run` checks them as `validate` does."""


@pytest.mark.parametrize(("task", "embodiment"), [pair for pair in PAIRS if pair not in PLAYED])
@pytest.mark.slow
def test_every_task_takes_every_robot_that_has_what_it_needs(task, embodiment):
    assert [str(p) for p in validate(compose([f"task={task}", f"embodiment={embodiment}"]))] == []


def test_a_robot_is_replaced_and_not_merged():
    ur10 = compose(["task=pick_place"]).tree["task"]["robot"]
    panda = compose(["task=pick_place", "embodiment=panda"]).tree["task"]["robot"]
    assert "attach" in ur10 and "attach" not in panda
    assert panda["drive_pros"]["stiffness"] == {"arm": 400, "gripper": 1000}
    assert panda["control_parts"].keys() == {"arm", "swivel", "elbow", "gripper"}
    assert all("Joint" not in key for key in panda["drive_pros"]["armature"])
    assert panda["init_pos"] == ur10["init_pos"] == [0, 0, 0.7]  # the task's


def test_the_word_is_read_at_every_door(tmp_path, empty_cwd):
    write(
        tmp_path / "experiment",
        "other",
        "# @package _global_\ndefaults:\n"
        "  - override /task: reach\n  - override /embodiment@task: ur10_gripper\n",
    )
    plain = compose(["task=reach", "embodiment=ur10_gripper"])
    placed = compose(["task=reach", "embodiment@task=ur10_gripper"])
    in_file = compose(["experiment=other"], config_dir=tmp_path)
    assert plain.tree == placed.tree == in_file.tree
    assert resolve(["task=reach", "embodiment=ur10_gripper"], "train").root.task.robot.attach
    env = embodichain.make("reach", 1, ["seed=1", "embodiment=ur10_gripper"])
    assert env.sim.robots["robot"].get_link_pose("tool").shape == (1, 7)
    env.close()


@pytest.mark.slow
def test_a_sweep_runs_one_job_for_each(empty_cwd, capsys):
    words = ("task=reach", "policy=zero", "num_envs=1", "max_steps=2", "record=none", "seed=1")
    words += ("scene_png=false", "hydra.sweep.dir=sweep", "hydra/launcher=basic")
    assert main(["run", "-m", "embodiment=ur10,ur10_gripper", *words]) == 0
    tool = {"sweep/0/config.yaml": "tool: ee_link", "sweep/1/config.yaml": "tool: gripper/tcp"}
    for path, line in tool.items():
        assert line in Path(path).read_text()


def test_a_task_without_the_entry_is_told_the_line(capsys):
    text = said(capsys, "task=cart_pole", "embodiment=ur10")
    assert "Add the line `- /embodiment@_here_: NAME` to its defaults" in text
    assert "unknown option 'pnda'; embodiment is one of" in said(
        capsys, "task=reach", "embodiment=pnda"
    )


@pytest.mark.parametrize(
    "choice",
    [
        "embodiment=[ur10,ur10_gripper]",
        "embodiment@task=[ur10,ur10_gripper]",
        "object@task.objects.bowl=[bowl,mug]",
        "scene@task.scene=[studio,lab]",
        "sim=[default,default]",
    ],
)
def test_a_list_of_options_is_no_choice(capsys, choice):
    text = said(capsys, "task=clutter_pick", choice)
    key, _, options = choice.partition("=")
    assert "takes one option" in text and f"-m for a sweep: -m {key}={options[1:-1]}" in text
    text = said(capsys, "task=clutter_pick", choice.replace("[", "").replace("]", ""))
    assert "is a sweep: add -m" in text and "[...]" not in text


def test_a_list_of_options_in_a_file_is_no_choice(empty_cwd, capsys):
    write(Path("conf/task"), "mine", MINE.replace(": ur10,", ": [ur10, ur10_gripper],"))
    told = "conf/task/mine.yaml:1: embodiment: takes one option, got [ur10, ur10_gripper]"
    assert told in said(capsys, "task=mine")


def test_the_line_that_chose_the_embodiment_is_told(empty_cwd, capsys):
    write(
        Path("conf/experiment"),
        "other",
        "# @package _global_\ndefaults:\n"
        "  - override /task: pick_place\n  - override /embodiment@task: ur10\n",
    )
    text = said(capsys, "experiment=other")
    assert text.startswith("error: conf/experiment/other.yaml:4: embodiment: ur10 lacks")
    own = "defaults:\n  - pick_place\n  - override /embodiment@_here_: ur10\n  - _self_\n"
    write(Path("conf/task"), "mine", f"{own}robot: {{init_pos: [0, 0, 0.7]}}\n")
    text = said(capsys, "task=mine")
    assert text.startswith("error: conf/task/mine.yaml:3: embodiment: ur10 lacks")


@pytest.mark.parametrize(
    ("task", "choice", "told"),
    [
        (
            "clutter_pick",
            "object@task.objects.mgu=can",
            "object@task.objects.mgu: no option is chosen there; places of this group: "
            "object@task.objects.ball, object@task.objects.bottle, object@task.objects.bowl, "
            "object@task.objects.mug. Did you mean 'object@task.objects.mug'?",
        ),
        (
            "clutter_pick",
            "object=can",
            "object: its place is missing: object@PLACE=NAME; places of this group: "
            "object@task.objects.ball, ",
        ),
        (
            "reach",
            "object=can",
            "places of this group: none. +object@PLACE=NAME adds one.",
        ),
        (
            "reach",
            "scene=studio",
            "scene: its place is missing: scene@PLACE=NAME; places of this group: "
            "scene@task.scene. ",
        ),
        ("reach", "embodiment@task.robot=panda", "places of this group: embodiment@task."),
        ("reach", "~scene@task.scen", "cannot delete it: no option is chosen there"),
    ],
)
def test_a_choice_without_a_place_is_told_the_places(capsys, task, choice, told):
    assert told in said(capsys, f"task={task}", choice)


def test_a_files_choice_without_a_place_is_told_its_line(empty_cwd, capsys):
    lines = "defaults:\n  - clutter_pick\n  - override /object@objects.mgu: can\n  - _self_\n"
    write(Path("conf/task"), "mine", f"{lines}description: Mine.\n")
    text = said(capsys, "task=mine")
    assert text.startswith("error: conf/task/mine.yaml:3: object@task.objects.mgu: no option is")
    assert "Did you mean 'object@task.objects.mug'?" in text


UR10 = """robot:
  fpath: UniversalRobots/UR10/UR10.urdf
  control_parts: {arm: ["Joint[1-6]"]}
  names: {tool: ee_link, base: base_link, shoulder: shoulder_link}
"""


def test_a_robot_of_another_name_is_told_the_name(empty_cwd, capsys):
    write(Path("conf/embodiment"), "nouid", UR10)
    write(Path("conf/embodiment"), "other", f"{UR10}  uid: arm\n")
    told = "task.robot.uid: tasks call it robot; write uid: robot"
    assert said(capsys, "task=reach", "embodiment=nouid") == (
        f"error: conf/embodiment/nouid.yaml:1: {told}"
    )
    assert said(capsys, "task=reach", "embodiment=other") == (
        f"error: conf/embodiment/other.yaml:5: {told}"
    )


def test_an_embodiment_that_cannot_load_is_not_advised(empty_cwd, capsys):
    mine = f"{UR10}  uid: robot\n"
    write(Path("conf/embodiment"), "nofile", mine.replace("UR10.urdf", "UR11.urdf"))
    write(Path("conf/embodiment"), "typo", f"{mine}  drive_prs: 1\n")
    text = said(capsys, "task=reach", "embodiment=go2")
    assert "Embodiments that have it: panda" in text
    assert "nofile" not in text and "typo" not in text


@pytest.mark.parametrize(
    ("task", "embodiment", "lacks"),
    [
        (
            "pick_place",
            "ur10",
            "ur10 lacks what the task needs: names left_finger, right_finger; grippers gripper. "
            "Embodiments that have it: panda, so101, ur10_gripper, ur5e.",
        ),
        ("reach", "go2", "go2 lacks what the task needs: names tool; control parts arm."),
        ("reach", "dual_ur10", "robots robot; names tool; control parts arm."),
        ("hand_over", "panda", "Embodiments that have it: dual_ur10."),
        ("quadruped_velocity", "ur10", "names feet, thighs. Embodiments that have it: go1, go2."),
    ],
)
def test_what_a_robot_lacks_is_one_mistake(capsys, task, embodiment, lacks):
    text = said(capsys, f"task={task}", f"embodiment={embodiment}")
    assert text.startswith("error: command line: embodiment: ") and lacks in text


def test_other_mistakes_are_told_as_well(capsys):
    text = said(capsys, "task=reach", "embodiment=go2", "task.rewards.near.wieght=1")
    assert text.startswith("2 mistakes:") and "task.rewards.near.wieght" in text


@pytest.mark.parametrize(
    ("names", "told"),
    [
        ("{tool: ee_lnk}", "names.tool: no link, site or geom matches 'ee_lnk'; links: base_link"),
        ("{tool: ee_link, base_link: ee_link}", "the file has a link 'base_link' already"),
        ("{tool: ee_link, 'a b': ee_link}", "'a b' is not a name"),
        ("{tool: []}", "names.tool: names nothing"),
        ("{tool: ['(']}", "malformed regex '('"),
        ("{tool: 3}", "task.robot.names.tool: expected text or a list, got 3"),
    ],
)
def test_a_wrong_name_is_one_mistake(empty_cwd, capsys, names, told):
    write(Path("conf/task"), "mine", MINE)
    write(Path("conf/embodiment"), "arm", f"defaults: [ur10, _self_]\nrobot: {{names: {names}}}")
    text = said(capsys, "task=mine", "embodiment=arm")
    assert told in text and not text.startswith(("2", "3"))


def test_a_misspelt_name_is_shown_with_those_there_are(empty_cwd, capsys):
    write(Path("conf/task"), "mine", MINE.replace("link: tool}}}}\nrew", "link: tol}}}}\nrew"))
    text = said(capsys, "task=mine")
    assert "names: tool, base, shoulder. Did you mean 'tool'?" in text


def test_names_are_valid_wherever_a_link_is_named(empty_cwd, capsys):
    write(Path("conf/task"), "mine", MINE)
    robot = (
        "robot:\n  names: {wrists: 'wrist_._link', pair: [ee_link, base_link]}\n"
        "  attachments: {tip: {link: tool, shape: {shape_type: Sphere, radius: 0.01}}}\n"
        "  collision_shapes: {wrists: null}\n  self_collision: {exclude: [[wrists, base]]}\n"
        "  contact: {base: {friction: [0.7, 0.01, 0.001]}}\n"
        "views: {hand: {body: robot/tool, eye: [0.1, 0, 0], target: [0, 0, 0]}}\n"
        "sensors: {touch: {sensor_type: contact, of: {uid: robot, link_names: [wrists]}}}\n"
        "events: {mass: {func: randomize, mode: reset, params: {of: {uid: robot, "
        "link_names: [wrists]}, mass: [0.9, 1.1], operation: scale}}}\n"
        "observations: {both: {func: link_pose, params: {of: {uid: robot, link_names: [pair]}}}}\n"
    )
    write(Path("conf/task"), "more", f"defaults: [mine, _self_]\n{robot}")
    assert main(["show", "task=more", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    named = {row["name"]: row["stands for"] for row in data["names of links"]}
    assert named["robot/tool"] == "ee_link" and named["robot/pair"] == "ee_link, base_link"
    assert named["robot/wrists"] == "wrist_1_link, wrist_2_link, wrist_3_link"
    terms = {row["term"]: row for row in data["observations"]}
    assert terms["both"]["shape"] == "(2, 7)"


def test_the_home_is_solved_where_the_task_gives_it():
    pose = {"pos": [0.6, 0.1, 1.2], "rot": [180, 0, 30]}
    at = "+task.robot.home={pos: [0.6, 0.1, 1.2], rot: [180, 0, 30]}"
    for embodiment in ("ur10", "ur10_gripper"):
        env = embodichain.make("reach", 1, ["seed=1", f"embodiment={embodiment}", at])
        pos = np.asarray(env.sim.robots["robot"].get_link_pose("tool"))[0, :3]
        env.close()
        assert pos == pytest.approx(pose["pos"], abs=1e-5)
    # A home that is there already keeps its digits.
    env = embodichain.make("pick_place", 1, ["seed=1"])
    assert env.robot.parsed.init_qpos[1] == -1.5617
    env.close()
    far = validate(compose(["task=reach", "+task.robot.home={pos: [9, 0, 1]}"]))
    assert [p.path for p in far] == ["task.robot.home.pos"]
    assert "the tool cannot be there: the nearest pose that was found is" in str(far[0])
    odd = validate(compose(["task=reach", "+task.robot.home={pos: [0.6, 0, 1], link: hand}"]))
    assert "no link is called 'hand'" in str(odd[0])


@pytest.mark.parametrize("task", ["reach", "reach_workspace", "push_cube", "press_button"])
def test_a_policy_fits_that_was_trained_when_the_robot_had_another_name(task):
    policy = load_policy(pretrained(task).file)
    env = embodichain.make(task, 1, ["seed=1"])
    obs, _ = env.reset()
    policy(obs, env)
    assert policy.changed == ()
    env.close()
    other = embodichain.make(task, 1, ["seed=1", "embodiment=ur10_gripper", "~task.expert"])
    if other.robot.parsed.joint_names != env.robot.parsed.joint_names:
        with pytest.raises(ConfigError, match="was trained in another task"):
            load_policy(pretrained(task).file)(other.reset()[0], other)
    other.close()


def test_list_and_new(empty_cwd, capsys):
    assert main(["list", "embodiments", "--json"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["embodiments"]}
    assert rows["ur10"]["names"] == "tool, base, shoulder"
    assert rows["dual_ur10"]["robots"] == "right, left"
    arm = CONF.parent / "data" / "assets" / "UniversalRobots" / "UR5e" / "UR5e.urdf"
    shutil.copy(arm, "my_arm.urdf")
    assert main(["new", "embodiment", "my_arm", "--robot", "my_arm.urdf"]) == 0
    out = capsys.readouterr().out
    for line in (
        "names.tool: ee_link (",
        "names.left_finger: ? (",
        "control_parts.arm: [",
        "names.base: base_link",
    ):
        assert line in out
    assert main(["validate", "task=reach", "embodiment=my_arm"]) == 0
    assert main(["new", "embodiment", "my_arm", "--robot", "my_arm.urdf"]) == 2
    assert main(["new", "embodiment", "panda", "--robot", "my_arm.urdf"]) == 2
    assert main(["new", "embodiment", "other"]) == 2


@pytest.mark.parametrize(
    ("task", "embodiment", "share"),
    [("reach", "ur10", None), ("reach_workspace", "ur10", None), ("reach", "so101", 0.25)],
)
def test_goals_are_drawn_in_for_a_shorter_arm_only(task, embodiment, share):
    env = embodichain.make(task, 1, ["seed=1", f"embodiment={embodiment}", "~task.expert"])
    env.reset()
    assert env.event_manager.terms["place_goal"].instance.fitted == {"reachable_by": share}
    env.close()


@pytest.mark.parametrize(("embodiment", "share"), [("ur10", None), ("panda", 0.45)])
def test_goals_are_drawn_in_until_their_orientations_are_reached(embodiment, share):
    words = ["seed=1", f"embodiment={embodiment}", "~task.expert"]
    env = embodichain.make("reach_pose", 1, words)
    env.reset()
    assert env.event_manager.terms["place_goal"].instance.fitted["reachable_by"] == share
    env.close()
    # In any orientation the Panda's tool comes further.
    if embodiment == "panda":
        env = embodichain.make(
            "reach_pose", 1, [*words, "~task.events.place_goal.params.turned_as"]
        )
        env.reset()
        assert env.event_manager.terms["place_goal"].instance.fitted["reachable_by"] == 0.9
        env.close()


def test_a_goal_has_the_orientation_of_the_tool():
    for embodiment, quat in (
        ("ur10", [0, 0, 1, 0]),
        ("ur10_gripper", [0, 0.5**0.5, -(0.5**0.5), 0]),
    ):
        env = embodichain.make(
            "reach_pose",
            1,
            [
                "seed=1",
                f"embodiment={embodiment}",
                "task.events.place_goal.params.rotation_range=null",
            ],
        )
        env.reset()
        goal = np.asarray(env.sim.rigid_objects["goal"].read_pose()[1])[0]
        assert goal == pytest.approx(quat, abs=1e-6)
        env.close()


def test_an_unknown_action_of_reachable_by_is_named(caplog):
    words = ["seed=1", "task.events.place_goal.params.reachable_by=amr"]
    embodichain.make("reach", 1, words).close()
    assert "no action 'amr' moves a tool; these do: arm" in caplog.text


@pytest.mark.slow
@pytest.mark.parametrize(("task", "embodiment"), PLAYED)
def test_the_expert_of_each_pair_of_the_table_succeeds(task, embodiment, empty_cwd, capsys):
    words = [f"task={task}", f"embodiment={embodiment}", "policy=expert", "seed=1", "record=none"]
    words += ["num_envs=4", "episodes=1", "scene_png=false", "--quiet", "--json"]
    assert main(["run", *words]) == 0
    assert json.loads(capsys.readouterr().out)["metrics"]["success"] >= 0.75

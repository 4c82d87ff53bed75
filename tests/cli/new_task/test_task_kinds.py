"""`new task --kind`: each kind for two robots, what is guessed of them, and what they cannot do."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

import embodichain
from embodichain.cli import main
from tests.helpers.commands import Commands
from tests.helpers.framed_robots import ARM, quadruped
from tests.helpers.invented_robots import GRIPPER_ARM, MOTOR_DOG, PLIERS

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

QUIET = ("-q", "-p", "no:cacheprovider")
_FILES = {
    "gripper_arm.xml": GRIPPER_ARM,
    "dog.xml": MOTOR_DOG,
    "quad.xml": quadruped(),
    "arm.xml": ARM,
    "pliers.xml": PLIERS,
}


@pytest.fixture(autouse=True)
def robots(empty_cwd: Path) -> None:
    """The robots' files lie in the working directory."""
    for name, text in _FILES.items():
        Path(name).write_text(text)


def new(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert main(["new", "task", *words, "--json"]) == 0, capsys.readouterr().err
    facts: dict[str, Any] = json.loads(capsys.readouterr().out)
    return facts


def error_of(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["new", "task", *words]) == 2
    return capsys.readouterr().err


def read(path: str) -> Any:
    return yaml.safe_load(Path(path).read_text())


def guesses_of(facts: dict[str, Any]) -> dict[str, str]:
    return {guess["key"]: guess["value"] for guess in facts["guessed"]}


@pytest.mark.parametrize(
    ("kind", "robot"),
    [
        ("reach", "gripper_arm.xml"),
        ("reach", "UniversalRobots/UR5e/UR5e.urdf"),
        ("push", "gripper_arm.xml"),
        ("push", "panda_description/urdf/panda.urdf"),
        ("pick", "gripper_arm.xml"),
        ("pick", "panda_description/urdf/panda.urdf"),
        ("velocity", "dog.xml"),
        ("velocity", "go1_description/urdf/go1.urdf"),
    ],
)
def test_a_task_of_each_kind_is_valid_and_steps(
    capsys: pytest.CaptureFixture[str], commands: Commands, kind: str, robot: str
) -> None:
    facts = new(capsys, "mine", "--kind", kind, "--robot", robot)
    embodiment, task, test = facts["wrote"]
    assert task == "conf/task/mine.yaml"
    assert test == "tests/test_mine.py"
    assert f"/embodiment@_here_: {Path(embodiment).stem}" in Path(task).read_text()
    assert main(["validate", "--train", "task=mine"]) == 0, capsys.readouterr().err
    if kind != "velocity":
        goal = read(task)["objects"]["goal"]
        assert goal["reached"]["by"] == ("robot/tool" if kind == "reach" else "cube")
        red, green, blue, _ = goal["shape"]["visual_material"]["base_color"]
        assert green < max(red, blue)  # green is for what was reached
    env = embodichain.make("mine", 2, ["seed=1"])
    env.reset()
    for _ in range(5):
        action = env.rand("test", env.single_action_space.shape, -0.5, 0.5)
        _, reward, *_, info = env.step(action)
        assert torch.isfinite(reward).all()
        assert not info["diverged"].any()
    env.close()
    if kind in ("push", "pick"):
        assert facts["expert"]["success"] >= 0.9
        assert _successes(16) >= 14
    if robot in _FILES:
        done = commands.run(test, *QUIET, program="pytest", safe_path=True)
        assert "4 passed" in done.stdout, done.stdout


def _successes(count: int) -> int:
    """Of so many episodes of the task `mine` by its expert, from a seed that was not tried."""
    from embodichain.lab.gym.policies import resolve_policy

    env = embodichain.make("mine", count, ["seed=7"])
    obs, _ = env.reset(seed=7)
    expert = resolve_policy("expert")
    successes = 0
    for _ in range(env.max_episode_steps):
        obs, _, terminated, truncated, info = env.step(expert(obs, env))
        successes += int((info["success"] & (terminated | truncated)).sum())
    env.close()
    return successes


def test_the_files_site_camera_pose_and_time_step_are_used(
    capsys: pytest.CaptureFixture[str],
) -> None:
    facts = new(capsys, "mine", "--kind", "reach", "--robot", "gripper_arm.xml")
    robot = read("conf/embodiment/gripper_arm.yaml")["robot"]
    assert robot["init_qpos"] == [0, 0.3, 1.2, 0, 0.9, 0, 0.04, 0.04]  # the end of a range too
    assert robot["grippers"]["gripper"] == {"open": 0.04, "close": 0}
    # The site is 9 cm above the hand; its x axis points there, and the tool's z axis has to.
    matrix = robot["solver_cfg"]["arm"]["tcp"]
    assert [row[2:] for row in matrix[:3]] == [[0, 0], [0, 0], [1, 0.09]]
    task = read("conf/task/mine.yaml")
    assert task["physics"]["physics_dt"] == 0.004
    assert task["sensors"]["wrist_cam"]["camera"] == "robot/wrist_cam"
    arm = ["waist", "shoulder", "elbow", "wrist1", "wrist2", "wrist3"]
    assert task["actions"]["arm"]["params"]["scale"] == dict.fromkeys(arm, 0.6)
    guesses = guesses_of(facts)
    assert guesses["sensors.wrist_cam"] == "wrist_cam"
    for key, value in guesses.items():
        section, _, name = key.partition(".")
        if section == "names":
            assert robot["names"][name] == value
    text = Path("conf/task/mine.yaml").read_text()
    assert all(f"#   {guess['key']}: " in text for guess in facts["guessed"][-3:])


def test_hinged_fingers_without_a_name_are_found(capsys: pytest.CaptureFixture[str]) -> None:
    """They close where the hinges turn them towards each other, and the tool is between them."""
    facts = new(capsys, "mine", "--kind", "pick", "--robot", "pliers.xml")
    robot = read("conf/embodiment/pliers.yaml")["robot"]
    assert {robot["names"]["left_finger"], robot["names"]["right_finger"]} == {"p", "q"}
    assert robot["control_parts"]["arm"] == ["a", "b", "c", "d", "e"]
    assert robot["grippers"]["gripper"]["close"] > robot["grippers"]["gripper"]["open"]
    x, y, z = (row[3] for row in robot["solver_cfg"]["arm"]["tcp"][:3])
    assert (x, y) == (0, 0)
    assert 0.05 < z < 0.09  # the fingers end 9 cm above the hand's origin
    assert facts["expert"]["success"] >= 0.9


def test_a_dog_of_motors_stands_on_drives(capsys: pytest.CaptureFixture[str]) -> None:
    new(capsys, "mine", "--kind", "velocity", "--robot", "dog.xml")
    robot = read("conf/embodiment/dog.yaml")["robot"]
    feet = [f"{side}_{end}_pad" for end in ("front", "hind") for side in ("left", "right")]
    assert robot["names"]["feet"] == feet
    assert set(robot["drive_pros"]["max_effort"].values()) == {30}
    # Its hind legs are those of the front, and left is right, turned outwards on both sides.
    abduct, swing, bend = robot["init_qpos"][:3]
    assert robot["init_qpos"] == [abduct, swing, bend, -abduct, swing, bend] * 2
    assert 0.08 < abduct < 0.1
    task = read("conf/task/mine.yaml")
    phases = task["rewards"]["gait"]["params"]["offsets"]
    assert phases["left_front_pad"] == phases["right_hind_pad"]
    assert phases["right_front_pad"] == phases["left_hind_pad"] != phases["left_front_pad"]
    assert task["rewards"]["gait"]["params"]["rest_height"] == pytest.approx(0.022, abs=2e-3)
    assert task["symmetry"]["swap"]["left_hind_bend"] == "right_hind_bend"
    assert "left_front_abduct" in task["symmetry"]["opposite"]
    assert "left_front_swing" not in task["symmetry"]["opposite"]


def test_the_legs_of_a_narrow_robot_are_spread_more(capsys: pytest.CaptureFixture[str]) -> None:
    """Its feet are as far from the middle as half of the height of its hips, on both sides."""
    narrow = MOTOR_DOG.replace('pos="0 0.08 0"', 'pos="0 0.02 0"')
    narrow = narrow.replace('pos="0 -0.08 0"', 'pos="0 -0.02 0"')
    Path("narrow.xml").write_text(narrow)
    new(capsys, "mine", "--kind", "velocity", "--robot", "narrow.xml")
    home = read("conf/embodiment/narrow.yaml")["robot"]["init_qpos"]
    abduct, swing, bend = home[:3]
    assert home == [abduct, swing, bend, -abduct, swing, bend] * 2
    # A hip is 8 cm from the middle, its joint 6 cm, and 0.28 m high: atan(0.08 / 0.28) less
    # atan(0.02 / 0.28).
    assert abduct == pytest.approx(0.207, abs=0.02)


@pytest.mark.parametrize(
    ("robot", "length"), [("dog.xml", 0.4), ("go1_description/urdf/go1.urdf", 0.426)]
)
def test_a_quadruped_that_is_pushed_stands_on_soft_drives(
    capsys: pytest.CaptureFixture[str], robot: str, length: float
) -> None:
    """Drives yield to the weight until legs have 0.7 of their length, and the trunk is level."""
    from embodichain.lab.gym.policies import resolve_policy

    new(capsys, "mine", "--kind", "velocity", "--robot", robot)
    env = embodichain.make("mine", 16, ["seed=1"])
    assert env.robot is not None
    obs, _ = env.reset()
    hold = resolve_policy("hold")
    for step in range(100):
        obs, _, terminated, _, _ = env.step(hold(obs, env))
        assert not terminated.any()
        if step == 24:  # later the feet slide outwards slowly
            height = float(env.robot.get_local_pose()[:, 2].median())
            assert height == pytest.approx(0.7 * length + 0.02, abs=0.02)
            assert abs(float(obs["gravity"][:, 0].median())) < 0.06
    env.close()


def test_the_feet_of_a_urdf_have_the_friction_of_rubber(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """An MJCF has friction of its own, and an arm does not walk."""
    for name, robot in (
        ("my_go1", "go1_description/urdf/go1.urdf"),
        ("dog", "dog.xml"),
    ):
        new(capsys, name, "--kind", "velocity", "--robot", robot)
    new(capsys, "arm", "--kind", "reach", "--robot", "UniversalRobots/UR5e/UR5e.urdf")
    assert read("conf/embodiment/my_go1.yaml")["robot"]["attrs"] == {"dynamic_friction": 1}
    assert "attrs" not in read("conf/embodiment/dog.yaml")["robot"]
    arms = [path for path in Path("conf/embodiment").iterdir() if "ur5e" in path.stem]
    assert arms
    assert all("attrs" not in read(str(path))["robot"] for path in arms)


def test_legs_that_only_swing_have_no_command_to_the_side(
    capsys: pytest.CaptureFixture[str],
) -> None:
    facts = new(capsys, "mine", "--kind", "velocity", "--robot", "quad.xml")
    ranges = read("conf/task/mine.yaml")["commands"]["velocity"]["params"]["ranges"]
    assert ranges["lin_vel_y"] == [0, 0]
    assert guesses_of(facts)["commands.sideways"] == "0"


def test_an_embodiment_that_exists_is_taken(capsys: pytest.CaptureFixture[str]) -> None:
    assert new(capsys, "one", "--kind", "reach")["wrote"] == [
        "conf/task/one.yaml",
        "tests/test_one.py",
    ]
    assert "/embodiment@_here_: ur10\n" in Path("conf/task/one.yaml").read_text()
    new(capsys, "two", "--kind", "reach", "--embodiment", "panda")
    assert "/embodiment@_here_: panda\n" in Path("conf/task/two.yaml").read_text()
    first = new(capsys, "three", "--kind", "reach", "--robot", "arm.xml")
    assert "conf/embodiment/arm.yaml" in first["wrote"]
    path = Path("conf/embodiment/arm.yaml")
    path.write_text(path.read_text().replace("gravcomp: 1", "gravcomp: 0.5"))
    second = new(capsys, "four", "--kind", "reach", "--robot", "arm.xml")
    assert second["wrote"] == ["conf/task/four.yaml", "tests/test_four.py"]
    assert "gravcomp: 0.5" in path.read_text()
    ships = new(capsys, "five", "--kind", "reach", "--robot", "panda_description/urdf/panda.urdf")
    assert ships["wrote"][0] == "conf/embodiment/my_panda.yaml"


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (("push", "dog.xml"), ["push needs an arm on a fixed base", "dog floats", "velocity"]),
        (("pick", "quad.xml"), ["pick needs an arm on a fixed base"]),
        (("velocity", "arm.xml"), ["velocity needs a robot that walks", "arm is fixed"]),
        (
            ("pick", "arm.xml"),
            ["arm lacks what the task needs: names.left_finger, names.right_finger, grippers.gr"],
        ),
        (("pikc", "arm.xml"), ["'pikc' is not one of", "'pick'"]),
    ],
)
def test_what_a_robot_cannot_do_is_one_mistake(
    capsys: pytest.CaptureFixture[str], words: tuple[str, str], parts: list[str]
) -> None:
    kind, robot = words
    error = error_of(capsys, "mine", "--kind", kind, "--robot", robot)
    assert all(part in error for part in parts)
    assert error.count("error:") == 1
    assert not Path("conf").exists()
    assert not Path("tests").exists()


def test_options_that_contradict_each_other_are_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    both = error_of(capsys, "mine", "--robot", "arm.xml", "--embodiment", "panda")
    assert "either --robot or --embodiment" in both
    assert "leave --kind" in error_of(capsys, "mine", "--kind", "reach", "--python")
    missing = error_of(capsys, "mine", "--embodiment", "pnada")
    assert "there is no embodiment 'pnada'" in missing
    assert "Did you mean 'panda'?" in missing
    assert main(["new", "embodiment", "mine", "--robot", "arm.xml", "--kind", "push"]) == 2
    assert "--kind goes with `new task`" in capsys.readouterr().err

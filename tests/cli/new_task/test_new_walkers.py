"""Robots from CAD: legs without feet, wheels, millimetres, and a mesh that is not a robot."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import embodichain
from embodichain.cli import main
from tests.helpers.cad_robots import CART, ant, crab, hand, insect, spider, two_arms
from tests.helpers.framed_robots import ARM

pytestmark = [pytest.mark.unmeasured]


@pytest.fixture(autouse=True)
def robots(empty_cwd: Path) -> None:
    Path("crab.urdf").write_text(crab())
    Path("spider.urdf").write_text(spider())
    Path("insect.urdf").write_text(insect())
    Path("sprawled.urdf").write_text(insect(hanging=1.57))
    Path("ant.xml").write_text(ant())
    Path("cart.urdf").write_text(CART)
    Path("arm.xml").write_text(ARM)


def new(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert main(["new", *words, "--json"]) == 0, capsys.readouterr().err
    facts: dict[str, Any] = json.loads(capsys.readouterr().out)
    return facts


def error_of(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["new", *words]) == 2
    return capsys.readouterr().err


def embodiment_of(
    capsys: pytest.CaptureFixture[str], file: str, *words: str
) -> tuple[dict[str, Any], dict[str, str]]:
    """The robot of a new embodiment, and what was guessed from what."""
    facts = new(capsys, "embodiment", "mine", "--robot", file, *words)
    robot = yaml.safe_load(Path("conf/embodiment/mine.yaml").read_text())["robot"]
    return robot, {guess["key"]: guess["why"] for guess in facts["guessed"]}


def robot_in(embodiment: str) -> dict[str, Any]:
    """The robot of an embodiment's file."""
    path = Path(f"conf/embodiment/{embodiment}.yaml")
    robot: dict[str, Any] = yaml.safe_load(path.read_text())["robot"]
    return robot


def test_equal_chains_of_a_urdf_are_legs(capsys: pytest.CaptureFixture[str]) -> None:
    robot, why = embodiment_of(capsys, "crab.urdf")
    assert robot["fix_base"] is False
    assert why["fix_base"] == "4 equal chains of 3 joints begin at base_link, as legs do"
    assert robot["names"]["feet"] == ["LF_tibia", "RF_tibia", "LH_tibia", "RH_tibia"]
    assert len(robot["control_parts"]["legs"]) == 12
    assert "arm" not in robot["control_parts"]
    assert "max_effort" not in robot["drive_pros"]
    assert (
        "efforts of 0 (LF_j0, LF_j1, LF_j2 and 9 more) are taken as no limit" in why["drive_pros"]
    )
    assert "--kind velocity --embodiment mine" in Path("conf/embodiment/mine.yaml").read_text()


def test_efforts_that_are_known_are_taken(capsys: pytest.CaptureFixture[str]) -> None:
    Path("crab.urdf").write_text(crab().replace('effort="0"', 'effort="30"', 11))
    robot, why = embodiment_of(capsys, "crab.urdf")
    assert robot["drive_pros"]["max_effort"] == "file"
    assert "efforts of 0 (RH_j2) are taken as no limit" in why["drive_pros"]


@pytest.mark.parametrize("end", ["tibia", "foot"])
def test_the_end_of_a_shank_stands_below_its_hip(
    capsys: pytest.CaptureFixture[str], end: str
) -> None:
    """Whatever it is called: its frame is at the knee."""
    Path("crab.urdf").write_text(crab(end=end))
    robot, why = embodiment_of(capsys, "crab.urdf")
    assert "legs bent until the feet are below the hips" in why["init_qpos"]
    _, femur, tibia = robot["init_qpos"][:3]
    hip_to_tip = 0.19 * np.sin(femur) + 0.2 * np.sin(femur + tibia)
    assert abs(hip_to_tip) < 0.08
    assert femur > 0.3


def test_a_walker_from_cad_stands(capsys: pytest.CaptureFixture[str]) -> None:
    from embodichain.lab.gym.policies import resolve_policy

    new(capsys, "task", "mine", "--kind", "velocity", "--robot", "crab.urdf")
    env = embodichain.make("mine", 16, ["seed=1"])
    obs, _ = env.reset()
    hold = resolve_policy("hold")
    for _ in range(20):
        obs, _, terminated, _, _ = env.step(hold(obs, env))
        assert not terminated.any()
    height = float(env.robot.get_local_pose()[:, 2].median())
    assert height == pytest.approx(0.7 * 0.39 + 0.02, abs=0.05)
    env.close()


@pytest.mark.parametrize(
    ("file", "legs"), [("spider.urdf", 6), ("insect.urdf", 6), ("sprawled.urdf", 6), ("ant.xml", 4)]
)
def test_legs_that_spread_stand_with_their_feet_below_the_trunk(
    capsys: pytest.CaptureFixture[str], file: str, legs: int
) -> None:
    robot, why = embodiment_of(capsys, file)
    assert robot["fix_base"] is False
    assert len(robot["names"]["feet"]) == legs
    assert "no such pose" not in why["init_qpos"]
    if file == "sprawled.urdf":  # it stands in the zero pose of its file
        assert not any(robot["init_qpos"])
    else:
        assert why["init_qpos"] == "legs spread and bent until the feet are below the trunk"
    assert robot["init_pos"][2] > 0.11


def test_six_legs_bear_the_weight_for_a_whole_episode(capsys: pytest.CaptureFixture[str]) -> None:
    """Each of their drives yields by 0.1 rad at most, which shows after hundreds of steps only."""
    from embodichain.lab.gym.policies import resolve_policy

    new(capsys, "task", "mine", "--kind", "velocity", "--robot", "insect.urdf")
    first_height = robot_in("insect")["init_pos"][2]
    env = embodichain.make("mine", 4, ["seed=1"])
    obs, _ = env.reset()
    hold = resolve_policy("hold")
    for _ in range(400):
        obs, _, terminated, _, _ = env.step(hold(obs, env))
        assert not terminated.any()
    height = float(env.robot.get_local_pose()[:, 2].min())
    assert height > 0.8 * first_height
    env.close()


def test_six_legs_walk_on_three_at_a_time(capsys: pytest.CaptureFixture[str]) -> None:
    new(capsys, "task", "mine", "--kind", "velocity", "--robot", "insect.urdf")
    task = yaml.safe_load(Path("conf/task/mine.yaml").read_text())
    phases = task["rewards"]["gait"]["params"]["offsets"]
    tripod = {"tibia_l0", "tibia_r1", "tibia_l2"}
    assert {foot for foot, phase in phases.items() if phase == phases["tibia_l0"]} == tripod
    assert len(phases) == 6
    eye = np.array(task["views"]["default"]["eye"])
    # All of it is within 0.41 m of the trunk's middle, and the lens is 35 degrees high.
    assert np.linalg.norm(eye) > 0.8


def test_the_height_follows_from_the_pose_that_is_written(
    capsys: pytest.CaptureFixture[str],
) -> None:
    new(capsys, "embodiment", "insect", "--robot", "insect.urdf")
    path = Path("conf/embodiment/insect.yaml")
    text = path.read_text()
    pose = 'init_qpos: {"j1.*": 0, "j2.*": 0.8, "j3.*": 0.77}'
    path.write_text(re.sub("init_qpos: .*", pose, text))
    new(capsys, "task", "mine", "--kind", "velocity", "--robot", "insect.urdf")
    assert "  init_pos: [0, 0, 0.22]" in Path("conf/task/mine.yaml").read_text()
    assert robot_in("insect")["init_pos"] == [0, 0, 0.15]
    assert main(["validate", "task=mine"]) == 0
    assert "below the ground" not in capsys.readouterr().err
    assert main(["validate", "task=mine", "task.robot.init_pos=[0,0,0.15]"]) == 0
    err = capsys.readouterr().err
    assert re.search(r"at the start tibia_.. is \d cm below the ground, and 5 other", err)


def test_a_robot_that_lies_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    stiff = re.sub('upper="(1.4|2.4)"', 'upper="0.05"', insect()).replace(
        'lower="-1.4"', 'lower="-0.05"'
    )
    stiff = stiff.replace('lower="-2.4"', 'lower="-0.05"')
    Path("stiff.urdf").write_text(stiff)
    _, why = embodiment_of(capsys, "stiff.urdf")
    assert "no such pose was found for tibia_l0" in why["init_qpos"]
    error = error_of(capsys, "task", "t", "--kind", "velocity", "--embodiment", "mine")
    assert "needs a pose in which mine stands" in error
    assert "Give init_qpos for j1_l0, j2_l0, j3_l0, j1_r0" in error
    assert not Path("conf/task/t.yaml").exists()


@pytest.mark.parametrize("text", [hand(), two_arms(), ARM])
def test_fingers_and_arms_are_not_legs(capsys: pytest.CaptureFixture[str], text: str) -> None:
    Path("other.xml").write_text(text)
    robot, _ = embodiment_of(capsys, "other.xml")
    assert "fix_base" not in robot
    assert "legs" not in robot["control_parts"]


def test_feet_are_named_where_no_guess_is_right(capsys: pytest.CaptureFixture[str]) -> None:
    robot, why = embodiment_of(capsys, "crab.urdf", "--feet", "LF_tibia,RF_tibia")
    assert robot["names"]["feet"] == ["LF_tibia", "RF_tibia"]
    assert why["fix_base"] == "--feet names what it stands on"
    error = error_of(
        capsys, "embodiment", "b", "--robot", "crab.urdf", "--feet", "LF_tibia,RF_tibja"
    )
    assert "has no link 'RF_tibja' Did you mean 'RF_tibia'?" in error
    error = error_of(capsys, "embodiment", "b", "--robot", "crab.urdf", "--feet", "base_link")
    assert "no hinge moves base_link" in error
    words = ("task", "b", "--kind", "reach", "--robot", "crab.urdf", "--feet", "LF_tibia")
    assert "--feet goes with --robot FILE" in error_of(capsys, *words)


def test_what_a_walker_lacks_is_answered_with_the_lines(
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = Path("conf/embodiment/crab.yaml")
    path.parent.mkdir(parents=True)
    path.write_text("robot: {uid: robot, fpath: crab.urdf, init_pos: [0, 0, 0.3]}\n")
    words = ("task", "walk", "--kind", "velocity", "--robot", "crab.urdf")
    error = error_of(capsys, *words)
    assert (
        "the base of crab is fixed (fix_base). Write them into conf/embodiment/crab.yaml" in error
    )
    assert "new embodiment" not in error
    lines = re.findall(r"^  (\S.*)$", error, re.MULTILINE)
    assert lines[0] == "fix_base: false"
    body = "\n  ".join(
        ["robot:", "uid: robot", "fpath: crab.urdf", "init_pos: [0, 0, 0.4]", *lines]
    )
    path.write_text(f"{body}\n  drive_pros: {{stiffness: 10, damping: 0.2, armature: 0.01}}\n")
    assert "conf/task/walk.yaml" in new(capsys, *words)["wrote"]


def test_an_arm_that_shall_walk_is_told_of_feet(capsys: pytest.CaptureFixture[str]) -> None:
    error = error_of(capsys, "task", "walk", "--kind", "velocity", "--robot", "arm.xml")
    assert "no equal chains of joints begin at its trunk" in error
    assert "--feet LINK,LINK names the links on which it stands" in error


@pytest.mark.parametrize("kind", ["reach", "push", "pick", "velocity", None])
def test_a_cart_is_said_to_have_wheels(
    capsys: pytest.CaptureFixture[str], kind: str | None
) -> None:
    words = ["--kind", kind] if kind else []
    error = error_of(capsys, "task", "mine", "--robot", "cart.urdf", *words)
    assert "no chain of its joints moves a tool or a leg: they turn wheels (jl, jr)" in error
    assert "docs/robots.md#wheels" in error
    assert not Path("conf").exists()


def test_the_embodiment_of_a_cart_drives_its_wheels(capsys: pytest.CaptureFixture[str]) -> None:
    robot, _ = embodiment_of(capsys, "cart.urdf")
    assert robot["control_parts"] == {"wheels": ["jl", "jr"]}
    assert robot["drive_pros"] == {"stiffness": 0, "damping": 1}
    assert robot["fix_base"] is False


def test_a_robot_in_millimetres_is_one_warning(capsys: pytest.CaptureFixture[str]) -> None:
    faces = [[(0, 0, 0), (30, 0, 0), (0, 30, 0)], [(0, 0, 0), (0, 30, 0), (0, 0, 60)]]
    faces += [[(0, 0, 0), (0, 0, 60), (30, 0, 0)], [(30, 0, 0), (0, 0, 60), (0, 30, 0)]]
    write_stl(Path("plate.stl"), faces)
    text = ARM.replace("<worldbody>", '<asset><mesh file="plate.stl"/></asset><worldbody>')
    text = text.replace('<geom type="cylinder" size="0.05 0.04"', '<geom type="mesh" mesh="plate"')
    Path("large.xml").write_text(text)
    says = 'the robot is 60 m high: are its meshes in millimetres? Write scale="0.001 0.001 0.001"'
    for words in (
        ["new", "embodiment", "mine", "--robot", "large.xml"],
        ["new", "task", "mine", "--kind", "reach", "--robot", "large.xml"],
        ["new", "task", "plain", "--robot", "large.xml"],
        ["validate", "task=mine"],
    ):
        assert main(words) == 0
        warnings = capsys.readouterr().err
        assert warnings.count(says) == 1, words
        assert "of plate" in warnings
    Path("mended.xml").write_text(text.replace('.stl"', '.stl" scale="0.001 0.001 0.001"'))
    assert main(["new", "embodiment", "mended", "--robot", "mended.xml"]) == 0
    assert "millimetres" not in capsys.readouterr().err


def write_stl(path: Path, faces: list[list[tuple[int, int, int]]]) -> None:
    records = b"".join(
        struct.pack("<12fH", 0, 0, 0, *(float(x) for point in face for x in point), 0)
        for face in faces
    )
    path.write_bytes(bytes(80) + struct.pack("<I", len(faces)) + records)


@pytest.mark.parametrize("name", ["hip.STL", "hip.obj", "hip.dae"])
def test_a_mesh_is_not_a_robot(capsys: pytest.CaptureFixture[str], name: str) -> None:
    Path(name).write_text("<COLLADA/>")
    error = error_of(capsys, "embodiment", "mine", "--robot", name)
    assert "is a shape, not a robot: a robot is a URDF or MJCF file" in error


@pytest.mark.parametrize("is_installed", [True, False])
def test_pytest_is_installed_before_it_is_run(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, is_installed: bool
) -> None:
    import importlib.util

    find_spec = importlib.util.find_spec
    if not is_installed:
        monkeypatch.setattr(
            importlib.util, "find_spec", lambda name: None if name == "pytest" else find_spec(name)
        )
    commands = new(capsys, "task", "mine")["next"]
    assert ("pip install pytest" in commands) is not is_installed
    assert "python -m pytest tests/test_mine.py" in commands

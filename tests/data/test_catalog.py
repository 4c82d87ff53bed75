"""What `list_robots` and `list_assets` show, and that everything shown is found by its name."""

import subprocess
import sys

import pytest

from embodichain.data import fault_of, get_data_path, list_assets, list_robots
from tests.data.robot_catalog import LOADABLE, NOT_LOADABLE, REPAIRED


@pytest.fixture(autouse=True)
def world(tmp_path, monkeypatch):
    monkeypatch.setenv("EMBODICHAIN_DATA_ROOT", str(tmp_path / "store"))
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("MENAGERIE_CACHE_DIR", str(tmp_path / "menagerie"))
    monkeypatch.delenv("MENAGERIE_PATH", raising=False)
    monkeypatch.delenv("MENAGERIE_ROOT", raising=False)
    return tmp_path


def put(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_every_robot_is_found_by_its_name():
    robots = list_robots()
    assert {robot.source for robot in robots} == {"bundled", "example-robot-data"}
    assert len({robot.name for robot in robots}) == len(robots)
    for robot in robots:
        assert get_data_path(robot.name) == str(robot.path)


def test_bundled_robots_come_before_those_of_packages():
    first = [(robot.name, robot.source, robot.format) for robot in list_robots()[:6]]
    assert first == [
        ("Cabinet/cabinet.xml", "bundled", "mjcf"),
        ("CartPole/cart_pole.urdf", "bundled", "urdf"),
        ("ParallelGripper/parallel_gripper.xml", "bundled", "mjcf"),
        ("PegHole/peg_hole.xml", "bundled", "mjcf"),
        ("PushButton/push_button.xml", "bundled", "mjcf"),
        ("UniversalRobots/UR10/UR10.urdf", "bundled", "urdf"),
    ]


def test_models_are_told_from_other_xml_and_scenes(world):
    put(world / "store/mine/arm.xml", "<!-- an arm -->\n<mujoco model='arm'/>")
    put(world / "store/mine/package.xml", "<package/>")
    put(world / "store/mine/mesh.stl", "solid")
    put(world / "store/.trash/arm.urdf", "<robot/>")
    put(world / "cache/mujoco_menagerie/hand/hand.xml", "<mujoco/>")
    put(world / "cache/mujoco_menagerie/hand/scene_left.xml", "<mujoco/>")
    robots = {robot.name: (robot.source, robot.format) for robot in list_robots()}
    assert robots["mine/arm.xml"] == ("EMBODICHAIN_DATA_ROOT", "mjcf")
    assert robots["menagerie:hand"] == ("menagerie", "mjcf")
    names = " ".join(robots)
    assert "package.xml" not in names
    assert "scene_left" not in names
    assert ".trash" not in names


def test_a_shadowed_name_is_listed_once_from_where_it_is_found(world):
    own = put(world / "store/UniversalRobots/UR10/UR10.urdf", "<robot/>")
    found = [robot for robot in list_robots() if robot.name == "UniversalRobots/UR10/UR10.urdf"]
    assert [(robot.path, robot.source) for robot in found] == [(own, "EMBODICHAIN_DATA_ROOT")]


def test_assets_are_robots_and_own_files(world):
    put(world / "store/cups/cup.obj", "v 0 0 0")
    assets = {asset.name: asset for asset in list_assets()}
    assert assets["cups/cup.obj"].format == "obj"
    assert assets["UniversalRobots/UR10/visual/base_housing.obj"].source == "bundled"
    assert {robot.name for robot in list_robots()} <= set(assets)
    for asset in assets.values():
        assert get_data_path(asset.name) == str(asset.path)


def test_the_catalogue_of_the_tests_covers_example_robot_data():
    """`robot_catalog` is what the compiler's tests go by: no robot may be missing from it."""
    installed = [robot.name for robot in list_robots() if robot.source == "example-robot-data"]
    assert sorted([*LOADABLE, *NOT_LOADABLE]) == sorted(installed)
    assert len(LOADABLE) == 67
    assert REPAIRED.keys() <= LOADABLE.keys()


@pytest.mark.unmeasured
def test_listing_imports_neither_torch_nor_mujoco():
    code = (
        "import sys; from embodichain.data import list_robots; list_robots(); "
        "print(sorted({'torch', 'mujoco', 'numpy'} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_what_cannot_load_is_told_from_the_text_alone(world):
    faults = {
        robot.name: fault
        for robot in list_robots()
        if robot.source == "example-robot-data" and (fault := fault_of(robot.path))
    }
    assert faults.keys() == NOT_LOADABLE.keys()
    assert all(reason in faults[name] for name, reason in NOT_LOADABLE.items())
    broken = {"a.urdf": "<robot>", "b.urdf": "<robot xmlns:xacro='http://xacro'><xacro:a/></robot>"}
    broken |= {"c.xml": "<mujoco><asset/></mujoco>", "d.xml": "<mujoco><worldbody/></mujoco>"}
    words = ["not well-formed XML", "xacro", "no <worldbody>", ""]
    for (name, text), word in zip(broken.items(), words, strict=True):
        fault = fault_of(put(world / name, text))
        assert word in fault and bool(word) == bool(fault)

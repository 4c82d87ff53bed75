"""A mistake in a robot is reported once, whatever else names the robot."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

import embodichain
from embodichain.cli import main
from embodichain.utils.errors import Problem

Mistakes = Callable[..., list[str]]

TOUCH = """
defaults: [/scene@scene: studio, /embodiment@_here_: ur10, _self_]
description: Bring the tool to a ball.
robot: {init_pos: [0, 0, 1]}
scene: {pedestal: {collision: false}}
objects:
  ball:
    shape: {shape_type: Sphere, radius: 0.03}
    body_type: kinematic
    reached: {by: robot/tool, within: 0.05}
views: {front: {body: robot/tool, eye: [1, 0, 0]}}
actions:
  arm: {func: joint_action, params: {of: {uid: robot, control_parts: arm}, scale: 0.6}}
observations:
  way: {func: relative_position, params: {from: {uid: robot, link: tool}, to: {uid: ball}}}
suggested: {train: {num_envs: 4}}
"""


@pytest.fixture(autouse=True)
def touch(empty_cwd: Path) -> None:
    folder = empty_cwd / "conf" / "task"
    folder.mkdir(parents=True)
    (folder / "touch.yaml").write_text(TOUCH)


@pytest.fixture
def mistakes(capsys: pytest.CaptureFixture[str]) -> Mistakes:
    """What `embodichain validate` prints of the task with overrides."""

    def found(*lines: str) -> list[str]:
        capsys.readouterr()
        main(["validate", "--json", "task=touch", *lines])
        problems = json.loads(capsys.readouterr().out).get("mistakes", [])
        return [str(Problem(**problem)) for problem in problems]

    return found


@pytest.mark.parametrize(
    "line",
    [
        "task.robot.fpath=meshes/nothere.urdf",
        "task.robot.init_qpos=[0,-90,90,-90,0,0]",
        "task.robot.init_qpos=[0,1]",
        "task.robot.init_pos=[0,0]",
        "task.robot.init_pos=[0,0,x]",
        "+task.robot.control_partz={}",
        'task.robot.control_parts={arm: ["Jiont[1-6]"]}',
        "task.robot.names.tool=Clamp_C",
        "task.robot.drive_pros.stiffness={Jiont: 10}",
        "task.robot.drive_pros.damping=-1",
        "++task.robot.locked_joints={Jiont1: 0}",
        "++task.robot.attach={hand: {fpath: nothere.urdf, to: tool}}",
    ],
)
def test_one_mistake_of_a_robot_is_one_line(line: str, mistakes: Mistakes) -> None:
    key = line.partition("=")[0].lstrip("+")
    found = mistakes(line)
    assert len(found) == 1, found
    assert key in found[0]


@pytest.mark.parametrize("by", ["robbot/tool", "robot/toll", "robbot"])
def test_an_unknown_name_in_a_mark_is_one_mistake(by: str, mistakes: Mistakes) -> None:
    found = mistakes(f"task.objects.ball.reached.by={by}")
    assert len(found) == 1, found
    assert "task.objects.ball.reached.by: no " in found[0]


def test_a_mark_is_silent_about_an_object_that_is_wrong_itself(mistakes: Mistakes) -> None:
    found = mistakes(
        "+task.objects.cube={shape: {shape_type: Cube, size: [1, 1, -1]}}",
        "task.objects.ball.reached.by=cube/geom",
    )
    assert len(found) == 1, found
    assert "task.objects.cube.shape.size" in found[0]


def test_positions_in_degrees_are_one_mistake_with_radians(mistakes: Mistakes) -> None:
    (found,) = mistakes("task.robot.init_qpos=[0,-90,90,-90,0,0]")
    assert found.count("joint 'Joint2' starts at -90, outside its limits") == 1
    assert "joint 'Joint4' starts at -90" in found
    assert found.endswith("In degrees? -90 degrees are -1.5708 rad.")


def test_a_position_that_is_not_in_degrees_either_has_no_hint(mistakes: Mistakes) -> None:
    (found,) = mistakes("task.robot.init_qpos=[0,-9000,0,0,0,0]")
    assert "degrees" not in found


def test_a_locked_joint_in_degrees(mistakes: Mistakes) -> None:
    (found,) = mistakes("++task.robot.locked_joints={Joint2: 90}")
    assert found.endswith("In degrees? 90 degrees are 1.5708 rad.")


@pytest.mark.parametrize(
    "line",
    [
        "task.robot.control_parts=3",
        "task.robot.control_parts=[a]",
        "task.robot.control_parts.arm=3",
        "task.robot.names=3",
        "task.robot.names=[1,2]",
        "task.robot.names.tool=[3]",
    ],
)
def test_names_of_a_wrong_kind_are_one_mistake(line: str, mistakes: Mistakes) -> None:
    found = mistakes(line)
    assert len(found) == 1, found
    assert line.partition("=")[0] in found[0]


@pytest.mark.parametrize(
    "line",
    [
        "task.robot.init_qpos=[0,1]",
        'task.robot.control_parts.arm=["Jiont[1-6]"]',
        "task.robot.solver_cfg.arm.end_link_name=ee_lnik",
        "task.robot.solver_cfg.arm.tcp=[1,2]",
    ],
)
def test_a_tool_point_that_a_mistake_leaves_out(line: str, mistakes: Mistakes) -> None:
    """`names.tool` stands for the link that `solver_cfg` adds where nothing is wrong."""
    tcp = "[[1,0,0,0],[0,1,0,0],[0,0,1,0.1],[0,0,0,1]]"
    solver = f"+task.robot.solver_cfg={{arm: {{end_link_name: ee_link, tcp: {tcp}}}}}"
    tool = "task.robot.names.tool=arm_tcp"
    assert mistakes(solver, tool) == []
    found = mistakes(solver, tool, line)
    assert len(found) == 1, found


JOINT = "task.actions.arm.params.of={uid: robot, joint_names: [shoulder_pan, Joint7]}"


@pytest.mark.slow
def test_joints_that_the_robot_of_the_file_lacks(mistakes: Mistakes) -> None:
    pan, seventh = mistakes("~task.actions.arm.params.of", JOINT)
    start = "command line: task.actions.arm.params.of.joint_names: no joint of 'robot' matches "
    there = "there are: Joint1, Joint2, Joint3, Joint4, Joint5, Joint6. "
    assert pan == f"{start}'shoulder_pan'; {there}Embodiments that have it: so101."
    assert seventh == f"{start}'Joint7'; {there}Did you mean 'Joint1'?"


@pytest.mark.slow
def test_joints_that_a_chosen_robot_lacks(mistakes: Mistakes) -> None:
    lacks, seventh = mistakes("~task.actions.arm.params.of", JOINT, "embodiment=ur10")
    assert lacks.startswith("command line: embodiment: ur10 lacks what the task needs: joints sh")
    assert "joint_names: no joint of 'robot' matches 'Joint7'" in seventh


def test_a_link_that_does_not_exist_is_answered_with_the_names_too() -> None:
    env = embodichain.make("touch", 1)
    try:
        with pytest.raises(ValueError, match=r"has no link 'toll'.*; names: tool, base.*'tool'\?"):
            env.sim.get_robot("robot").get_link_pose("toll")
    finally:
        env.close()

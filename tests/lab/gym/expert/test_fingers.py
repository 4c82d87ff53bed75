"""The line along which fingers move is read from the model, and steps turn grippers to it."""

import re

import numpy as np
import pytest
import torch
import yaml

import embodichain
from embodichain.cli import main
from embodichain.lab.gym.expert.arms import arms_of
from embodichain.lab.gym.expert.fingers import read_fingers
from embodichain.lab.gym.expert.policy import Expert
from embodichain.utils.errors import ConfigError

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

ARM = """<mujoco><compiler angle="degree"/><worldbody><body name="base">
 <geom size=".05" mass="1"/>
 <body name="x" pos="0 0 1"><joint name="ax" type="slide" axis="1 0 0" range="-1 1"/>
  <geom size=".02" mass="1" contype="0" conaffinity="0"/>
  <body name="z"><joint name="az" type="slide" axis="0 0 1" range="-1 1"/>
   <geom size=".02" mass="1" contype="0" conaffinity="0"/>
   <body name="turn"><joint name="aturn" axis="0 0 1" range="-180 180"/>
    <geom size=".02" mass="1" contype="0" conaffinity="0"/>
    <body name="tool" quat="0 1 0 0">HAND</body>
 </body></body></body></body></worldbody>
 <actuator>
  <position name="ax" joint="ax" kp="5000" kv="300"/>
  <position name="az" joint="az" kp="5000" kv="300"/>
  <position name="aturn" joint="aturn" kp="50" kv="5"/> DRIVE
 </actuator>MORE</mujoco>"""
"""An arm whose tool points down; angles of what is in its hand are in the tool's frame."""


def slides(angle):
    """Two fingers that slide along a line at an angle (degrees) to the tool's x axis."""
    return f"""<body name="hand" euler="0 0 {angle}">
      <body name="left" pos=".04 0 .1"><joint name="left" type="slide" axis="1 0 0" range="-.04 0"/>
       <geom type="box" size=".005 .01 .03" mass=".05"/></body>
      <body name="right" pos="-.04 0 .1">
       <joint name="right" type="slide" axis="1 0 0" range="0 .04"/>
       <geom type="box" size=".005 .01 .03" mass=".05"/></body></body>"""


HINGES = """<body name="left" pos="0 .03 .02"><joint name="left" axis="1 0 0" range="0 40"/>
     <geom type="capsule" fromto="0 0 0 0 .02 .1" size=".005" mass=".05"/></body>
    <body name="right" pos="0 -.03 .02"><joint name="right" axis="1 0 0" range="-40 0"/>
     <geom type="capsule" fromto="0 0 0 0 -.02 .1" size=".005" mass=".05"/></body>"""
SPREAD_OUT = HINGES.replace("0 .02 .1", "0 .1 0").replace("0 -.02 .1", "0 -.1 0")
"""Fingers that lie in the plane of the palm at the reference: their tips move along z."""
FOUR_BARS = "".join(
    f"""<body name="{side}_driver" pos="0 {s}.03 .02">
     <joint name="{side}_driver" axis="1 0 0" range="-60 60"/>
     <geom type="capsule" fromto="0 0 0 0 {s}.03 .03" size=".004" mass=".02"/>
     <body name="{side}_pad" pos="0 {s}.03 .03"><joint name="{side}_pad" axis="1 0 0"/>
      <geom type="box" pos="0 0 .03" size=".01 .004 .03" mass=".02"/></body></body>
    <body name="{side}_bar" pos="0 {s}.01 .03"><joint name="{side}_bar" axis="1 0 0"/>
     <geom type="capsule" fromto="0 0 0 0 {s}.03 .03" size=".004" mass=".02"
      contype="0" conaffinity="0"/></body>"""
    for side, s in (("left", ""), ("right", "-"))
)
"""Parallelograms, as in a Robotiq 2F-85: a driver, a bar beside it, and the pad that both carry."""
LOOPS = """<equality>
  <connect body1="left_bar" body2="left_pad" anchor="0 .03 .03"/>
  <connect body1="right_bar" body2="right_pad" anchor="0 -.03 .03"/>
  <joint joint1="right_driver" joint2="left_driver" polycoef="0 -1 0 0 0"/></equality>
 <tendon><fixed name="both"><joint joint="left_driver" coef=".5"/>
  <joint joint="right_driver" coef="-.5"/></fixed></tendon>"""
COUPLED = """<equality><joint joint1="right" joint2="left" polycoef="0 -1 0 0 0"/></equality>"""
STRING = """<tendon><fixed name="both"><joint joint="left" coef="1"/>
  <joint joint="right" coef="-1"/></fixed></tendon>"""
THREE = "".join(
    f"""<body name="f{i}" euler="0 0 {120 * i}">
     <joint name="f{i}" axis="0 1 0" pos=".03 0 .02" range="-40 40" armature=".01"/>
     <geom type="capsule" fromto=".03 0 .02 .05 0 .1" size=".005" mass=".05"/></body>"""
    for i in range(3)
)
PRESS = """<body name="left" pos="0 0 .1">
  <joint name="left" type="slide" axis="0 0 1" range="0 .04"/>
  <geom type="box" size=".005 .01 .03" mass=".05"/></body>"""


def servo(*names, of="joint"):
    return "".join(
        f'<position name="{name}" {of}="{name}" kp="100" ctrlrange="-.1 .1"/>' for name in names
    )


GRIPPERS = {
    "slides along x": (slides(0), servo("left", "right"), "", 0.0),
    "slides along y": (slides(90), servo("left", "right"), "", 0.5 * np.pi),
    "slides at 30 degrees": (slides(30), servo("left", "right"), "", np.pi / 6),
    "slides at -45 degrees": (slides(135), servo("left", "right"), "", -0.25 * np.pi),
    "one that is driven, one that follows": (slides(90), servo("left"), COUPLED, 0.5 * np.pi),
    "one that is driven, one that is loose": (slides(90), servo("left"), "", 0.5 * np.pi),
    "a tendon": (slides(30), servo("both", of="tendon"), STRING, np.pi / 6),
    "hinges": (HINGES, servo("left", "right"), "", 0.5 * np.pi),
    "hinges, spread out": (SPREAD_OUT, servo("left", "right"), "", 0.5 * np.pi),
    "closed loops": (FOUR_BARS, servo("both", of="tendon"), LOOPS, 0.5 * np.pi),
}


@pytest.fixture
def task(tmp_path):
    """Writes a task with a gripper; returns the overrides and the folder of configs."""

    def write(hand, drive, more, steps=None, commands=(-0.1, 0.1), **params):
        text = ARM.replace("HAND", hand).replace("DRIVE", drive).replace("MORE", more)
        (tmp_path / "arm.xml").write_text(text)
        names = re.findall(r"name=.(\w+)", drive)
        low, high = commands
        gripper = {
            "of": {"uid": "arm"},
            "actuator_names": names,
            "command_mode": "binary",
            "open_command": dict.fromkeys(names, high)
            | ({"right": low} if "right" in names else {}),
            "close_command": dict.fromkeys(names, low)
            | ({"right": high} if "right" in names else {}),
            **params,
        }
        arm = {"of": {"uid": "arm", "control_parts": "arm"}}
        file = {
            "description": "A gripper over a block.",
            "robot": {
                "uid": "arm",
                "fpath": str(tmp_path / "arm.xml"),
                "gravcomp": 1,
                "control_parts": {"arm": ["ax", "az", "aturn"]},
                "solver_cfg": {"arm": {"end_link_name": "tool"}},
            },
            "objects": {
                "block": {
                    "shape": {"shape_type": "Cube", "size": [0.02, 0.3, 0.02]},
                    "init_pos": [0.0, 0.0, 0.5],
                    "init_rot": [0, 0, 20],
                    "body_type": "kinematic",
                    "attrs": {"enable_collision": False},
                }
            },
            "actions": {
                "tool": {"func": "eef_delta_pose", "params": arm},
                "grip": {"func": "parallel_gripper", "params": gripper},
            },
            "max_episode_steps": 200,
            "expert": steps or [{"lift": 0.1}],
        }
        (tmp_path / "task").mkdir(exist_ok=True)
        (tmp_path / "task" / "gripper.yaml").write_text(yaml.safe_dump(file, sort_keys=False))
        return tmp_path

    return write


@pytest.mark.parametrize("name", GRIPPERS)
def test_the_line_is_that_of_the_joints(name, task):
    hand, drive, more, angle = GRIPPERS[name]
    env = embodichain.make("gripper", config_dir=task(hand, drive, more))
    try:
        ((_, arm),) = arms_of(env)
        found = read_fingers(arm)
        assert found.reason == ""
        assert found.angle == pytest.approx(angle, abs=1e-4)
        bodies = {env.sim.engine.model.body(body).name for body in found.bodies}
        left = [one for one in bodies if "left" in one]
        assert left and all(one.startswith("arm/") for one in bodies)
        assert not bodies & {"arm/tool", "arm/hand", "arm/turn"}
        assert any("right" in one for one in bodies) == ("loose" not in name)
    finally:
        env.close()


@pytest.mark.parametrize("angle", [0, 90, 30])
@pytest.mark.parametrize("symmetry", [2, 4])
def test_a_step_turns_the_fingers_to_the_target(angle, symmetry, task):
    """The block is turned by 20 degrees; seen from above the tool's axes turn the other way."""
    aim = {"to": "block", "offset": [0, 0, 0.3], "align": "block", "symmetry": symmetry}
    steps = [{"move_to": {**aim, "tolerance": 0.005}}]
    folder = task(slides(angle), servo("left", "right"), "", steps)
    env = embodichain.make("gripper", config_dir=folder)
    try:
        policy = Expert()
        policy_steps = env.cfg.expert
        assert policy_steps == steps
        obs, _ = env.reset()
        for _ in range(150):
            obs, *_ = env.step(policy(obs, env))
            if policy.done.all():
                break
        assert policy.failures == [None]
        hand = env.sim.robots["arm"].get_link_pose("hand", to_matrix=True)[0].numpy()
        heading = np.degrees(np.arctan2(hand[1, 0], hand[0, 0]))
        part = 360 / symmetry
        assert abs((heading - 20 + part / 2) % part - part / 2) < 2.0
    finally:
        env.close()


UNCLEAR = {
    "three fingers": (THREE, servo("f0", "f1", "f2"), "its fingers do not move along one line"),
    "along z": (PRESS, servo("left"), "its fingers do not move across the tool's z axis"),
}


@pytest.mark.parametrize("name", UNCLEAR)
def test_what_is_not_clear_must_be_given(name, task, monkeypatch, capsys):
    hand, drive, reason = UNCLEAR[name]
    steps = [{"grasp": {"of": "block", "symmetry": 2}}]
    folder = task(hand, drive, "", steps)
    monkeypatch.chdir(folder)
    assert main(["validate", f"--config-dir={folder}", "task=gripper"]) == 2
    said = capsys.readouterr().err
    assert "task.actions.grip.params.finger_axis: needed by expert.0.grasp" in said
    assert reason in said
    assert "x, y or a vector in the tool's frame" in said
    other = "task.expert=[{grasp: {of: block, align: false}}]"
    assert main(["validate", f"--config-dir={folder}", "task=gripper", other]) == 0
    given = "+task.actions.grip.params.finger_axis=y"
    assert main(["validate", f"--config-dir={folder}", "task=gripper", given]) == 0


def test_suction_is_turned_by_the_tools_x_axis(task):
    suction = '<adhesion name="suction" body="tool" ctrlrange="0 1" gain="5"/>'
    steps = [{"grasp": {"of": "block", "symmetry": 2}}]
    pad = '<geom type="box" size=".02 .02 .005" mass=".1"/>'
    env = embodichain.make("gripper", config_dir=task(pad, suction, "", steps, (0, 1)))
    ((_, arm),) = arms_of(env)
    found = read_fingers(arm)
    assert (found.bodies, found.angle) == (frozenset(), 0.0)
    env.close()


@pytest.mark.parametrize(
    ("axis", "angle"), [("x", 0.0), ("y", 0.5 * np.pi), ([1, 1, 0], 0.25 * np.pi),
                        ([-1, 1, 0], -0.25 * np.pi), ([-2, 0, 0.1], 0.0)],
)  # fmt: skip
def test_what_is_given_counts(axis, angle, task):
    folder = task(slides(30), servo("left", "right"), "", finger_axis=axis)
    env = embodichain.make("gripper", config_dir=folder)
    ((_, arm),) = arms_of(env)
    assert read_fingers(arm).angle == pytest.approx(angle)
    env.close()


@pytest.mark.parametrize("axis", [[0, 0, 1], [0, 0, 0]])
def test_an_axis_must_be_across_the_tools_z_axis(axis, task):
    folder = task(slides(30), servo("left", "right"), "", finger_axis=axis)
    with pytest.raises(
        ConfigError, match=r"grip\.params\.finger_axis: must be across the tool's z"
    ):
        embodichain.make("gripper", config_dir=folder)


def test_a_panda_grasps_a_bar_across():
    """Its fingers move along the tool's y axis, 8 cm apart at most; the bar is 3 x 20 x 3 cm."""
    bar = "task.objects.cube.shape.size=[0.03,0.2,0.03]"
    low = "task.objects.cube.init_pos=[0.5,0,0.015]"
    turned = "+task.events.place_cube.params.rotation_range=[[0,0,75],[0,0,105]]"
    env = embodichain.make("lift_cube", num_envs=8, overrides=["seed=3", bar, low, turned])
    try:
        policy = Expert([{"grasp": {"of": "cube", "symmetry": 2}}, {"lift": 0.15}])
        obs, _ = env.reset()
        while not (len(policy.done) and policy.done.all()):
            obs, *_ = env.step(policy(obs, env))
        assert list(policy.failures) == [None] * 8
        height = env.sim.get_rigid_object("cube").get_local_pose()[:, 2]
        assert (height > 0.1).all()
        assert torch.isfinite(height).all()
    finally:
        env.close()

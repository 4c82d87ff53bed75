"""Rewards of moving bodies: the cube stands for a robot's base, the arm's tool for a link."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import CommandCfg, RewardCfg
from embodichain.lab.sim.cfg import RobotCfg
from embodichain.utils.errors import ConfigError
from embodichain.utils.math import quat_multiply
from tests.helpers.judging import bend, move, put, reward, turned
from tests.helpers.ur10_task import HOME, UR10, builder

CUBE = {"entity_cfg": {"uid": "cube"}}
TOOL = {"entity_cfg": {"uid": "ur10", "link_names": ["ee_link"]}}
UP = (0, 0, 1)
SPEED = {"lin_vel_x": [1.0, 1.0], "lin_vel_y": [0.5, 0.5], "ang_vel_z": [-1.0, -1.0]}
POSE = [[0.1, 0.2, 0.3], [0.1, 0.2, 0.3]]
TURN = [[0, 0, 0.4], [0, 0, 0.4]]


@pytest.fixture(scope="module")
def scene() -> Iterator[Any]:
    """Commands: 1 and 0.5 m/s, -1 rad/s; and a pose in the frame of the arm's root, turned."""
    pose = {**TOOL, "position_range": POSE, "euler_range": TURN}
    with builder() as build:
        env = build(
            robot=RobotCfg(
                uid="ur10", fpath=UR10, init_pos=(0, 0, 1), init_rot=(0, 0, 90), init_qpos=HOME
            ),
            commands={
                "v": CommandCfg(func="uniform_velocity", params={**CUBE, "ranges": SPEED}),
                "still": CommandCfg(func="uniform_velocity", params={**CUBE, "ranges": {}}),
                "pose": CommandCfg(func="uniform_pose", params=pose),
            },
        )
        env.reset()
        yield env


def test_a_velocity_is_tracked_in_the_bodys_axes(scene) -> None:
    """Turned by 90 degrees, the body moves ahead at 1 m/s when the world sees +y."""
    put(scene, "cube", (0, 0, 3), turned(UP, math.pi / 2))
    move(scene, "cube", [(-0.5, 1, 0), (-0.5, 1.3, 0), (0.5, -1, 0)])
    params = {**CUBE, "command_name": "v", "std": 0.5}
    expected = [1.0, math.exp(-0.09 / 0.25), math.exp(-(1 + 4) / 0.25)]
    for frame in ("body", "yaw"):
        found = reward(scene, "track_lin_vel_xy_exp", **params, frame=frame)
        assert found == pytest.approx(expected, abs=1e-6)
    found = reward(scene, "track_lin_vel_xy_exp", **params, frame="world")
    errors = [1.5**2 + 0.5**2, 1.5**2 + 0.8**2, 0.5**2 + 1.5**2]
    assert found == pytest.approx([math.exp(-e / 0.25) for e in errors], abs=1e-6)


def test_the_heading_frame_stays_level_when_the_body_tilts(scene) -> None:
    """Pitched by 60 degrees, a level speed of 1 m/s ahead is 0.5 along the body's x axis."""
    put(scene, "cube", (0, 0, 3), turned((0, 1, 0), math.pi / 3))
    move(scene, "cube", (1.0, 0.5, 0.0))
    params = {**CUBE, "command_name": "v", "std": 0.5}
    assert reward(scene, "track_lin_vel_xy_exp", **params, frame="yaw") == [1.0] * 3
    found = reward(scene, "track_lin_vel_xy_exp", **params)
    assert found == pytest.approx([math.exp(-0.25 / 0.25)] * 3, abs=1e-6)
    # Its x axis straight up, a body has no heading: the world's x axis is taken.
    put(scene, "cube", (0, 0, 3), [0.5, -0.5, -0.5, -0.5])
    move(scene, "cube", (1.0, 0.5, 0.0))
    assert reward(scene, "track_lin_vel_xy_exp", **params, frame="yaw") == [1.0] * 3


def test_a_turning_rate_is_tracked(scene) -> None:
    put(scene, "cube", (0, 0, 3), turned((1, 0, 0), math.pi / 2))
    move(scene, "cube", angular=[(0, 1, 0), (0, 0, -1), (0, 0.5, -1)])  # body's z axis is -y
    params = {**CUBE, "command_name": "v", "std": 0.5}
    body = [1.0, math.exp(-4), math.exp(-1)]
    assert reward(scene, "track_ang_vel_z_exp", **params) == pytest.approx(body, abs=1e-6)
    world = [math.exp(-4), 1.0, 1.0]
    found = reward(scene, "track_ang_vel_z_exp", **params, frame="world")
    assert found == pytest.approx(world, abs=1e-6)


def test_unwanted_motion_is_measured_in_the_bodys_axes(scene) -> None:
    put(scene, "cube", (0, 0, 3), turned((1, 0, 0), math.pi / 2))
    move(scene, "cube", (0.1, -2.0, 0.3), (0.4, 5.0, 0.3))
    assert reward(scene, "lin_vel_z_l2", **CUBE) == pytest.approx([4.0] * 3)
    assert reward(scene, "ang_vel_xy_l2", **CUBE) == pytest.approx([0.16 + 0.09] * 3)


def test_a_links_velocity_is_that_of_its_origin(scene) -> None:
    """Only Joint1 turns, about the vertical: the tool turns with it and does not rise."""
    bend(scene, HOME, [2.0, 0, 0, 0, 0, 0])
    position = scene.robot.get_link_pose("ee_link")[0, :2].double().numpy()
    speed = 2.0 * float(np.linalg.norm(position))  # the arm's root stands at x = y = 0
    hit = {**TOOL, "bounds": [speed - 1e-5, speed + 1e-5]}
    assert reward(scene, "tolerance_velocity", **hit) == [1.0] * 3
    velocity = scene.robot.get_link_vel("ee_link")[0]
    assert velocity[3:].tolist() == pytest.approx([0, 0, 2], abs=1e-6)
    up = {**TOOL, "bounds": [-1e-6, 1e-6], "direction": [0, 0, 3]}
    assert reward(scene, "tolerance_velocity", **up) == [1.0] * 3


@pytest.mark.parametrize(
    ("degrees", "flat", "up"), [(0, 0.0, 1.0), (30, 0.25, 0.933013), (120, 0.75, 0.25)]
)
def test_upright(scene, degrees, flat, up) -> None:
    tilt = quat_multiply(
        np.array(turned(UP, 0.9)), np.array(turned((0.6, 0.8, 0), math.radians(degrees)))
    )
    put(scene, "cube", (0, 0, 3), tilt)
    assert reward(scene, "flat_orientation_l2", **CUBE) == pytest.approx([flat] * 3, abs=1e-6)
    assert reward(scene, "upright", **CUBE) == pytest.approx([up] * 3, abs=1e-6)
    kernel = reward(scene, "upright", **CUBE, std=0.5)
    assert kernel == pytest.approx([math.exp(-flat / 0.25)] * 3, abs=1e-6)


def test_heights(scene) -> None:
    put(scene, "cube", [(0, 0, 0.1), (0, 0, 0.5), (0, 0, 0.9)])
    found = reward(scene, "base_height_l2", **CUBE, target_height=0.4)
    assert found == pytest.approx([0.09, 0.01, 0.25])
    assert reward(scene, "object_height", **CUBE) == pytest.approx([0.1, 0.5, 0.9])
    found = reward(scene, "object_height", **CUBE, above=0.2, most=0.4)
    assert found == pytest.approx([0.0, 0.3, 0.4])


def test_a_bodys_acceleration_is_the_change_over_a_step(make) -> None:
    """In free fall far above the floor: 9.81 m/s^2 down, less what damping takes."""
    env = make(rewards={"r": RewardCfg(func="body_lin_acc_l2", params=CUBE)})
    env.reset()
    home = torch.tensor([HOME]).repeat(3, 1)
    put(env, "cube", (0, 3, 50))
    assert env.step(home)[1].tolist() == [0.0] * 3
    before = env.sim.get_asset("cube").read_velocity()[0].copy()
    paid = env.step(home)[1]
    after = env.sim.get_asset("cube").read_velocity()[0]
    expected = np.sqrt((((after - before) / 0.04) ** 2).sum(1))
    assert paid.tolist() == pytest.approx(expected, rel=1e-6)
    assert 8.5 < float(paid[0]) < 9.82
    env.reset(options={"reset_ids": [0]})
    paid = env.step(home)[1]
    assert paid[0] == 0.0 and paid[1] > 8


def test_stand_still_counts_only_without_a_command(scene) -> None:
    bend(scene, np.add(HOME, [0.1, -0.2, 0, 0, 0, 0]))
    arm = {"entity_cfg": {"uid": "ur10"}}
    assert reward(scene, "stand_still", **arm, command_name="v") == [0.0] * 3
    assert reward(scene, "stand_still", **arm, command_name="still") == pytest.approx([0.3] * 3)
    strict = {**arm, "command_name": "still", "command_threshold": 0.0}
    assert reward(scene, "stand_still", **strict) == [0.0] * 3


def test_errors_of_a_commanded_pose(scene) -> None:
    """The pose is in the frame of the arm's root, at z = 1, turned by 90 degrees."""
    bend(scene, HOME)
    tool = scene.robot.get_link_pose("ee_link")[0].double().numpy()
    distance = float(np.linalg.norm(tool[:3] - [-0.2, 0.1, 1.3]))
    params = {**TOOL, "command_name": "pose"}
    found = reward(scene, "position_command_error", **params)
    assert found == pytest.approx([distance] * 3, abs=1e-6)
    found = reward(scene, "position_command_error_tanh", **params, std=0.5)
    assert found == pytest.approx([1 - math.tanh(2 * distance)] * 3, abs=1e-6)
    half = abs(float(np.dot(tool[3:], turned(UP, 0.4 + math.pi / 2))))
    found = reward(scene, "orientation_command_error", **params)
    assert found == pytest.approx([2 * math.acos(half)] * 3, abs=1e-5)


def test_a_command_must_exist_and_be_wide_enough(scene) -> None:
    with pytest.raises(ConfigError, match=r"command_name: no command is called 'w'.*v, still"):
        reward(scene, "track_lin_vel_xy_exp", **CUBE, command_name="w", std=1.0)
    with pytest.raises(ConfigError, match="'v' has 3 columns, at least 7 are needed"):
        reward(scene, "orientation_command_error", **TOOL, command_name="v")
    with pytest.raises(ConfigError, match="no command is called"):
        reward(scene, "stand_still", entity_cfg={"uid": "ur10"}, command_name="w")

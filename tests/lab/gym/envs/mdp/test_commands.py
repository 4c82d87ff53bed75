"""Built-in commands: their numbers on cases worked by hand, their ranges, their distributions."""

from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import CommandCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import HOME

CUBE = {"entity_cfg": {"uid": "cube"}}
SPEEDS = {"lin_vel_x": [0.5, 1.0], "lin_vel_y": [-0.2, 0.2], "ang_vel_z": [-0.3, 0.3]}


def velocity(heading: Any = None, **params: Any) -> dict[str, CommandCfg]:
    ranges = {**SPEEDS, "heading": heading}
    return {"v": CommandCfg(func="uniform_velocity", params={**CUBE, "ranges": ranges, **params})}


def home(env: Any) -> torch.Tensor:
    return torch.tensor([HOME]).repeat(env.num_envs, 1)


def place(env: Any, quat: Any, linear: Any = (0, 0, 0), angular: Any = (0, 0, 0)) -> None:
    """Put the cube far above the floor, with a velocity in world axes."""
    count = env.num_envs
    cube = env.sim.get_rigid_object("cube")
    cube.set_local_pose(torch.tensor([[3.0, 3.0, 3.0, *quat]]).repeat(count, 1))
    cube.set_velocity(
        lin_vel=torch.tensor([linear], dtype=torch.float32).repeat(count, 1),
        ang_vel=torch.tensor([angular], dtype=torch.float32).repeat(count, 1),
    )


def test_velocities_stay_in_their_ranges_and_fill_them(make) -> None:
    env = make(commands=velocity(), num_envs=512)
    env.reset()
    values = env.command_manager.values("v")
    for column, (low, high) in enumerate(SPEEDS.values()):
        assert low <= values[:, column].min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < values[:, column].max() < high
    assert abs(np.corrcoef(values.T)[0, 1]) < 0.15


def test_a_share_of_the_environments_stands(make) -> None:
    env = make(commands=velocity(rel_standing_envs=0.25), num_envs=1024)
    env.reset()
    standing = (env.command_manager.values("v") == 0.0).all(axis=1)
    assert 0.2 < standing.mean() < 0.3
    every = make(commands=velocity(rel_standing_envs=1.0))
    every.reset()
    assert (every.command_manager.values("v") == 0.0).all()


def test_a_heading_is_turned_to(make) -> None:
    env = make(commands=velocity([1.0, 1.0], heading_control_stiffness=0.5))
    env.reset()
    place(env, [1, 0, 0, 0])
    env.command_manager.step()
    # 0.5 / s x (1.0 - 0.0) rad is more than 0.3 rad/s; with the heading at 0.8 rad it is not.
    assert env.command_manager.values("v")[:, 2].tolist() == [0.3] * 3
    place(env, [np.cos(0.4), 0, 0, np.sin(0.4)])
    env.command_manager.step()
    assert env.command_manager.values("v")[:, 2] == pytest.approx([0.1] * 3, abs=1e-6)


def test_the_shorter_way_is_turned(make) -> None:
    env = make(commands=velocity([3.0, 3.0], heading_control_stiffness=0.1))
    env.reset()
    place(env, [np.cos(-1.5), 0, 0, np.sin(-1.5)])  # heading -3 rad: 0.283 rad clockwise to go
    env.command_manager.step()
    turn = 6.0 - 2 * np.pi
    assert env.command_manager.values("v")[:, 2] == pytest.approx([0.1 * turn] * 3, abs=1e-6)


def test_standing_environments_do_not_turn(make) -> None:
    env = make(commands=velocity([1.0, 2.0], rel_standing_envs=1.0))
    env.reset()
    env.step(home(env))
    assert (env.command_manager.values("v") == 0.0).all()


def test_velocity_errors_in_the_heading_frame(make) -> None:
    ranges = {"lin_vel_x": [1.0, 1.0], "lin_vel_y": [0.0, 0.0], "ang_vel_z": [0.5, 0.5]}
    env = make(
        commands={"v": CommandCfg(func="uniform_velocity", params={**CUBE, "ranges": ranges})}
    )
    env.reset()
    half = np.sqrt(0.5)  # the cube's x axis is the world's y axis: 0.6 m/s forward, 0.3 to the left
    place(env, [half, 0, 0, half], (-0.3, 0.6, 2.0), (0.0, 0.0, 0.2))
    found = env.command_manager.terms["v"].instance.metrics()
    assert found["error_vel_xy"] == pytest.approx([0.5] * 3, abs=1e-6)  # (0.4, 0.3)
    assert found["error_vel_yaw"] == pytest.approx([0.3] * 3, abs=1e-6)


def test_a_pose_error_of_a_link(make) -> None:
    at = [[0.3, 0.4, 0.0]] * 2
    turned = [[0.0, 0.0, np.pi / 2]] * 2
    env = make(
        commands={
            "p": CommandCfg(
                func="uniform_pose",
                params={
                    "entity_cfg": {"uid": "ur10", "link_names": ["base_link"]},
                    "position_range": at,
                    "euler_range": turned,
                },
            )
        }
    )
    env.reset()
    values = env.command_manager.values("p")
    half = np.sqrt(0.5)
    assert values[0] == pytest.approx([0.3, 0.4, 0.0, half, 0.0, 0.0, half])
    found = env.command_manager.terms["p"].instance.metrics()
    assert found["position_error"] == pytest.approx([0.5] * 3)
    assert found["orientation_error"] == pytest.approx([np.pi / 2] * 3)
    position, _ = env.command_manager.terms["p"].instance.world()
    assert position[0] == pytest.approx([0.3, 0.4, 1.0])  # the robot stands at z = 1


def test_angles_are_roll_pitch_and_yaw_about_fixed_axes(make) -> None:
    """Isaac Lab's UniformPoseCommand: R = Rz Ry Rx; (0.5, 0.7, 0.9) has w = 0.8565."""
    angles = [[0.5, 0.7, 0.9]] * 2
    params = {**CUBE, "position_range": [[0, 0, 0]] * 2, "euler_range": angles}
    env = make(commands={"p": CommandCfg(func="uniform_pose", params=params)})
    env.reset()
    half = 0.5 * np.array(angles[0])
    (cr, cp, cy), (sr, sp, sy) = np.cos(half), np.sin(half)
    expected = [
        cy * cr * cp + sy * sr * sp,
        cy * sr * cp - sy * cr * sp,
        cy * cr * sp + sy * sr * cp,
        sy * cr * cp - cy * sr * sp,
    ]
    assert expected[0] == pytest.approx(0.8565, abs=1e-4)
    assert env.command_manager.values("p")[0, 3:] == pytest.approx(expected, abs=1e-9)


def test_unique_quaternions_have_a_positive_real_part(make) -> None:
    params = {
        **CUBE,
        "position_range": [[0, 0, 0]] * 2,
        "euler_range": [[-np.pi] * 3, [np.pi] * 3],
    }
    signs = {}
    for unique in (False, True):
        command = CommandCfg(func="uniform_pose", params={**params, "make_quat_unique": unique})
        env = make(commands={"p": command}, num_envs=64)
        env.reset()
        quat = env.command_manager.values("p")[:, 3:]
        assert np.linalg.norm(quat, axis=1) == pytest.approx([1.0] * 64)
        signs[unique] = (quat[:, 0] >= 0).all()
    assert signs == {False: False, True: True}


def joints(**params: Any) -> dict[str, CommandCfg]:
    entity = {"entity_cfg": {"uid": "ur10", "joint_names": params.pop("names", None)}}
    return {"q": CommandCfg(func="uniform_joint_position", params={**entity, **params})}


def test_joint_positions_around_home(make) -> None:
    env = make(commands=joints(position_range={"Joint1": [0.1, 0.1], "Joint[23]": [-0.2, -0.2]}))
    env.reset()
    wanted = np.add(HOME, [0.1, -0.2, -0.2, 0, 0, 0])
    assert env.command_manager.values("q")[1] == pytest.approx(wanted)
    found = env.command_manager.terms["q"].instance.metrics()["joint_error"]
    assert found == pytest.approx([0.3] * 3)


def test_joint_positions_that_are_absolute_stay_within_limits(make) -> None:
    env = make(
        commands=joints(names=["Joint2", "Joint3"], position_range=[1.0, 9.0], relative=False),
        num_envs=256,
    )
    env.reset()
    values = env.command_manager.values("q")
    limits = env.robot.parsed.qpos_limits[[1, 2]]
    assert env.command_manager.names("q") == ("Joint2", "Joint3")
    assert (values >= 1.0).all()
    assert (values <= limits[:, 1]).all()
    assert (values.max(axis=0) > limits[:, 1] - 0.3).all()


@pytest.mark.parametrize(
    ("commands", "path", "part"),
    [
        (joints(position_range={"Jont1": [0, 1]}), "q.params.position_range.Jont1", "'Joint1'?"),
        (joints(names=[]), "q.params.entity_cfg.joint_names", "picks no joint"),
        (velocity(rel_standing_envs=1.5), "v.params.rel_standing_envs", "at most 1"),
        (velocity([1.0, -1.0]), "v.params.ranges.heading", "low 1.0 exceeds high -1.0"),
    ],
)
def test_wrong_parameters(make, commands, path: str, part: str) -> None:
    with pytest.raises(ConfigError) as caught:
        make(commands=commands)
    assert f"commands.{path}: " in str(caught.value)
    assert part in str(caught.value)

"""Penalties on joints and on actions, on cases worked by hand."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import ActionTermCfg, EventCfg, RewardCfg, TerminationCfg
from embodichain.lab.sim.cfg import JointDrivePropertiesCfg, RobotCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.judging import bend, ends, reward
from tests.helpers.ur10_task import HOME, UR10, builder

ARM = {"entity_cfg": {"uid": "ur10"}}
FIRST = {"entity_cfg": {"uid": "ur10", "joint_names": "Joint[12]"}}
SPEEDS = [3.0, -4.0, 0, 0, 0, 12.0]


@pytest.fixture(scope="module")
def scene() -> Iterator[Any]:
    with builder() as build:
        env = build()
        env.reset()
        yield env


def test_joint_speeds(scene) -> None:
    bend(scene, HOME, SPEEDS)
    assert reward(scene, "joint_velocity_penalty", robot_uid="ur10") == [-13.0] * 3
    assert reward(scene, "joint_velocity_penalty") == [-13.0] * 3
    assert reward(scene, "joint_velocity_penalty", joint_ids=[0, 1]) == [-5.0] * 3
    assert reward(scene, "joint_velocity_penalty", **FIRST) == [-5.0] * 3
    assert reward(scene, "joint_vel_l1", **ARM) == [19.0] * 3
    assert reward(scene, "joint_vel_l1", **FIRST) == [7.0] * 3
    assert reward(scene, "joint_vel_l2", **ARM) == [169.0] * 3
    assert reward(scene, "joint_vel_l2", **FIRST) == [25.0] * 3


def test_the_error_to_the_targets(scene) -> None:
    bend(scene, HOME, [0.0] * 6)
    scene.robot.set_qpos(np.add(HOME, [0.3, -0.1, 0, 0, 0, 0.2]))
    assert reward(scene, "joint_target_error", **ARM) == pytest.approx([0.1] * 3)
    assert reward(scene, "joint_target_error", **FIRST) == pytest.approx([0.2] * 3)


def test_a_control_part_picks_joints(make) -> None:
    parts = RobotCfg(uid="ur10", fpath=UR10, control_parts={"wrist": ["Joint[56]"]})
    env = make(robot=parts)
    env.reset()
    bend(env, HOME, [9, 9, 9, 9, 3, 4])
    assert reward(env, "joint_velocity_penalty", part_name="wrist") == [-5.0] * 3


@pytest.mark.parametrize(
    ("params", "part"),
    [
        ({"robot_uid": "ur5"}, "robot_uid: no entity is called 'ur5'"),
        ({"joint_ids": [6]}, "joint_ids: 'ur10' has 6 joints"),
        ({"part_name": "leg"}, "part_name: no control part"),
        ({"part_name": "leg", "joint_ids": [1]}, "part_name: give either"),
        ({**ARM, "joint_ids": [1]}, "joint_ids: give either"),
        ({"robot_uid": "cube"}, "robot_uid: 'cube' has no joints"),
    ],
)
def test_wrong_joints(make, params, part) -> None:
    with pytest.raises(ConfigError, match=part):
        make(rewards={"r": RewardCfg(func="joint_velocity_penalty", params=params)})


SERVO_AND_MOTOR = """
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>
    <body name="base"><geom size="0.1" contype="0" conaffinity="0"/>
      <body name="arm" pos="0.5 0 0"><joint name="bend" axis="0 0 1" range="-3 3"/>
        <geom size="0.1"/></body>
      <body name="wheel" pos="-0.5 0 0"><joint name="spin" axis="0 0 1" range="-9 9"/>
        <geom size="0.1"/></body>
    </body>
  </worldbody>
  <actuator>
    <position name="bend" joint="bend" kp="50" forcerange="-5 5"/>
    <motor name="spin" joint="spin" gear="2" ctrlrange="-3 3" forcerange="-2 2"/>
  </actuator>
</mujoco>
"""


def test_joint_deviation(scene) -> None:
    bend(scene, np.add(HOME, [0.1, -0.2, 0, 0, 0, 0.3]))
    assert reward(scene, "joint_deviation_l1", **ARM) == pytest.approx([0.6] * 3)
    assert reward(scene, "joint_deviation_l1", **FIRST) == pytest.approx([0.3] * 3)


def test_efforts_and_power_of_one_physics_step(make) -> None:
    """From rest, a drive's effort is stiffness x offset: 1e4 x 0.01 = 100 N m and 2e2 in all."""
    env = make(
        sim_steps_per_control=1,
        rewards={
            "torques": RewardCfg(func="joint_torques_l2", params=FIRST),
            "power": RewardCfg(func="joint_power", params=FIRST),
            "given": RewardCfg(func="joint_power", params={**FIRST, "positive_only": True}),
            "beyond": RewardCfg(func="applied_torque_limits", params={**FIRST, "soft_ratio": 0.25}),
        },
    )
    env.reset()
    action = torch.tensor([HOME]).repeat(3, 1)
    action[:, 0] += 0.01
    action[:, 1] -= 0.01
    rewards = env.step(action)[4]["rewards"]
    assert rewards["torques"].tolist() == pytest.approx([2e4] * 3, rel=1e-4)
    qvel = env.robot.get_qvel()[:, :2].double().numpy()
    power = 100.0 * qvel * [1, -1]
    assert rewards["power"].tolist() == pytest.approx(np.abs(power).sum(1), rel=1e-4)
    assert rewards["given"].tolist() == pytest.approx(np.maximum(power, 0).sum(1), rel=1e-4)
    limits = np.asarray(env.robot.parsed.qf_limits)[:2]
    assert limits.tolist() == [330.0, 330.0]
    assert rewards["beyond"].tolist() == pytest.approx([2 * (100 - 82.5)] * 3, rel=1e-3)


def test_braking_is_power_but_not_given(make) -> None:
    env = make(
        sim_steps_per_control=1,
        rewards={
            "power": RewardCfg(func="joint_power", params=ARM),
            "given": RewardCfg(func="joint_power", params={**ARM, "positive_only": True}),
        },
    )
    env.reset()
    bend(env, HOME, [2.0, 0, 0, 0, 0, 0])
    rewards = env.step(torch.tensor([HOME]).repeat(3, 1))[4]["rewards"]
    assert (rewards["power"] > 1.0).all()
    assert (rewards["given"] < 0.5 * rewards["power"]).all()


def test_efforts_applied_beside_the_drives_count(make) -> None:
    drives = JointDrivePropertiesCfg(drive_type="none")
    env = make(
        robot=RobotCfg(uid="ur10", fpath=UR10, drive_pros=drives),
        actions={"push": ActionTermCfg(func="joint_effort", params={**ARM, "scale": 64.0})},
        rewards={"r": RewardCfg(func="joint_torques_l2", params=ARM)},
        terminations={"t": TerminationCfg(func="joint_effort_out_of_limit", params=ARM)},
    )
    env.reset()
    efforts = torch.tensor([[3.0, 4, 0, 0, 0, 0], [0, 0, 0, 0, 0, 56], [0, 0, 0, 0, 0, 60]])
    _, paid, terminated, _, _ = env.step(efforts / 64)
    assert paid[:2].tolist() == [25.0, 3136.0]
    assert terminated.tolist() == [False, False, True]  # the wrist's limit is 56 N m


def test_what_a_limit_cuts_off_an_effort_action_counts(make) -> None:
    """Of 30 N m asked, a drive of at most 20 gives 20: 10 are cut off."""
    drives = JointDrivePropertiesCfg(stiffness=0.0, damping=0.0, max_effort=20.0)
    env = make(
        robot=RobotCfg(uid="ur10", fpath=UR10, drive_pros=drives),
        actions={"push": ActionTermCfg(func="joint_effort", params={**ARM, "scale": 64.0})},
        rewards={
            "cut": RewardCfg(func="applied_torque_limits", params=ARM),
            "given": RewardCfg(func="joint_torques_l2", params=ARM),
        },
        terminations={"t": TerminationCfg(func="joint_effort_out_of_limit", params=ARM)},
    )
    env.reset()
    efforts = torch.tensor([[30.0, -15, 0, 0, 0, 0], [20.0, 0, 0, 0, 0, 0], [-26, 0, 0, 0, 0, 32]])
    _, _, terminated, _, info = env.step(efforts / 64)
    assert info["rewards"]["cut"].tolist() == [10.0, 0.0, 18.0]
    assert info["rewards"]["given"].tolist() == [625.0, 400.0, 800.0]
    assert terminated.tolist() == [True, False, True]
    env.reset()
    assert not env.robot.drives.cut_effort.any()


def test_a_saturated_servo_of_a_file_counts(make, tmp_path) -> None:
    """The servo asks 50 (1.0 - 0) = 50 N m and gives 5; the motor asks 2 x 3 = 6 and gives 4."""
    (tmp_path / "two.xml").write_text(SERVO_AND_MOTOR)
    env = make(
        robot=RobotCfg(uid="two", fpath=str(tmp_path / "two.xml")),
        sim_steps_per_control=1,
        rewards={"cut": RewardCfg(func="applied_torque_limits", params={"of": {"uid": "two"}})},
    )
    env.reset()
    paid = env.step(torch.tensor([[1.0, 3.0], [0.05, 1.5], [-1.0, -3.0]]))[1]
    assert paid.tolist() == pytest.approx([45.0 + 2.0, 0.0, 45.0 + 2.0], abs=1e-5)


def test_joint_acceleration_is_the_change_over_a_step(make) -> None:
    env = make(rewards={"r": RewardCfg(func="joint_acc_l2", params=ARM)})
    env.reset()
    assert env.step(torch.tensor([HOME]).repeat(3, 1))[1].tolist() == [0.0] * 3
    before = env.robot.read_qvel().copy()
    action = torch.tensor([HOME]).repeat(3, 1) + torch.tensor([[0.0], [0.1], [0.2]])
    paid = env.step(action)[1]
    change = (env.robot.read_qvel() - before) / 0.04
    assert paid.tolist() == pytest.approx((change**2).sum(1), rel=1e-5)
    env.reset(options={"reset_ids": [2]})
    paid = env.step(action)[1]
    assert paid[2] == 0.0 and paid[1] > 0.0


def test_joint_limit_penalty_is_a_share_of_the_range(scene) -> None:
    low, high = np.asarray(scene.robot.parsed.qpos_limits, float).T
    middle, width = 0.5 * (low + high), high - low
    qpos = np.tile(middle, (3, 1))
    qpos[1, 0] = low[0] + 0.04 * width[0]
    qpos[2, :2] = high[:2] - [0.02, 0.07] * width[:2]
    bend(scene, qpos)
    expected = [0.0, -0.06, -0.08 - 0.03]
    assert reward(scene, "joint_limit_penalty") == pytest.approx(expected, abs=1e-6)
    assert reward(scene, "joint_limit_penalty", joint_ids=[1]) == pytest.approx(
        [0.0, 0.0, -0.03], abs=1e-6
    )
    found = reward(scene, "joint_limit_penalty", **ARM, margin=0.03)
    assert found == pytest.approx([0.0, 0.0, -0.01], abs=1e-6)


def test_position_limits(scene) -> None:
    """Joint1 may turn by 2 pi either way: nine tenths of it is 1.8 pi."""
    qpos = np.tile(HOME, (3, 1))
    qpos[:, 0] = [1.79 * math.pi, 1.85 * math.pi, -1.9 * math.pi]
    bend(scene, qpos)
    soft = {**FIRST, "soft_ratio": 0.9}
    expected = [0.0, 0.05 * math.pi, 0.1 * math.pi]
    assert reward(scene, "joint_pos_limits", **soft) == pytest.approx(expected, abs=1e-4)
    assert reward(scene, "joint_pos_limits", **FIRST) == [0.0] * 3
    assert ends(scene, "joint_pos_out_of_limit", **soft) == [False, True, True]
    assert ends(scene, "joint_pos_out_of_limit", **FIRST) == [False] * 3
    assert ends(scene, "joint_pos_outside", **FIRST, bounds=[-6.0, 5.7]) == [False, True, False]
    assert ends(scene, "joint_pos_outside", **FIRST, bounds=[-5.0, math.inf]) == [
        False,
        False,
        True,
    ]


def test_velocity_limits(scene) -> None:
    limit = float(np.asarray(scene.robot.parsed.qvel_limits)[0])
    qvel = np.zeros((3, 6))
    qvel[:, 0] = [0.5 * limit, -1.1 * limit, limit + 7.0]
    bend(scene, HOME, qvel)
    expected = [0.0, 0.1 * limit, 1.0]
    assert reward(scene, "joint_vel_limits", **FIRST) == pytest.approx(expected, abs=1e-5)
    soft = reward(scene, "joint_vel_limits", **FIRST, soft_ratio=0.25)
    assert soft == pytest.approx([min(1.0, 0.25 * limit), 1.0, 1.0], abs=1e-5)
    assert ends(scene, "joint_vel_out_of_limit", **FIRST) == [False, True, True]
    high = {**FIRST, "max_velocity": 1.2 * limit}
    assert ends(scene, "joint_vel_out_of_limit", **high) == [False, False, True]


def test_a_drives_own_maximum_counts_where_it_is_smaller(make) -> None:
    drives = JointDrivePropertiesCfg(max_velocity=0.5, max_effort=20.0)
    env = make(
        robot=RobotCfg(uid="ur10", fpath=UR10, init_qpos=HOME, drive_pros=drives),
        rewards={"r": RewardCfg(func="joint_vel_limits", params=FIRST)},
        terminations={"t": TerminationCfg(func="joint_effort_out_of_limit", params=FIRST)},
    )
    env.reset()
    bend(env, HOME, [0.7, 0, 0, 0, 0, 0])
    assert reward(env, "joint_vel_limits", **FIRST) == pytest.approx([0.2] * 3, abs=1e-6)
    action = torch.tensor([HOME]).repeat(3, 1)
    action[0, 0] += 1.0  # 1e4 N m wanted, cut off at 20
    assert env.step(action)[2][0]


def test_limits_are_those_in_force_in_each_environment(make) -> None:
    narrow = EventCfg(
        func="randomize_joint_parameters", params={**FIRST, "upper_limit_range": [0.2, 0.6]}
    )
    env = make(
        events={"narrow": narrow}, rewards={"r": RewardCfg(func="joint_pos_limits", params=FIRST)}
    )
    env.reset()
    high = env.robot.get_qpos_limits()[:, :2, 1].double().numpy()
    assert len(np.unique(high)) == 6
    assert (high >= 0.2).all() and (high < 0.6).all()
    env.sim.engine.write("qpos", 1.0, None, np.asarray(env.robot.entity.qpos_adr)[:2])
    found = reward(env, "joint_pos_limits", **FIRST)
    assert found == pytest.approx((1.0 - high).sum(1), abs=1e-6)
    low = -2 * math.pi
    width = 0.9 * (high - low)
    soft = (1.0 - (0.5 * (high + low) + 0.5 * width)).sum(1)
    found = reward(env, "joint_pos_limits", **FIRST, soft_ratio=0.9)
    assert found == pytest.approx(soft, abs=1e-5)
    assert ends(env, "joint_pos_out_of_limit", **FIRST) == [True] * 3
    found = reward(env, "joint_limit_penalty", **FIRST)
    assert found == pytest.approx(-(0.1 - (high - 1.0) / (high - low)).sum(1), abs=1e-5)


WHEEL = """
<mujoco>
  <worldbody>
    <body name="base"><geom size="0.1"/>
      <body name="wheel"><joint name="spin" axis="0 0 1"/><geom size="0.1"/></body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize(
    ("func", "what"),
    [
        ("joint_limit_penalty", "position"),
        ("joint_pos_limits", "position"),
        ("joint_vel_limits", "velocity"),
        ("applied_torque_limits", "effort"),
    ],
)
def test_joints_without_limits_are_told_so(make, tmp_path, func, what) -> None:
    (tmp_path / "wheel.xml").write_text(WHEEL)
    robot = RobotCfg(uid="wheel", fpath=str(tmp_path / "wheel.xml"))
    params = {"entity_cfg": {"uid": "wheel"}}
    with pytest.raises(ConfigError, match=f"entity_cfg: .*'wheel' has limits of {what}: spin"):
        make(robot=robot, rewards={"r": RewardCfg(func=func, params=params)})


def stepped(make, func: str, *actions: float) -> list[list[float]]:
    """Rewards of steps whose action is a number in all six entries, environment 1 the negative."""
    env = make(rewards={"r": RewardCfg(func=func)})
    env.reset()
    sign = torch.tensor([[1.0], [-1.0], [0.0]])
    return [env.step(sign * torch.full((3, 6), a))[1].tolist() for a in actions]


def test_actions(make) -> None:
    assert stepped(make, "action_l2", 0.5) == [[1.5, 1.5, 0.0]]
    rate = stepped(make, "action_rate_l2", 0.5, 1.0, 0.5, 0.5)
    assert rate == [[1.5, 1.5, 0.0], [1.5, 1.5, 0.0], [1.5, 1.5, 0.0], [0.0] * 3]
    smooth = stepped(make, "action_smoothness_penalty", 0.5, 1.0)
    assert smooth[0] == [0.0] * 3
    assert smooth[1] == pytest.approx([-math.sqrt(1.5), -math.sqrt(1.5), 0.0])


def test_action_acceleration_counts_from_zero(make) -> None:
    found = stepped(make, "action_acc_l2", 0.5, 1.0, 0.5, 0.0, 0.0)
    nothing = [0.0] * 3
    # Changes from 0: +0.5, +0.5, -0.5, -0.5, 0: bends 0.5, 0, -1, 0, 0.5.
    bent = [1.5, 1.5, 0.0]
    assert found == [bent, nothing, [6.0, 6.0, 0.0], nothing, bent]


@pytest.mark.parametrize("func", ["action_rate_l2", "action_smoothness_penalty", "action_acc_l2"])
def test_what_a_term_remembers_of_actions_is_reset_and_restored(make, func) -> None:
    env = make(rewards={"r": RewardCfg(func=func)})
    env.reset()
    actions = torch.linspace(-1, 1, 5)[:, None, None] ** 3 * torch.ones(5, 3, 6)
    env.step(actions[0])
    env.step(actions[1])
    saved = env.state_dict()
    first = env.step(actions[2])[1]
    assert (first != 0).all()
    env.load_state_dict(saved)
    assert torch.equal(env.step(actions[2])[1], first)
    env.reset(options={"reset_ids": [1]})
    found = env.step(actions[4])[1]
    from_zero = 0.0 if func == "action_smoothness_penalty" else 6.0
    assert found[1] == from_zero and (found[[0, 2]] != 0).all()


def test_actions_without_an_order_are_refused() -> None:
    from embodichain.lab.gym.envs.mdp.quantities.episode import action_

    with pytest.raises(TypeError, match="needs an action tensor, got dict"):
        action_(None, {"qpos": torch.zeros(3, 6)})

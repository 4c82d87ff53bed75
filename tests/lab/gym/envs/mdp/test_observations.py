"""Observations of objects, tools, targets, time and properties, on cases worked by hand."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import ActionTermCfg, EnvCfg, ObservationCfg
from embodichain.lab.sim.cfg import RobotCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import CUBE_POS, GOAL_POS, HOME, UR10

H = math.sqrt(0.5)
CUBE = {"entity_cfg": {"uid": "cube"}}
ARM = {"entity_cfg": {"uid": "ur10"}}
# The cube stands at (0.5, 0.5, 0.05), turned by 90 degrees about z; the goal at (0.5, 0.2, 0.5).
PAIR = {"source_entity_cfg": {"uid": "cube"}, "target_entity_cfg": {"uid": "goal"}}
PARTS = {"hand": ["Joint[56]"], "arm": ["Joint[1-3]"]}


def env_with(make, terms=None, **sections):
    observations = {
        name: ObservationCfg(func=func, params=params)
        for name, (func, params) in (terms or {}).items()
    }
    env = make(observations=observations, **sections)
    return env, env.reset()[0]


def same(tensor: torch.Tensor, row, atol: float = 1e-6) -> bool:
    expected = torch.tensor(row, dtype=torch.float32)
    return tensor.shape == (3, *expected.shape) and bool(
        torch.allclose(tensor, expected.expand_as(tensor), atol=atol)
    )


def home(env) -> torch.Tensor:
    return env.robot.get_qpos(target=True)


def test_relations(make) -> None:
    _, obs = env_with(
        make,
        {
            "plain": ("relative_position", PAIR),
            "turned": ("relative_position", {**PAIR, "in_source_frame": True}),
            "quat": ("relative_orientation", PAIR),
            "six": ("relative_orientation", {**PAIR, "representation": "rot6d"}),
            "pose": ("relative_pose", PAIR),
            "pose9": ("relative_pose", {**PAIR, "representation": "rot6d"}),
            "matrix": ("relative_pose", {**PAIR, "representation": "matrix"}),
            "distance": ("distance", PAIR),
            "flat": ("distance", {**PAIR, "use_xy_only": True}),
        },
    )
    assert same(obs["plain"], [0.0, -0.3, 0.45])
    assert same(obs["turned"], [-0.3, 0, 0.45])  # the cube's x axis is the world's y
    assert same(obs["quat"], [H, 0, 0, -H])
    assert same(obs["six"], [0.0, -1, 0, 1, 0, 0])
    assert same(obs["pose"], [-0.3, 0, 0.45, H, 0, 0, -H])
    assert same(obs["pose9"], [-0.3, 0, 0.45, 0, -1, 0, 1, 0, 0])
    turn = [[0.0, 1, 0, -0.3], [-1, 0, 0, 0], [0, 0, 1, 0.45], [0, 0, 0, 1]]
    assert same(obs["matrix"], turn)
    assert same(obs["distance"], [math.dist(CUBE_POS, GOAL_POS)])
    assert same(obs["flat"], [0.3])


def test_relative_velocity(make) -> None:
    there = {"source_entity_cfg": {"uid": "goal"}, "target_entity_cfg": {"uid": "cube"}}
    env, _ = env_with(
        make,
        {
            "plain": ("relative_velocity", there),
            "turned": ("relative_velocity", {**PAIR, "in_source_frame": True}),
        },
    )
    env.sim.get_asset("cube").set_velocity(
        np.tile([1.0, 2, 3], (3, 1)), np.tile([0.1, 0.2, 0.3], (3, 1))
    )
    obs = env.get_obs()
    assert same(obs["plain"], [1.0, 2, 3, 0.1, 0.2, 0.3])
    # Minus the cube's velocity, in its axes: x' = y, y' = -x.
    assert same(obs["turned"], [-2.0, 1, -3, -0.2, 0.1, -0.3])


def test_upstreams_pose_alias_and_tool(make) -> None:
    robot = RobotCfg(
        uid="ur10", fpath=UR10, init_pos=(0, 0, 1), init_qpos=HOME, control_parts=PARTS
    )
    env, obs = env_with(
        make,
        {
            "alias": ("get_rigid_object_pose", CUBE),
            "pose": ("get_object_pose", CUBE),
            "tool": ("get_robot_eef_pose", {}),
            "hand": ("get_robot_eef_pose", {"part_name": "hand", "position_only": True}),
            "forearm": ("get_robot_eef_pose", {"part_name": "arm", "position_only": True}),
        },
        robot=robot,
    )
    assert torch.equal(obs["alias"], obs["pose"])
    expected = env.robot.get_link_pose("ee_link", to_matrix=True)
    assert torch.allclose(obs["tool"], expected, atol=1e-6)
    assert torch.equal(obs["hand"], env.robot.get_link_pose("ee_link")[:, :3])
    assert torch.equal(obs["forearm"], env.robot.get_link_pose("forearm_link")[:, :3])


def test_a_part_that_is_not_there(make) -> None:
    with pytest.raises(ConfigError, match="part_name|wrist"):
        env_with(make, {"tool": ("get_robot_eef_pose", {"part_name": "wrist"})})


def test_target_position(make) -> None:
    env = make(observations={"goal": ObservationCfg(func="target_position")})
    with pytest.raises(ConfigError, match="no poses 'goal_pose'"):
        env.reset()
        env.step(home(env))
    pose = torch.eye(4).repeat(3, 1, 1)
    pose[:, :3, 3] = torch.arange(9.0).reshape(3, 3)
    env.goal_pose = pose
    assert torch.equal(env.get_obs()["goal"], torch.arange(9.0).reshape(3, 3))


def test_properties_of_objects_follow_randomization(make) -> None:
    env, obs = env_with(
        make,
        {
            "all": ("get_rigid_object_physics_attributes", CUBE),
            "some": (
                "get_rigid_object_physics_attributes",
                {**CUBE, "attributes": ["friction", "mass"]},
            ),
            "scale": ("get_object_body_scale", CUBE),
            "robot_scale": ("get_object_body_scale", ARM),
            "id": ("get_object_uid", CUBE),
        },
    )
    cube = env.sim.get_asset("cube")
    sixth = 1.0 * 0.1**2 / 6  # m a^2 / 6
    assert same(obs["all"], [1.0, 0.5, 0.0, 0.0, sixth, sixth, sixth])
    assert same(obs["some"], [0.5, 1.0])
    assert same(obs["scale"], [1.0, 1, 1]) and same(obs["robot_scale"], [1.0, 1, 1])
    assert obs["id"].dtype == torch.int32
    assert obs["id"].tolist() == [cube.entity.root_body_id] * 3
    cube.set_mass(np.array([2.0]), env_ids=[1])
    cube.set_friction(np.array([0.9]), env_ids=[2])
    obs = env.get_obs()
    assert torch.allclose(obs["some"], torch.tensor([[0.5, 1.0], [0.5, 2.0], [0.9, 1.0]]))
    assert torch.allclose(obs["all"][:, 4], torch.tensor([sixth, 2 * sixth, sixth]))


def test_drives_follow_randomization(make) -> None:
    wrist = {"entity_cfg": {"uid": "ur10", "joint_names": "Joint[56]"}}
    env, obs = env_with(
        make,
        {
            "all": ("get_articulation_joint_drive", wrist),
            "gains": ("get_articulation_joint_drive", {**wrist, "gains": ["damping"]}),
        },
    )
    expected = [1e4, 1e4, 1e3, 1e3, 1e10, 1e10, 1e10, 1e10, 0, 0]
    assert same(obs["all"][:, :10], expected) and obs["all"].shape == (3, 12)
    env.robot.set_joint_drive(damping=np.array([[7.0]]), joint_ids=[4], env_ids=[1])
    assert env.get_obs()["gains"].tolist() == [[1e3, 1e3], [7.0, 1e3], [1e3, 1e3]]


def test_attributes_are_of_objects_and_drives_of_robots(make) -> None:
    with pytest.raises(ConfigError, match="is not a rigid object"):
        env_with(make, {"a": ("get_rigid_object_physics_attributes", ARM)})
    with pytest.raises(ConfigError, match="has no joints"):
        env_with(make, {"a": ("get_articulation_joint_drive", CUBE)})


def test_normalized_joint_data(make) -> None:
    terms = {
        "half": ObservationCfg(
            func="normalize_robot_joint_data",
            mode="modify",
            name="robot/qpos",
            params={"joint_ids": [0, 5], "range": [-1, 1]},
        ),
        "speed": ObservationCfg(
            func="normalize_robot_joint_data",
            mode="modify",
            name="robot/qvel",
            params={"limit": "qvel_limits"},
        ),
    }
    env = make(observations=terms)
    env.reset()
    low, high = np.asarray(env.robot.parsed.qpos_limits).T
    qpos = np.array(HOME)
    qpos[0] = low[0] + 0.75 * (high[0] - low[0])
    env.robot.set_qpos(np.tile(qpos, (3, 1)), target=False)
    most = env.robot.parsed.qvel_limits
    env.robot.set_qvel(np.tile(0.5 * most, (3, 1)), target=False)
    obs = env.get_obs()
    expected = qpos.copy()
    expected[0] = 0.5
    expected[5] = 2 * (qpos[5] - low[5]) / (high[5] - low[5]) - 1
    assert same(obs["robot"]["qpos"], expected.tolist())
    assert same(obs["robot"]["qvel"], [0.75] * 6)


@pytest.mark.parametrize(
    ("params", "part"),
    [
        ({"joint_ids": [9]}, r"of the 6 active joints, numbered from 0; got \[9\]"),
        ({"control_parts": "hand"}, "no control part of 'ur10' matches 'hand'"),
        ({"control_parts": "hand", "joint_ids": [1]}, "give either"),
        ({"limit": "limits"}, "'qpos_limits', 'qvel_limits', 'qf_limits'"),
    ],
)
def test_wrong_normalization(make, params, part) -> None:
    term = ObservationCfg(
        func="normalize_robot_joint_data", mode="modify", name="robot/qpos", params=params
    )
    with pytest.raises(ConfigError, match=part):
        make(observations={"it": term})


HAND = """<robot name="hand"><link name="base"/>
  <link name="turn">{body}</link><link name="left">{body}</link><link name="right">{body}</link>
  <link name="wheel">{body}</link>
  <joint name="left" type="prismatic"><parent link="base"/><child link="left"/>
    <limit lower="0" upper="0.05" effort="1" velocity="1"/></joint>
  <joint name="right" type="prismatic"><parent link="base"/><child link="right"/>
    <limit lower="0" upper="0.05" effort="1" velocity="1"/><mimic joint="left"/></joint>
  <joint name="turn" type="revolute"><parent link="base"/><child link="turn"/>
    <limit lower="-1" upper="3" effort="1" velocity="2"/></joint>
  <joint name="wheel" type="continuous"><parent link="base"/><child link="wheel"/>
    <limit effort="1" velocity="0"/></joint>
</robot>""".format(
    body='<inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" '
    'ixy="0" ixz="0" iyz="0"/></inertial>'
)


def hand_env(folder: Path, **params: Any) -> BaseEnv:
    (folder / "hand.urdf").write_text(HAND)
    term = ObservationCfg(
        func="normalize_robot_joint_data", mode="modify", name="robot/qpos", params=params
    )
    robot = RobotCfg(uid="hand", fpath=str(folder / "hand.urdf"))
    return BaseEnv(EnvCfg(num_envs=2, robot=robot, observations={"it": term}))


def test_normalized_columns_are_those_of_the_active_joints(tmp_path: Path) -> None:
    env = hand_env(tmp_path, joint_ids=[1, 2])
    names = env.robot.joint_names
    assert names == ["left", "right", "turn", "wheel"]
    qpos = torch.tensor([[0.02, 0.02, 2.0, -math.pi / 2], [0.0, 0.0, -1.0, 3 * math.pi]])
    env.robot.set_qpos(qpos, target=False)
    found = env.get_obs()["robot"]["qpos"]
    # columns 1 and 2 of the active joints left, turn, wheel
    assert found.tolist() == [[pytest.approx(0.02), 0.75, 0.25], [0.0, 0.0, 2.0]]
    env.close()


def test_a_lower_limit_of_zero_is_a_limit(tmp_path: Path) -> None:
    env = hand_env(tmp_path)
    env.robot.set_qpos(torch.full((2, 4), 0.01), target=False)
    assert env.get_obs()["robot"]["qpos"][:, 0].tolist() == pytest.approx([0.2, 0.2])
    env.close()
    with pytest.raises(ConfigError, match="without qvel_limits: wheel"):
        hand_env(tmp_path, limit="qvel_limits")


def test_normalization_wants_the_joints_columns(make) -> None:
    terms = {
        "pair": ObservationCfg(func="relative_position", params=PAIR),
        "it": ObservationCfg(func="normalize_robot_joint_data", mode="modify", name="pair"),
    }
    with pytest.raises(ValueError, match=r"needs \(3, 6\)"):
        make(observations=terms)


def test_a_slice_of_the_last_action(make) -> None:
    def arm(joints: str) -> ActionTermCfg:
        params = {"entity_cfg": {"uid": "ur10", "joint_names": joints}}
        return ActionTermCfg(func="joint_position", params=params)

    terms = {"all": ("last_action", {}), "wrist": ("last_action", {"action_name": "wrist"})}
    actions = {"rest": arm("Joint[1-4]"), "wrist": arm("Joint[56]")}
    env, obs = env_with(make, terms, actions=actions)
    assert not obs["wrist"].any() and obs["wrist"].shape == (3, 2)
    action = 0.1 * torch.arange(18.0).reshape(3, 6)
    obs = env.step(action)[0]
    assert torch.equal(obs["all"], action)
    assert torch.equal(obs["wrist"], action[:, 4:])
    with pytest.raises(ConfigError, match="there are: rest, wrist"):
        env_with(make, {"it": ("last_action", {"action_name": "wirst"})}, actions=actions)


def test_time(make) -> None:
    env, obs = env_with(
        make,
        {
            "now": ("current_time_s", {}),
            "left": ("remaining_time_s", {}),
            "share": ("elapsed_fraction", {}),
            "phase": ("phase", {"period_s": 0.16, "offsets": [0.0, 0.25]}),
        },
        max_episode_steps=5,  # 0.2 s
    )
    assert same(obs["now"], [0.0]) and same(obs["left"], [0.2]) and same(obs["share"], [0.0])
    assert same(obs["phase"], [0.0, 1, 1, 0])
    action = home(env)
    obs = env.step(action)[0]
    assert same(obs["now"], [0.04]) and same(obs["left"], [0.16]) and same(obs["share"], [0.2])
    assert same(obs["phase"], [1.0, 0, 0, -1])  # a quarter of a period
    assert same(env.get_obs()["now"], [0.04])
    obs, _ = env.reset(options={"reset_ids": [1]})
    assert torch.allclose(obs["now"][:, 0], torch.tensor([0.04, 0.0, 0.04]))
    for _ in range(3):
        env.step(action)
    obs, _, _, truncated, info = env.step(action)
    assert truncated.tolist() == [True, False, True]
    assert torch.allclose(info["final_obs"]["share"][[0, 2], 0], torch.ones(2))
    assert torch.allclose(obs["now"][:, 0], torch.tensor([0.0, 0.16, 0.0]))


def test_time_is_restored(make) -> None:
    env, _ = env_with(make, {"now": ("current_time_s", {})})
    action = home(env)
    env.step(action)
    saved = env.state_dict()
    env.reset()
    env.load_state_dict(saved)
    assert same(env.step(action)[0]["now"], [0.08])


def test_waiting_within_a_reset_does_not_count(make) -> None:
    from embodichain.lab.gym.envs.cfg import EventCfg

    def wait(env, env_ids) -> None:
        env.sim.update(step=7)

    env, obs = env_with(
        make, {"now": ("current_time_s", {})}, events={"wait": EventCfg(func=wait, mode="reset")}
    )
    assert same(obs["now"], [0.0])
    assert same(env.step(home(env))[0]["now"], [0.04])


def test_nothing_remains_without_a_limit(make) -> None:
    with pytest.raises(ConfigError, match="no time limit"):
        env_with(make, {"left": ("remaining_time_s", {})}, max_episode_steps=-1)

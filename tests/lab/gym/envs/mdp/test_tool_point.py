"""Terms that act with a robot's tool use the tool point that its `solver_cfg` gives."""

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import EventCfg, ObservationCfg, RewardCfg
from embodichain.lab.sim.cfg import RobotCfg, SolverCfg
from tests.helpers.ur10_task import CUBE_POS, HOME, UR10

TCP = np.eye(4)
TCP[:3, 3] = [0.02, 0.0, 0.16]
PARTS = {"arm": ["Joint[1-6]"]}


@pytest.fixture
def arm() -> RobotCfg:
    solver = {"arm": SolverCfg(end_link_name="ee_link", tcp=TCP)}
    return RobotCfg(uid="ur10", fpath=UR10, init_qpos=HOME, control_parts=PARTS, solver_cfg=solver)


def test_the_tool_is_observed_at_its_point(make, arm) -> None:
    params = {"part_name": "arm"}
    env = make(
        robot=arm,
        observations={
            "pose": ObservationCfg(func="get_robot_eef_pose", params=params),
            "whole": ObservationCfg(func="get_robot_eef_pose", params={"position_only": True}),
        },
    )
    obs, _ = env.reset()
    link = env.robot.get_link_pose("ee_link", to_matrix=True)
    expected = link @ torch.tensor(TCP, dtype=torch.float32)
    assert torch.allclose(obs["pose"], expected, atol=1e-6)
    assert torch.allclose(obs["whole"], expected[:, :3, 3], atol=1e-6)


def test_reaching_is_measured_from_it_to_positions_and_poses(make, arm) -> None:
    params = {"object_cfg": {"uid": "cube"}, "target_pose_key": "goal_xyz", "part_name": "arm"}
    params |= {"behind_offset": 0.0, "height_offset": 0.0, "distance_scale": 2.0}
    env = make(
        robot=arm,
        extensions={"goal_xyz": torch.tensor([[1.0, 0.0, 0.05]] * 3)},
        rewards={"reach": RewardCfg(func="reaching_behind_object", params=params)},
    )
    env.reset()
    info = env.step(torch.tensor([HOME] * 3, dtype=torch.float32))[4]
    point = env.robot.get_link_pose("arm_tcp")[:, :3].numpy()
    cube = env.sim.get_rigid_object("cube").get_local_pose()[:, :3].numpy()
    expected = 1 - np.tanh(2 * np.linalg.norm(point - cube, axis=1))
    assert np.linalg.norm(cube[0] - CUBE_POS) < 0.05
    np.testing.assert_allclose(info["rewards"]["reach"], expected, atol=1e-6)
    poses = torch.eye(4).repeat(3, 1, 1)
    poses[:, :3, 3] = env.goal_xyz
    env.goal_xyz = poses
    again = env.step(torch.tensor([HOME] * 3, dtype=torch.float32))[4]["rewards"]["reach"]
    np.testing.assert_allclose(again, expected, atol=1e-3)
    env.goal_xyz = torch.zeros(3, 7)
    with pytest.raises(ValueError, match=r"\(3, 4, 4\) or \(3, 3\), got \(3, 7\)"):
        env.step(torch.tensor([HOME] * 3, dtype=torch.float32))


def test_events_move_the_tool_point(make, arm) -> None:
    params = {"entity_cfg": {"uid": "ur10", "control_parts": "arm"}}
    turn = {**params, "rotation_range": [[0, 0, 20], [0, 0, 20]]}
    env = make(robot=arm, events={"turn": EventCfg("randomize_robot_eef_pose", turn)})
    env.sim.reset_objects_state()
    before = env.robot.get_link_pose("arm_tcp")
    flange = env.robot.get_link_pose("ee_link")
    env.reset()
    assert torch.allclose(env.robot.get_link_pose("arm_tcp")[:, :3], before[:, :3], atol=1e-3)
    assert (env.robot.get_link_pose("ee_link")[:, :3] - flange[:, :3]).norm(dim=1).min() > 5e-3

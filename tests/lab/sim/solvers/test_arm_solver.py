"""Inverse kinematics: random reachable poses of several arms, limits, seeds, unreachable poses."""

import numpy as np
import pytest
import torch

from embodichain.lab.sim.cfg import RobotCfg, SolverCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.arms import arm_cfg, arm_in, random_qpos

COUNT = 1000
FORK = """<mujoco><worldbody><body name="base">
  <body name="left"><joint name="l"/><geom size="0.1"/></body>
  <body name="right"><joint name="r"/><geom size="0.1"/></body>
</body></worldbody></mujoco>"""


def errors(robot, qpos, pose) -> tuple[np.ndarray, np.ndarray]:
    """Distances in metres and angles in rad between the tool at positions (m, k) and poses."""
    reached = robot.compute_batch_fk(qpos[None], "arm")[0].double().numpy()
    pose = pose.double().numpy()
    lengths = np.linalg.norm(reached[:, :3] - pose[:, :3], axis=1)
    # The sign of a quaternion has no meaning.
    signs = np.sign((reached[:, 3:] * pose[:, 3:]).sum(axis=1))
    chords = np.linalg.norm(signs[:, None] * reached[:, 3:] - pose[:, 3:], axis=1)
    return lengths, 2.0 * chords


@pytest.mark.parametrize(
    ("name", "closed"), [("ur10", True), ("ur5e", True), ("ur5e", False), ("panda", True),
                         ("seven", True)],
)  # fmt: skip
def test_random_reachable_poses_are_reached(name, closed, tmp_path) -> None:
    sim, robot = arm_in(arm_cfg(name, tmp_path, closed_form=closed))
    solver = robot.get_solver("arm")
    assert solver.has_closed_form == (closed and name.startswith("ur"))
    pose = robot.compute_batch_fk(random_qpos(robot, COUNT)[None], "arm")
    success, qpos = robot.compute_batch_ik(pose, name="arm")
    assert success.shape == (1, COUNT) and success.dtype == torch.bool
    assert success.float().mean() >= 0.99
    lengths, angles = errors(robot, qpos[0], pose[0])
    good = success[0].numpy()
    assert lengths[good].max() < 1e-4 and angles[good].max() < 1e-3
    limits = robot.get_qpos_limits("arm")[0]
    assert (qpos >= limits[:, 0] - 1e-6).all() and (qpos <= limits[:, 1] + 1e-6).all()
    sim.destroy()


@pytest.mark.parametrize("name", ["ur10", "seven"])
def test_a_result_depends_neither_on_the_number_nor_on_the_place(name, tmp_path) -> None:
    sim, robot = arm_in(arm_cfg(name, tmp_path), num_envs=5)
    pose = robot.compute_fk(random_qpos(robot, 5), "arm")
    pose[3, :3] *= 9.0  # out of reach
    solver, home = robot.get_solver("arm"), robot.read_qpos().copy()
    pos, quat = pose[:, :3].double().numpy(), pose[:, 3:].double().numpy()
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    found, reached = solver.inverse(home, pos, quat)
    assert reached.tolist() == [True, True, True, False, True]
    for ids in ([4], [0, 3], [3, 1, 1], np.arange(5)[::-1]):
        some = np.array(ids)
        again, ok = solver.inverse(home[some], pos[some], quat[some], some)
        assert np.array_equal(again, found[some]) and np.array_equal(ok, reached[some])
    many = np.arange(640) % 5
    again, _ = solver.inverse(home[many], pos[many], quat[many], many)
    assert np.array_equal(again, found[many])
    alone, own = arm_in(arm_cfg(name, tmp_path))
    single, _ = own.get_solver("arm").inverse(home[:1], pos[2:3], quat[2:3])
    assert np.array_equal(single, found[2:3])
    sim.destroy()
    alone.destroy()


@pytest.mark.parametrize("name", ["ur10", "panda", "seven"])
def test_poses_out_of_reach_are_flagged_and_finite(name, tmp_path) -> None:
    sim, robot = arm_in(arm_cfg(name, tmp_path), num_envs=3)
    far = torch.tensor([[0.1, 5.0, 0.3], [0.1, 0.2, 0.3], [1e6, 0.0, 0.0]])
    pose = torch.cat([far, torch.tensor([[1.0, 0.0, 0.0, 0.0]] * 3)], dim=1)
    success, qpos = robot.compute_ik(pose, name="arm")
    assert not success[0] and not success[2]
    assert torch.isfinite(qpos).all()
    # The nearest that was found: the arm points at the target beside it.
    tool = robot.compute_fk(qpos, "arm")[0, :3].numpy()
    away = np.linalg.norm(tool - [0.1, 0.2, 0.3])
    ahead = (tool - [0.1, 0.2, 0.3]) @ [0.0, 1.0, 0.0]
    assert ahead > 0.6 * away and ahead > 0.4
    everything, all_qpos = robot.compute_ik(pose, name="arm", return_all_solutions=True)
    assert not everything[0].any() and torch.isfinite(all_qpos).all()
    with pytest.raises(ValueError, match="not finite in rows"):
        robot.compute_ik(pose * float("nan"), name="arm")
    sim.destroy()


def test_a_redundant_arm_approaches_its_posture(tmp_path) -> None:
    found = {}
    for elbow in (-1.0, 1.0):
        cfg = arm_cfg("seven", tmp_path, posture={"joint3": elbow})
        sim, robot = arm_in(cfg)
        qpos = torch.tensor([[0.2, 0.6, 0.0, -1.2, 0.1, 0.8, 0.3]])
        pose = robot.compute_fk(qpos, "arm")
        success, solved = robot.compute_ik(pose, qpos, "arm")
        assert success.all()
        lengths, angles = errors(robot, solved.numpy(), pose)
        assert lengths[0] < 1e-4 and angles[0] < 1e-3
        found[elbow] = float(solved[0, 2])
        sim.destroy()
    assert found[-1.0] < -0.8 and found[1.0] > 0.8


def test_joints_outside_the_part_stay_where_they_are(tmp_path) -> None:
    cfg = arm_cfg("ur10", tmp_path)
    cfg = cfg.replace(
        control_parts={"wrist": ["Joint[4-6]"], "arm": ["Joint[1-6]"]},
        solver_cfg={"wrist": SolverCfg(end_link_name="ee_link", root_link_name="forearm_link")},
    )
    sim, robot = arm_in(cfg, num_envs=2)
    robot.set_qpos(torch.tensor([0.1, -0.4, 0.5]), joint_ids=[0, 1, 2], target=False)
    pose = robot.compute_fk(torch.tensor([0.3, -0.2, 0.4]), "wrist")
    success, qpos = robot.compute_ik(pose, name="wrist")
    assert success.all() and qpos.shape == (2, 3)
    robot.set_qpos(qpos, name="wrist", target=False)
    np.testing.assert_allclose(robot.get_link_pose("ee_link")[:, :3], pose[:, :3], atol=2e-5)
    base = robot.get_control_part_base_pose("wrist")
    assert torch.equal(base, robot.get_link_pose("forearm_link"))
    sim.destroy()


def test_mistakes_are_named(tmp_path) -> None:
    cfg = arm_cfg("panda", tmp_path, ik_nearest_weight=[1.0, 2.0])
    sim, robot = arm_in(cfg)
    with pytest.raises(ConfigError, match="needs 7 values"):
        robot.get_solver("arm")
    with pytest.raises(ValueError, match=r"no control part 'amr'.*Did you mean 'arm'"):
        robot.compute_ik(torch.zeros(1, 7), name="amr")
    sim.destroy()
    sim, robot = arm_in(arm_cfg("seven", tmp_path, posture={"elbow": 1.0}))
    with pytest.raises(ConfigError, match=r"elbow.*joint1"):
        robot.get_solver("arm")
    sim.destroy()
    sim, robot = arm_in(arm_cfg("ur10", tmp_path))
    with pytest.raises(ValueError, match=r"pose must have 3 axes, 1 environments first"):
        robot.compute_batch_ik(torch.zeros(2, 5, 7), name="arm")
    with pytest.raises(ValueError, match=r"joint_seed must have shape \(1, 6\)"):
        robot.compute_ik(torch.tensor([[0.5, 0, 0, 1, 0, 0, 0]]), torch.zeros(5), "arm")
    sim.destroy()
    path = tmp_path / "fork.xml"
    path.write_text(FORK)
    sim, robot = arm_in(RobotCfg(uid="fork", fpath=str(path)))
    with pytest.raises(ValueError, match=r"whole robot suggests no link as the tool: declare"):
        robot.compute_fk(torch.zeros(2))
    sim.destroy()

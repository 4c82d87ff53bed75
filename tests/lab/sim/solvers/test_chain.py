"""Forward kinematics and Jacobians against MuJoCo's, for arms, slides and axes off the origin."""

import mujoco
import numpy as np
import pytest

from tests.helpers.arms import SEVEN, UR5E, arm_cfg, arm_in, dh_matrix, random_qpos

ARMS = ["ur10", "panda", "ur5e", "seven", "gantry"]


@pytest.mark.parametrize("name", ARMS)
def test_frames_and_jacobians_are_mujocos(name, tmp_path) -> None:
    sim, robot = arm_in(arm_cfg(name, tmp_path))
    solver, model = robot.get_solver("arm"), sim.engine.model
    part = robot.get_joint_ids("arm")
    qpos = random_qpos(robot, 20)
    reported = robot.compute_batch_fk(qpos[None], "arm")[0].numpy()
    data, body = sim.engine.data_of(0), solver.chain.body
    for row, expected in zip(qpos, reported, strict=True):
        data.qpos[robot.index.qpos_adr[part]] = row
        mujoco.mj_forward(model, data)
        whole = data.qpos[robot.index.qpos_adr][None]
        pos, quat = solver.forward(whole)
        np.testing.assert_allclose(pos[0], data.xpos[body], atol=1e-12)
        np.testing.assert_allclose(abs(quat[0] @ data.xquat[body]), 1.0, atol=1e-12)
        np.testing.assert_allclose(expected[:3], pos[0], atol=1e-6)
        jacobian = np.zeros((6, model.nv))
        mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], body)
        wanted = jacobian[:, robot.index.dof_adr[part]]
        found = robot.compute_jacobian(row, "arm")[0].numpy()
        np.testing.assert_allclose(found, wanted, atol=1e-5)
        exact = jacobian[:, robot.index.dof_adr[solver.moving]]
        np.testing.assert_allclose(solver.jacobian(whole)[0], exact, atol=1e-12)
    sim.destroy()


@pytest.mark.parametrize(("name", "rows"), [("ur5e", UR5E), ("seven", SEVEN)])
def test_frames_follow_denavit_hartenberg_parameters(name, rows, tmp_path) -> None:
    cfg = arm_cfg(name, tmp_path).replace(init_pos=(0.0, 0.0, 0.0), init_rot=(0.0, 0.0, 0.0))
    sim, robot = arm_in(cfg)
    qpos = random_qpos(robot, 5)
    found = robot.compute_batch_fk(qpos[None], "arm", to_matrix=True)[0].numpy()
    for angles, pose in zip(qpos, found, strict=True):
        expected = np.eye(4)
        for parameters, angle in zip(rows, angles, strict=True):
            expected = expected @ dh_matrix(*parameters, angle)
        np.testing.assert_allclose(pose, expected, atol=1e-6)
    sim.destroy()


def test_kinematics_follow_model_fields_of_each_environment(tmp_path) -> None:
    sim, robot = arm_in(arm_cfg("seven", tmp_path), num_envs=3)
    engine, home = sim.engine, np.full((3, 7), 0.3)
    before = robot.compute_fk(home[0], "arm").numpy()
    body = robot.body_of("link4")
    longer = engine.model.body_pos[body] + [0.0, 0.1, 0.0]
    engine.write_model("body_pos", longer, np.array([1]), slice(3 * body, 3 * body + 3))
    robot.set_qpos(home, target=False)
    found = robot.compute_fk(home, "arm").numpy()
    np.testing.assert_allclose(found, robot.get_link_pose("tool"), atol=1e-6)
    assert np.array_equal(found[[0, 2]], before[[0, 2]])
    assert np.linalg.norm(found[1, :3] - before[1, :3]) > 0.05
    reached, solved = robot.compute_ik(found, np.zeros(7), "arm")
    robot.set_qpos(solved, target=False)
    assert reached.all()
    np.testing.assert_allclose(robot.get_link_pose("tool")[:, :3], found[:, :3], atol=2e-5)
    sim.destroy()


def test_kinematics_do_not_change_the_simulation(tmp_path) -> None:
    sim, robot = arm_in(arm_cfg("panda", tmp_path), num_envs=2)
    sim.update(step=3)
    pose = robot.compute_fk(random_qpos(robot, 2), "arm")
    before, version = sim.engine.rows.copy(), sim.engine.version
    robot.compute_ik(pose, name="arm")
    robot.compute_jacobian(name="arm")
    assert np.array_equal(sim.engine.rows, before) and sim.engine.version == version
    sim.destroy()

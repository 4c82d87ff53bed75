"""Handles: what they store of the engine, and what remains of them without one."""

import gc
import weakref

import numpy as np
import pytest
import torch

from embodichain.lab.sim import SimulationManager, SimulationManagerCfg
from embodichain.lab.sim.cfg import RigidObjectCfg, RobotCfg
from tests.lab.sim.conftest import build

JOINT_READS = ("qpos", "qvel", "qacc", "qf", "target_qpos", "target_qvel", "qvel_limits")
GAIN_READS = ("joint_stiffness", "joint_damping", "joint_friction", "joint_armature", "qf_limits")


def test_joints_that_are_neighbours_are_read_without_a_copy(sim):
    robot = sim.get_robot("ur10")
    qpos, qvel = robot.read_qpos(), robot.read_qvel()
    assert np.shares_memory(qpos, sim.engine.rows) and np.shares_memory(qvel, sim.engine.rows)
    assert qpos.shape == qvel.shape == (3, 6)
    before = qpos.copy()
    robot.set_qpos(robot.get_qpos() + 0.3)
    sim.update(step=5)
    assert (qpos != before).all(), "the view follows the simulation"
    assert np.array_equal(qpos, sim.engine.state("qpos")[:, robot.entity.qpos_adr])


def test_scattered_joints_are_read_in_their_order(tmp_path):
    """A ball joint between two hinges: columns 0 and 5 of qpos, 0 and 4 of qvel."""
    path = tmp_path / "chain.xml"
    joints = ['<joint name="first"/>', '<joint type="ball"/>', '<joint name="last"/>']
    body = "<body pos='0 0 0.1'>{}<geom size='0.1' mass='1'/>{}</body>"
    inner = body.format(joints[1], body.format(joints[2], ""))
    path.write_text(f"<mujoco><worldbody>{body.format(joints[0], inner)}</worldbody></mujoco>")
    sim = SimulationManager(SimulationManagerCfg(headless=True, num_envs=2))
    robot = sim.add_robot(RobotCfg(uid="chain", fpath=str(path), init_pos=(0, 0, 2)))
    robot.set_qpos(torch.tensor([[0.1, 0.2], [0.3, 0.4]]), target=False)
    robot.set_qvel(torch.tensor([[1.0, 2.0], [3.0, 4.0]]), target=False)
    qpos, qvel = sim.engine.state("qpos"), sim.engine.state("qvel")
    first, last = robot.entity.qpos_adr
    assert last - first == 5
    np.testing.assert_allclose(qpos[:, [first, last]], [[0.1, 0.2], [0.3, 0.4]], atol=1e-7)
    assert np.array_equal(robot.read_qpos(), qpos[:, [first, last]])
    assert np.array_equal(robot.read_qvel(), qvel[:, robot.entity.dof_adr])
    assert robot.get_qvel().tolist() == [[1.0, 2.0], [3.0, 4.0]]
    sim.destroy()


@pytest.mark.parametrize("name", [*JOINT_READS, *GAIN_READS])
def test_reads_of_joints_are_fresh_float32_tensors(sim, name):
    data = sim.get_robot("ur10").body_data
    values = getattr(data, name)
    assert values.shape == (3, 6) and values.dtype == torch.float32
    kept = values.clone()
    values += 1.0
    assert torch.equal(getattr(data, name), kept)


def test_reads_of_links_agree_with_those_by_name(sim):
    robot = sim.get_robot("ur10")
    robot.set_qvel(torch.full((3, 6), 0.5), target=False)
    data, last = robot.body_data, len(robot.link_names) - 1
    assert data.body_link_pose.shape == (3, last + 1, 7)
    assert data.body_link_vel.shape == (3, last + 1, 6)
    assert torch.equal(data.body_link_pose[:, last], robot.get_link_pose("ee_link"))
    assert torch.equal(data.body_link_vel[:, last], robot.get_link_vel("ee_link"))
    assert data.body_link_vel[:, last].any() and not data.root_vel.any()
    assert torch.equal(torch.cat([data.root_lin_vel, data.root_ang_vel], 1), data.root_vel)
    assert torch.equal(data.root_pose, robot.get_local_pose())


def test_reads_of_a_body_agree_with_each_other(sim):
    box = sim.get_rigid_object("box")
    box.set_velocity([[1.0, 2.0, 3.0]] * 3, [[0.4, 0.5, 0.6]] * 3)
    data = box.body_data
    assert torch.equal(torch.cat([data.lin_vel, data.ang_vel], 1), data.vel)
    assert torch.equal(torch.cat([data.lin_acc, data.ang_acc], 1), data.acc)
    assert torch.equal(torch.cat([data.pose, data.vel], 1), box.body_state)
    np.testing.assert_allclose(data.vel, [[1.0, 2.0, 3.0, 0.4, 0.5, 0.6]] * 3, rtol=1e-6)
    assert torch.equal(data.com_pose, data.default_com_pose)
    box.set_com_pose([[0.01, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]] * 3)
    np.testing.assert_allclose(data.com_pose[:, 0], 0.01)
    assert not torch.equal(data.com_pose, data.default_com_pose)
    assert sim.get_rigid_object("table").body_data is None


def test_a_handle_that_was_removed_has_no_place_in_the_model():
    sim = build()
    box = sim.get_rigid_object("box")
    assert sim.remove_asset("box") and not sim.remove_asset("box")
    with pytest.raises(RuntimeError, match="box was removed from the scene before"):
        box.get_local_pose()
    sim.destroy()


def test_a_destroyed_simulation_frees_its_engine_and_leaves_the_names():
    sim = build()
    robot, box = sim.get_robot("ur10"), sim.get_rigid_object("box")
    box.get_local_pose(), robot.get_link_vel("ee_link"), robot.read_qpos()
    engine = weakref.ref(sim.engine)
    sim.destroy()
    gc.collect()
    assert engine() is None
    assert robot.joint_names[0] == "Joint1" and robot.get_qpos_limits().shape == (3, 6, 2)
    for read in (robot.read_qpos, robot.get_qvel, box.get_local_pose, box.get_mass):
        with pytest.raises(RuntimeError, match="destroyed"):
            read()


@pytest.mark.parametrize("num_envs", [0, -1])
def test_there_is_at_least_one_environment(num_envs):
    with pytest.raises(ValueError, match=f"num_envs.*at least 1, got {num_envs}"):
        SimulationManager(SimulationManagerCfg(headless=True, num_envs=num_envs))


def test_sizes_of_objects_differ_between_environments(sim):
    box = sim.get_rigid_object("box")
    box.set_body_scale([[1.0, 1.0, 1.0], [2.0, 1.0, 1.0]], env_ids=[0, 2])
    assert box.get_body_scale().tolist() == [[1, 1, 1], [1, 1, 1], [2, 1, 1]]
    assert box.get_mass().tolist() == [2.0, 2.0, 4.0]
    with pytest.raises(ValueError, match="scales must be positive"):
        box.set_body_scale([[0.0, 1.0, 1.0]] * 3)


def test_collision_takes_booleans_only(sim):
    sim.add_rigid_object(RigidObjectCfg(uid="ball"))
    ball = sim.get_rigid_object("ball")
    ball.enable_collision(torch.tensor([True, False, True]))
    geom = int(ball.entity.geom_ids[0])
    assert sim.engine.model_field("geom_contype")[:, geom].astype(bool).tolist() == [1, 0, 1]
    with pytest.raises(ValueError, match="booleans"):
        ball.enable_collision([1, 0, 1])

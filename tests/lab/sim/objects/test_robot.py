"""Robots: limits before physics, targets, teleports, drives, links, per environment."""

import mujoco
import numpy as np
import pytest
import torch

from tests.lab.sim.conftest import HOME, build


@pytest.fixture
def robot(sim):
    return sim.get_robot("ur10")


def test_limits_and_names_are_known_before_physics(sim, robot):
    limits = robot.body_data.qpos_limits
    assert limits.shape == (3, 6, 2) and limits.dtype == torch.float32
    assert not sim.compiled
    assert robot.joint_names == [f"Joint{i}" for i in range(1, 7)]
    assert robot.active_joint_ids == list(range(6)) and robot.dof == 6
    assert robot.link_names[0] == "base_link" and robot.link_names[-1] == "ee_link"
    assert robot.control_parts["wrist"] == ["Joint4", "Joint5", "Joint6"]
    assert robot.get_joint_ids("wrist") == [3, 4, 5]
    with pytest.raises(ValueError, match=r"no control part 'wirst'.*Did you mean 'wrist'"):
        robot.get_joint_ids("wirst")


def test_it_starts_at_init_qpos_and_stays(sim, robot):
    np.testing.assert_allclose(robot.get_qpos(), np.tile(HOME, (3, 1)), atol=1e-6)
    np.testing.assert_allclose(robot.get_qpos(target=True), np.tile(HOME, (3, 1)), atol=1e-6)
    sim.update(step=100)
    np.testing.assert_allclose(robot.get_qpos(), np.tile(HOME, (3, 1)), atol=2e-2)


def test_targets_are_reached_and_teleports_are_immediate(sim, robot):
    target = torch.tensor(HOME) + torch.tensor([[0.1], [-0.1], [0.05]])
    robot.set_qpos(target)
    np.testing.assert_allclose(robot.get_qpos(), np.tile(HOME, (3, 1)), atol=1e-6)
    sim.update(step=200)
    np.testing.assert_allclose(robot.get_qpos(), target, atol=2e-2)
    robot.set_qpos(torch.zeros(2, 3), joint_ids=[0, 2, 4], env_ids=[0, 2], target=False)
    assert (robot.get_qpos()[[0, 2]][:, [0, 2, 4]] == 0).all()
    assert (robot.get_qpos()[1] != 0).all()
    robot.set_qpos(torch.ones(3), name="wrist", target=False)
    assert (robot.get_qpos(name="wrist") == 1).all()


def test_targets_are_clamped_to_the_limits(robot):
    robot.set_qpos(torch.full((3, 6), 100.0))
    np.testing.assert_allclose(robot.get_qpos(target=True), robot.body_data.qpos_limits[..., 1])
    robot.set_qpos(torch.full((3, 6), -100.0), target=False)
    np.testing.assert_allclose(robot.get_qpos(), robot.body_data.qpos_limits[..., 0])


@pytest.mark.parametrize(
    ("kwargs", "match"),
    [
        ({"qpos": torch.zeros(3, 5)}, r"\(3, 6\) or \(6,\), got \(3, 5\)"),
        ({"qpos": torch.zeros(2, 6)}, r"\(3, 6\)"),
        ({"qpos": torch.zeros(3, 6, 1)}, r"\(3, 6\)"),
        ({"qpos": torch.full((3, 6), float("nan"))}, "not finite in rows"),
        ({"qpos": torch.zeros(3, 2), "joint_ids": [0, 6]}, r"\[0, 6\)"),
        ({"qpos": torch.zeros(1, 6), "env_ids": [3]}, r"\[0, 3\)"),
    ],
)
def test_bad_input_raises_at_the_call(sim, robot, kwargs, match):
    before = sim.engine.rows.copy()
    with pytest.raises(ValueError, match=match):
        robot.set_qpos(**kwargs)
    np.testing.assert_array_equal(sim.engine.rows, before)


def test_effort_is_spring_plus_damper(sim, robot):
    robot.set_qpos(torch.tensor(HOME) + 0.1)
    q, v = robot.get_qpos(), robot.get_qvel()
    sim.update(step=1)
    np.testing.assert_allclose(
        robot.get_qf(), 1e4 * (torch.tensor(HOME) + 0.1 - q) - 1e3 * v, rtol=1e-3
    )


def test_a_velocity_target_is_followed(sim, robot):
    robot.set_joint_drive(stiffness=torch.full((3, 1), 1.0), joint_ids=[5])
    robot.set_qvel(torch.full((3, 1), 0.5), joint_ids=[5])
    assert torch.equal(robot.get_qvel(target=True)[:, 5], torch.full((3,), 0.5))
    sim.update(step=50)
    np.testing.assert_allclose(robot.get_qvel()[:, 5], 0.5, atol=0.02)
    np.testing.assert_allclose(robot.get_qpos(target=True)[:, 5], HOME[5], atol=1e-4)
    robot.reset()
    assert not robot.get_qvel(target=True).any()


def test_efforts_are_read_as_they_were_set_until_a_step(sim, robot):
    sim.update(step=1)
    before = robot.get_qf()
    robot.set_qf(torch.tensor([[7.0, -3.0]]), joint_ids=[5, 1], env_ids=[2])
    expected = before.clone()
    expected[2, [5, 1]] = torch.tensor([7.0, -3.0])
    assert torch.equal(robot.get_qf(), expected)
    assert torch.equal(robot.get_proprioception()["qf"], expected)
    robot.set_qf(torch.full((3, 1), 4.0), joint_ids=[0])
    expected[:, 0] = 4.0
    assert torch.equal(robot.body_data.qf, expected)
    robot.reset(env_ids=[2])
    assert (robot.get_qf()[2] != expected[2]).any() and robot.get_qf()[0, 0] == 4.0
    sim.update(step=1)
    assert (robot.get_qf()[:, 0] != 4.0).all()
    robot.set_qf(torch.ones(3, 6))
    assert torch.equal(robot.get_qf(), torch.ones(3, 6))


def test_drives_of_some_joints_and_environments(robot):
    robot.set_joint_drive(damping=torch.tensor([[5.0]]), joint_ids=[4], env_ids=[1])
    drive = robot.get_joint_drive()
    assert len(drive) == 5 and all(value.shape == (3, 6) for value in drive)
    some = robot.get_joint_drive(joint_ids=torch.tensor([4, 0]), env_ids=[0, 1])
    assert some[1].tolist() == [[1e3, 1e3], [5.0, 1e3]]
    assert robot.body_data.joint_armature.shape == (3, 6)
    with pytest.raises(ValueError, match=r"\[0, 6\)"):
        robot.get_joint_drive(joint_ids=[6])


def test_gains_per_environment(sim, robot):
    robot.set_joint_drive(stiffness=torch.full((1, 6), 100.0), env_ids=[1])
    stiffness = robot.get_joint_drive()[0]
    assert (stiffness[1] == 100).all() and (stiffness[[0, 2]] == 1e4).all()
    robot.set_qpos(torch.tensor(HOME) + 0.1)
    sim.update(step=1)
    force = robot.get_qf()
    np.testing.assert_allclose(force[1], 10.0, atol=0.5)
    np.testing.assert_allclose(force[0], 1000.0, rtol=0.01)
    robot.set_joint_drive(max_effort=torch.full((3, 6), 5.0))
    sim.update(step=1)
    assert (sim.engine.acceleration("qfrc_actuator").max() <= 5.0 + 1e-9).all()
    with pytest.raises(ValueError, match="negative"):
        robot.set_joint_drive(damping=torch.full((3, 6), -1.0))


def test_link_pose_and_velocity_agree_with_mujoco(sim, robot):
    robot.set_qpos(torch.tensor(HOME) + 0.3)
    sim.update(step=7)
    body = robot.body_of("ee_link")
    for env in range(3):
        data = sim.engine.data_of(env)
        np.testing.assert_allclose(
            robot.get_link_pose("ee_link")[env, :3], data.xpos[body], atol=1e-6
        )
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(
            sim.engine.model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 0
        )
        np.testing.assert_allclose(
            robot.get_link_vel("ee_link")[env], np.r_[velocity[3:], velocity[:3]], atol=1e-5
        )
    poses = robot.body_data.body_link_pose
    assert torch.equal(poses[:, robot.link_names.index("ee_link")], robot.get_link_pose("ee_link"))
    with pytest.raises(ValueError, match=r"no link 'ee_lnk'.*Did you mean 'ee_link'"):
        robot.get_link_pose("ee_lnk")


def test_root_pose_per_environment(sim, robot):
    pose = robot.get_local_pose()
    np.testing.assert_allclose(pose, np.tile([0, 0, 1, 1, 0, 0, 0], (3, 1)), atol=1e-6)
    start = robot.get_link_pose("ee_link")
    pose[1, :3] += torch.tensor([0.5, 0, 0])
    robot.set_local_pose(pose)
    shift = robot.get_link_pose("ee_link") - start
    np.testing.assert_allclose(shift[:, :3], [[0, 0, 0], [0.5, 0, 0], [0, 0, 0]], atol=1e-5)


def test_mass_of_links(robot):
    mass = robot.get_mass(["forearm_link"])
    robot.set_mass(mass[:1] * 2, ["forearm_link"], env_ids=[2])
    np.testing.assert_allclose(robot.get_mass(["forearm_link"])[:, 0] / mass[:, 0], [1, 1, 2])


def test_applied_effort_and_clear(sim, robot):
    robot.set_qf(torch.full((3, 6), 2.0))
    assert (sim.engine.state("qfrc_applied")[:, robot.entity.dof_adr] == 2).all()
    sim.update(step=3)
    robot.clear_dynamics()
    assert not sim.engine.state("qfrc_applied").any()
    assert not robot.get_qvel().any()


def test_excluded_entities_survive_a_reset(sim, robot):
    box = sim.get_rigid_object("box")
    sim.update(step=10)
    q, pose = robot.get_qpos() + 0, box.get_local_pose()
    sim.reset_objects_state(excluded_uids=["box"])
    assert torch.equal(box.get_local_pose(), pose)
    np.testing.assert_allclose(robot.get_qpos(), np.tile(HOME, (3, 1)), atol=1e-6)
    assert not torch.equal(robot.get_qpos(), q)


@pytest.mark.parametrize("persistent", [True, False])
def test_the_simulation_continues_from_its_state(persistent):
    sim = build(persistent=persistent)
    robot = sim.get_robot("ur10")
    robot.set_qvel(torch.full((3, 6), 0.3))
    robot.set_joint_drive(stiffness=torch.full((1, 6), 500.0), env_ids=[1])
    sim.update(step=5)
    saved = sim.state_dict()

    def go(s):
        r = s.get_robot("ur10")
        r.set_qpos(torch.tensor(HOME) + 0.2)
        s.update(step=8)
        return s.engine.rows.tobytes() + r.get_qf().numpy().tobytes()

    expected = go(sim)
    other = build(persistent=not persistent)
    other.load_state_dict(saved)
    assert go(other) == expected


def test_proprioception_is_positions_velocities_and_efforts(sim, robot):
    robot.set_qpos(torch.tensor(HOME) + 0.1)
    sim.update(step=3)
    found = robot.get_proprioception()
    assert list(found) == ["qpos", "qvel", "qf"]
    for name, wanted in (("qpos", robot.get_qpos()), ("qvel", robot.get_qvel())):
        assert torch.equal(found[name], wanted) and wanted.any()
    assert torch.equal(found["qf"], robot.get_qf()) and robot.get_qf().any()

"""Handles of robots whose MJCF file has actuators: targets, controls, gains, efforts."""

import mujoco
import numpy as np
import pytest
import torch

from embodichain.lab.sim.cfg import JointDrivePropertiesCfg, RobotCfg, SimulationManagerCfg
from embodichain.lab.sim.sim_manager import SimulationManager
from tests.helpers.mjcf_robots import HAND, ROBOTS, UR5E_HOME


@pytest.fixture
def add(tmp_path):
    """``add(name, **cfg)``: a robot of `ROBOTS` in three environments."""
    sims = []

    def _add(name, num_envs=3, **cfg):
        path = tmp_path / f"{name}.xml"
        path.write_text(ROBOTS[name])
        sim = SimulationManager(SimulationManagerCfg(headless=True, num_envs=num_envs))
        sims.append(sim)
        return sim, sim.add_robot(RobotCfg(uid=name, fpath=str(path), **cfg))

    yield _add
    for sim in sims:
        sim.destroy()


def control(robot, name):
    (i,) = robot.find_actuators(name)
    return robot.read_ctrl()[:, i]


def forces(sim, robot, name, qpos, qvel):
    """(N,) effort of a joint's actuators, with the joint put at a state in all environments."""
    joint = robot.joint_names.index(name)
    robot.set_qpos([qpos], joint_ids=[joint], target=False)
    robot.set_qvel([qvel], joint_ids=[joint], target=False)
    sim.engine.forward()
    return robot.read_qf()[:, joint].copy()


def test_the_arm_goes_where_its_own_servos_are_told(add):
    sim, robot = add("ur5e", init_pos=(0, 0, 1), gravcomp=1.0)
    target = np.asarray(UR5E_HOME) + 0.2
    robot.set_qpos(target)
    np.testing.assert_allclose(robot.read_ctrl(), np.tile(target, (3, 1)))
    sim.update(step=300)
    np.testing.assert_allclose(robot.get_qpos()[0], target, atol=2e-3)
    # Gains and limits are what Menagerie's file says: 0.1 rad of error, 1 rad/s
    assert forces(sim, robot, "wrist_1_joint", target[3] + 0.05, 0.01)[0] == pytest.approx(
        -500 * 0.05 - 100 * 0.01
    )
    assert forces(sim, robot, "wrist_1_joint", target[3] + 0.5, 0.0)[0] == -28.0


def test_a_geared_servo_takes_joint_targets_and_joint_gains(add):
    sim, robot = add("zoo")
    joint = robot.joint_names.index("geared")
    robot.set_qpos([0.5], joint_ids=[joint])
    assert control(robot, "geared_servo").tolist() == [1.5] * 3
    assert robot.get_qpos(target=True)[:, joint].tolist() == [0.5] * 3
    stiffness, damping = robot.get_joint_drive()[:2]
    assert (stiffness[0, joint], damping[0, joint]) == (63.0, 4.5)
    walk = -2 * 0.3  # of the integrating servo on the same joint, whose setpoint is 0
    there = 63 * 0.2 - 4.5 * 0.1 + walk
    assert forces(sim, robot, "geared", 0.3, 0.1)[0] == pytest.approx(there)
    robot.set_joint_drive(stiffness=[[90.0]], damping=[[1.0]], joint_ids=[joint], env_ids=[1])
    efforts = forces(sim, robot, "geared", 0.3, 0.1)
    assert efforts == pytest.approx([there, 90 * 0.2 - 1.0 * 0.1 + walk, there])


def test_an_uneven_force_range_stays_so_when_it_is_scaled(add):
    sim, robot = add("zoo")
    joint = robot.joint_names.index("servoed")
    model = sim.engine.model
    kp = 40.0
    assert model.actuator_forcerange[0].tolist() == [-9, 11]
    robot.set_qpos([2.0], joint_ids=[joint])
    assert control(robot, "servo")[0] == 2.0
    robot.drives.write("strength", np.array([[0.5], [1.0]]), np.array([0, 2]), np.array([joint]))
    # The joint's own limit of 6 stands behind the actuator's.
    assert forces(sim, robot, "servoed", -1.0, 0.0).tolist() == [5.5, 6.0, 6.0]
    robot.set_qpos([-1.0], joint_ids=[joint])
    assert forces(sim, robot, "servoed", 1.9, 0.0).tolist() == [-4.5, -6.0, -6.0]
    assert robot.drives.stiffness[0, joint] == kp


def test_a_velocity_servo_takes_velocity_targets(add):
    sim, robot = add("zoo")
    spun, paired = (robot.joint_names.index(n) for n in ("spun", "paired"))
    robot.set_qvel([0.4], joint_ids=[spun])
    assert control(robot, "wheel") == pytest.approx(-0.8)
    sim.engine.forward()
    # force = 2 (-0.8 - -2 v), times the gear; the damper and the DC motor have no control
    assert robot.read_qf()[0, spun] == pytest.approx(-2 * 2 * -0.8)
    # Beside a position servo the velocity servo takes it, and no drag stays in its way.
    robot.set_qvel([0.4], joint_ids=[paired])
    assert control(robot, "brake") == pytest.approx(0.4)
    robot.set_qpos([0.1], joint_ids=[paired])
    assert forces(sim, robot, "paired", 0.1, 0.4) == pytest.approx(0.0, abs=1e-12)
    robot.reset()
    assert control(robot, "brake").tolist() == control(robot, "wheel").tolist() == [0.0] * 3
    assert robot.get_qvel(target=True).abs().max() == 0


def test_controls_are_set_and_read_by_name(add):
    sim, robot = add("hand")
    assert robot.actuator_names == ["fingers"]
    assert robot.ctrl_limits.tolist() == [[0.0, 255.0]]
    robot.set_ctrl([[0.0], [255.0]], names="fing.*", env_ids=[0, 2])
    assert robot.get_ctrl().tolist() == [[0.0], [0.0], [255.0]]
    sim.update(step=400)
    driver = robot.joint_names.index("right_driver_joint")
    qpos = robot.get_qpos()[:, driver]
    assert qpos[2] - qpos[0] > 0.3, "the tendon closes the hand"
    left = robot.joint_names.index("left_driver_joint")
    assert qpos[2] == pytest.approx(float(robot.get_qpos()[2, left]), abs=5e-3)
    with pytest.raises(ValueError, match=r"no actuator of hand matches 'finger'; there are: fing"):
        robot.set_ctrl([1.0], names="finger")
    with pytest.raises(ValueError, match=r"actuator_ids must be in \[0, 1\)"):
        robot.get_ctrl([1])
    with pytest.raises(ValueError, match=r"ctrl must have shape \(3, 1\)"):
        robot.set_ctrl([1.0, 2.0])
    with pytest.raises(ValueError, match="have no drive"):
        robot.set_qpos([0.1], joint_ids=[driver])


def test_a_control_of_a_drive_is_its_target_within_the_joints_limits(add):
    pros = JointDrivePropertiesCfg(stiffness={"geared": 50.0}, damping={"geared": 5.0})
    sim, robot = add("zoo", drive_pros=pros)
    joint = robot.joint_names.index("geared")
    assert robot.actuator_names[-1] == "geared"
    robot.set_qvel([0.5], joint_ids=[joint])
    robot.set_ctrl([7.0], names="geared")
    assert control(robot, "geared").tolist() == [2.0] * 3  # the joint ends at 2
    assert robot.get_qpos(target=True)[0, joint] == 2.0
    assert robot.get_qvel(target=True)[0, joint] == 0.0


def test_efforts_on_a_joint_are_those_of_every_actuator(add):
    sim, robot = add("zoo", num_envs=1)
    ctrl = torch.linspace(-0.5, 0.5, len(robot.actuator_names))
    robot.set_ctrl(ctrl)
    sim.update(step=3)
    data = mujoco.MjData(sim.engine.model)
    mujoco.mj_setState(
        sim.engine.model, data, sim.engine.rows[0], mujoco.mjtState.mjSTATE_INTEGRATION
    )
    mujoco.mj_forward(sim.engine.model, data)
    sim.engine.forward()
    dofs = robot.entity.dof_adr
    np.testing.assert_allclose(robot.read_qf()[0], data.qfrc_actuator[dofs], rtol=1e-12)
    assert np.abs(robot.read_qf()).max() > 0.5


def test_a_reset_of_one_robot_restores_activations_and_ball_joints(add):
    sim, robot = add("zoo")
    start = sim.engine.rows.copy()
    robot.set_ctrl(np.full(len(robot.actuator_names), 0.3))
    sim.update(step=20)
    act = sim.engine.component("act")
    assert (sim.engine.rows[:, act] != start[:, act]).any()
    robot.reset(env_ids=[1])
    kept = [sim.engine.component(n) for n in ("qpos", "qvel", "act", "ctrl", "qacc_warmstart")]
    for columns in kept:
        np.testing.assert_array_equal(sim.engine.rows[1, columns], start[1, columns])
    assert (sim.engine.rows[0, act] != start[0, act]).any()


KEYED = HAND.replace(
    "</mujoco>",
    '<keyframe><key name="other"/><key name="home" qpos="0.4 0.3 0.2 0.1 0.4 0.3 0.2 0.1" '
    'qvel="0.1 0 0 0 0 0 0 0.2" ctrl="90"/></keyframe></mujoco>',
)


def test_the_keyframe_is_the_start(tmp_path, caplog):
    path = tmp_path / "hand.xml"
    path.write_text(KEYED)
    sim = SimulationManager(SimulationManagerCfg(headless=True, num_envs=2))
    robot = sim.add_robot(RobotCfg(uid="hand", fpath=str(path)))
    assert robot.get_ctrl().tolist() == [[90.0]] * 2
    np.testing.assert_allclose(robot.get_qpos()[1], [0.4, 0.3, 0.2, 0.1] * 2)
    np.testing.assert_allclose(robot.get_qvel()[1], [0.1, 0, 0, 0, 0, 0, 0, 0.2])
    assert "it starts at its keyframe 'home'; left out: 'other'" in caplog.text
    sim.destroy()

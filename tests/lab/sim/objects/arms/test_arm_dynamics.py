"""Dynamics of an arm from the engine's fields, against MuJoCo's own functions."""

import mujoco
import numpy as np

from embodichain.lab.sim import SimulationManager, SimulationManagerCfg
from embodichain.lab.sim.cfg import JointDrivePropertiesCfg, RobotCfg
from embodichain.lab.sim.objects.arms.arm_dynamics import ArmDynamics

READY = [0.3, -0.57, 0.2, -2.0, 0.4, 2.3, 0.74, 0.02, 0.03]


def test_mass_bias_jacobian_and_velocity_are_mujocos() -> None:
    sim = SimulationManager(SimulationManagerCfg(headless=True, num_envs=3, num_threads=1))
    robot = sim.add_robot(
        RobotCfg(
            uid="panda",
            fpath="panda_description/urdf/panda.urdf",
            init_pos=(0.2, -0.1, 0.4),
            init_rot=(10.0, -20.0, 90.0),
            drive_pros=JointDrivePropertiesCfg(armature=0.05),
        )
    )
    rng = np.random.default_rng(5)
    robot.set_qpos(np.array(READY) + 0.1 * rng.normal(size=(3, 9)), target=False)
    robot.set_qvel(rng.normal(size=(3, 9)), target=False)
    robot.set_mass(np.array([[1.0], [2.0], [4.0]]), link_names=["panda_link5"])
    engine, joints = sim.engine, [6, 0, 3]
    engine.write_model("body_gravcomp", 0.5)
    body = robot.body_of("panda_hand")
    dynamics = ArmDynamics(robot, joints, body)
    mass, bias, jacobian = dynamics.mass_matrix(), dynamics.bias(), dynamics.jacobian()
    velocity, pose = dynamics.velocity(), dynamics.pose()
    for env in range(3):
        model, data = engine.model_of(env), engine.data_of(env)
        nv, dofs = model.nv, robot.index.dof_adr[joints]
        full, jacp, jacr = np.zeros((nv, nv)), np.zeros((3, nv)), np.zeros((3, nv))
        mujoco.mj_fullM(model, data, full)
        mujoco.mj_jacBody(model, data, jacp, jacr, body)
        assert np.abs(mass[..., env] - full[np.ix_(dofs, dofs)]).max() < 1e-12
        expected = np.concatenate([jacp, jacr])
        assert np.abs(velocity[:, env] - expected @ data.qvel).max() < 1e-12
        assert np.abs(jacobian[..., env] - expected[:, dofs]).max() < 1e-12
        still = data.qfrc_bias - data.qfrc_gravcomp
        assert np.abs(bias[:, env] - still[dofs]).max() < 1e-12
        assert np.abs(data.qfrc_gravcomp).max() > 1.0
        assert np.array_equal(pose[env], [*data.xpos[body], *data.xquat[body]])
    assert np.ptp(mass[1, 1]) > 0.1  # masses differ
    sim.destroy()

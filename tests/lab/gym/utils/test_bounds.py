"""Joints without limits have finite action bounds, the same with and without an action term."""

import numpy as np

from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import ActionTermCfg, EnvCfg
from embodichain.lab.gym.envs.managers.term import finite_limits
from embodichain.lab.sim.cfg import JointDrivePropertiesCfg, RobotCfg

ARM = """<mujoco><worldbody><body name="base"><geom size="0.1"/>
  <body name="a"><joint name="free" type="hinge" axis="0 0 1"/><geom size="0.1" pos="0.3 0 0"/>
    <body name="b" pos="0.6 0 0"><joint name="held" type="hinge" axis="0 0 1" range="-30 60"/>
      <geom size="0.1"/></body></body></body></worldbody></mujoco>"""


def test_unlimited_sides_get_a_turn_and_ids_choose() -> None:
    limits = [[-np.inf, np.inf], [-1.0, 2.0], [0.5, np.inf]]
    low, high = finite_limits(limits, [2, 0])
    np.testing.assert_array_equal(low, [0.5, -2 * np.pi])
    np.testing.assert_array_equal(high, [2 * np.pi, 2 * np.pi])


def test_default_actions_and_joint_position_have_the_same_bounds(tmp_path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    term = ActionTermCfg(func="joint_position", params={"entity_cfg": {"uid": "arm"}})
    spaces = []
    for actions in ({}, {"arm": term}):
        drives = JointDrivePropertiesCfg(stiffness=1e4, damping=1e3)
        robot = RobotCfg(uid="arm", fpath=str(path), drive_pros=drives)
        env = BaseEnv(EnvCfg(robot=robot, actions=actions))
        spaces.append(env.single_action_space)
        env.close()
    assert spaces[0] == spaces[1]
    expected = np.float32([2 * np.pi, np.deg2rad(60)])
    np.testing.assert_allclose(spaces[0].high, expected, rtol=1e-6)
    np.testing.assert_allclose(spaces[0].low, np.float32([-2 * np.pi, -np.deg2rad(30)]), rtol=1e-6)

"""Forces between links and their parents, of arms at rest."""

import numpy as np
import pytest

from embodichain.lab.sim.cfg import JointDrivePropertiesCfg, RobotCfg
from embodichain.lab.sim.sensors import ForceTorqueSensorCfg, LinksCfg

G = 9.81
ARM = """
<mujoco>
  <worldbody>
    <body name="base" pos="0 0 2">
      <geom size=".05" mass="1"/>
      <body name="upper">
        <joint name="shoulder" axis="0 1 0" range="-3 3"/>
        <geom type="box" size=".01 .01 .01" pos="0.5 0 0" mass="2"/>
        <body name="tool" pos="1 0 0"><geom type="box" size=".01 .01 .01" mass="1"/></body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    drive = JointDrivePropertiesCfg(drive_type="force", stiffness=1e6, damping=1e4)
    return RobotCfg(uid="arm", fpath=str(path), drive_pros=drive, init_pos=(0, 0, 2))


def test_a_stretched_arm_carries_its_weight_and_the_moment_of_it(scene, arm):
    cfg = ForceTorqueSensorCfg(uid="wrench", of=LinksCfg(uid="arm", link_names=["upper", "tool"]))
    sim = scene([], [cfg], robots=[arm])
    sim.update(step=400)
    wrench = sim.get_sensor("wrench")
    assert wrench.names == ("upper", "tool")
    force, torque = wrench.read_force(), wrench.read_torque()
    assert force.shape == torque.shape == (3, 2, 3)
    # Each parent holds up what hangs on the link: 2 + 1 kg, and 1 kg.
    np.testing.assert_allclose(force[:, 0], [[0, 0, 3 * G]] * 3, atol=0.02)
    np.testing.assert_allclose(force[:, 1], [[0, 0, 1 * G]] * 3, atol=0.02)
    # About the shoulder gravity turns by r x f of 2 kg at 0.5 m and 1 kg at 1 m along x.
    np.testing.assert_allclose(torque[:, 0], [[0, -2 * G, 0]] * 3, atol=0.02)
    np.testing.assert_allclose(torque[:, 1], 0.0, atol=0.02)
    data = wrench.get_data()
    assert data["force"].shape == data["torque"].shape == (3, 2, 3)

"""Forces at joints: of a static arm, of springs, of limits."""

import numpy as np
import pytest

from embodichain.lab.sim.cfg import JointDrivePropertiesCfg, RobotCfg
from embodichain.lab.sim.sensors import JointsCfg, JointTorqueSensorCfg
from embodichain.utils.errors import ConfigError
from tests.lab.sim.sensors.conftest import cube

G = 9.81
ARM = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="base">
      <geom size=".05" mass="1"/>
      <body name="upper">
        <joint name="shoulder" axis="0 1 0" range="-3 3"/>
        <geom type="box" size=".01 .01 .01" pos="0.5 0 0" mass="2"/>
        <body name="fore" pos="1 0 0">
          <joint name="elbow" axis="0 1 0" range="-3 3" {spring}/>
          <geom type="box" size=".01 .01 .01" pos="0.5 0 0" mass="1"/>
        </body>
      </body>
    </body>
    <body name="lift" pos="0 2 0">
      <joint name="lift" type="slide" axis="0 0 1" range="0 1" limited="true"/>
      <geom size=".05" mass="3"/>
    </body>
  </worldbody>
</mujoco>
"""
SHOULDER = -(2 * 0.5 + 1 * 1.5) * G  # about y gravity turns the stretched arm by +sum(m x) g
ELBOW = -1 * 0.5 * G


def arm(tmp_path, spring="", stiffness=None):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(spring=spring))
    gains = stiffness or {"shoulder": 1e6, "elbow": 1e6}
    damping = {name: gain / 100.0 for name, gain in gains.items()}
    drive = JointDrivePropertiesCfg(drive_type="force", stiffness=gains, damping=damping)
    return RobotCfg(uid="arm", fpath=str(path), drive_pros=drive, init_pos=(0, 0, 2))


def torque(joints=None, **kwargs):
    entity = JointsCfg(uid="arm", joint_names=joints, **kwargs)
    return JointTorqueSensorCfg(uid="torque", of=entity)


def test_a_static_arm_carries_the_moment_of_its_weight(scene, tmp_path):
    sim = scene([], [torque(["shoulder", "elbow"])], robots=[arm(tmp_path)])
    sim.update(step=500)
    sensor = sim.get_sensor("torque")
    assert sensor.names == ("shoulder", "elbow")
    np.testing.assert_allclose(sensor.read_torque(), [[SHOULDER, ELBOW]] * 3, atol=0.02)
    np.testing.assert_allclose(sensor.read_actuator(), [[SHOULDER, ELBOW]] * 3, atol=0.02)
    np.testing.assert_allclose(sensor.read_passive(), 0.0, atol=1e-3)
    data = sensor.get_data()
    assert tuple(data) == ("torque", "actuator", "passive", "constraint")
    assert data["torque"].shape == (3, 2)


def test_a_spring_is_passive_and_a_limit_is_a_constraint(scene, tmp_path):
    # The spring pulls the elbow, held at 0, towards 0.1 rad with 2 N m; the lift rests on its stop.
    spring = 'stiffness="20" springref="0.1"'
    robot = arm(tmp_path, spring)
    sim = scene([], [torque(["lift", "elbow"], preserve_order=True)], robots=[robot])
    sim.update(step=500)
    sensor = sim.get_sensor("torque")
    assert sensor.names == ("lift", "elbow")
    np.testing.assert_allclose(sensor.read_passive()[:, 1], 2.0, atol=0.01)
    np.testing.assert_allclose(sensor.read_torque()[:, 1], ELBOW, atol=0.02)
    np.testing.assert_allclose(sensor.read_actuator()[:, 1], ELBOW - 2.0, atol=0.02)
    np.testing.assert_allclose(sensor.read_constraint()[:, 0], 3 * G, rtol=1e-3)
    np.testing.assert_allclose(sensor.read_torque()[:, 0], 3 * G, rtol=1e-3)


def test_all_active_joints_without_names(scene, tmp_path):
    sim = scene([], [torque()], robots=[arm(tmp_path)])
    assert sim.get_sensor("torque").names == ("shoulder", "elbow", "lift")


def test_a_torque_is_of_the_last_physics_step(scene, tmp_path):
    sim = scene([], [torque(["shoulder"])], robots=[arm(tmp_path)])
    sim.update(step=500)
    before = sim.get_sensor("torque").read_torque()
    sim.get_robot("arm").set_qpos(np.full((3, 3), 0.5), target=False)
    np.testing.assert_array_equal(sim.get_sensor("torque").read_torque(), before)
    sim.update(step=1)
    assert (sim.get_sensor("torque").read_torque() != before).all()


@pytest.mark.parametrize(
    ("keys", "path", "match"),
    [
        ({"uid": "ar"}, "of.uid", "there are: arm, cube"),
        ({"uid": "arm", "joint_names": "x"}, "of.joint_names", "there are: shoulder"),
        ({"uid": "arm", "link_names": "upper"}, "of.link_names", "takes joint_names"),
        ({"uid": "cube"}, "of.uid", "is a rigid object without joints"),
    ],
)
def test_wrong_joints_are_refused_with_what_exists(scene, tmp_path, keys, path, match):
    cfg = JointTorqueSensorCfg(uid="torque", of=JointsCfg(**keys))
    with pytest.raises(ConfigError, match=match) as error:
        scene([cube("cube")], [cfg], robots=[arm(tmp_path)])
    assert [p.path for p in error.value.problems] == [f"torque.{path}"]

"""Poses and velocities of frames, in the world and in the frame of another link."""

import numpy as np
import pytest

from embodichain.lab.sim.cfg import RobotCfg
from embodichain.lab.sim.sensors import FramePoseSensorCfg, LinksCfg
from embodichain.utils.errors import ConfigError
from tests.lab.sim.sensors.conftest import cube

HALF = np.sqrt(0.5)
ARM = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="base">
      <geom size=".05" mass="1"/>
      <body name="upper">
        <joint name="shoulder" axis="0 0 1" range="-3 3"/>
        <geom type="box" size=".1 .01 .01" pos=".5 0 0" mass="2"/>
        <site name="tip" pos="1 0 0" euler="0 0 1.5707963267948966"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    return RobotCfg(uid="arm", fpath=str(path), init_pos=(0, 0, 2))


def frame(on="arm", uid="frame", link_names=None, **kwargs):
    return FramePoseSensorCfg(uid=uid, of=LinksCfg(uid=on, link_names=link_names), **kwargs)


def close(found, wanted):
    np.testing.assert_allclose(found, [wanted] * 3, atol=1e-6)


def test_a_frame_after_a_known_rotation(scene, arm):
    sensors = [
        frame(link_names="upper"),
        frame(uid="offset", link_names="upper", pos=(1, 0, 0), quat=(HALF, 0, 0, HALF)),
        frame(uid="site", site="tip"),
        frame(uid="root"),
    ]
    sim = scene([], sensors, robots=[arm], gravity=0.0)
    robot = sim.get_robot("arm")
    robot.set_qpos(np.full((3, 1), np.pi / 2), target=False)
    robot.set_qvel(np.full((3, 1), 3.0), target=False)
    link, offset, site, root = (sim.get_sensor(s.uid) for s in sensors)
    assert (link.names, site.names, root.names) == (("upper",), ("tip",), ("base",))
    close(link.read_position(), [0, 0, 2])
    close(link.read_orientation(), [HALF, 0, 0, HALF])
    close(link.read_angular_velocity(), [0, 0, 3])
    close(link.read_linear_velocity(), [0, 0, 0])
    for sensor in (offset, site):  # the same frame, declared twice
        close(sensor.read_position(), [0, 1, 2])
        close(sensor.read_orientation(), [0, 0, 0, 1])  # a quarter turn and another one
        close(sensor.read_linear_velocity(), [-3, 0, 0])  # w x r
        close(sensor.read_angular_velocity(), [0, 0, 3])
    close(root.read_position(), [0, 0, 2])
    data = site.get_data()
    assert {name: tuple(value.shape) for name, value in data.items()} == {
        "position": (3, 3),
        "orientation": (3, 4),
        "linear_velocity": (3, 3),
        "angular_velocity": (3, 3),
    }


def test_in_the_frame_of_a_link_its_own_motion_is_subtracted(scene, arm):
    on_arm = LinksCfg(uid="arm", link_names="upper")
    sensors = [
        frame("box", relative_to=on_arm),
        frame("arm", "tip", link_names="upper", pos=(1, 0, 0), relative_to=LinksCfg(uid="box")),
        frame("arm", "still", link_names="upper", pos=(1, 0, 0), relative_to=on_arm),
    ]
    sim = scene([cube("box", pos=(0, 1, 2))], sensors, robots=[arm], gravity=0.0)
    robot, box = sim.get_robot("arm"), sim.get_rigid_object("box")
    robot.set_qpos(np.full((3, 1), np.pi / 2), target=False)
    robot.set_qvel(np.full((3, 1), 3.0), target=False)
    box.set_velocity(np.tile([0.5, 0, 0], (3, 1)), np.zeros((3, 3)))
    seen, tip, still = (sim.get_sensor(s.uid) for s in sensors)
    # The arm's x axis is the world's y, its y axis the world's -x.
    close(seen.read_position(), [1, 0, 0])
    close(seen.read_orientation(), [HALF, 0, 0, -HALF])
    # The arm's frame moves with -3 m/s along the world's x there: 3.5 m/s, along its -y.
    close(seen.read_linear_velocity(), [0, -3.5, 0])
    close(seen.read_angular_velocity(), [0, 0, -3])
    close(tip.read_position(), [0, 0, 0])
    close(tip.read_linear_velocity(), [-3.5, 0, 0])
    close(still.read_position(), [1, 0, 0])
    close(still.read_linear_velocity(), [0, 0, 0])
    close(still.read_angular_velocity(), [0, 0, 0])


def test_a_static_and_a_kinematic_object_have_frames(scene):
    objects = [
        cube("static", pos=(1, 2, 3), body_type="static"),
        cube("kinematic", pos=(4, 5, 6), body_type="kinematic"),
    ]
    sim = scene(objects, [frame("static", "a"), frame("kinematic", "b")])
    close(sim.get_sensor("a").read_position(), [1, 2, 3])
    close(sim.get_sensor("b").read_position(), [4, 5, 6])
    pose = sim.get_rigid_object("kinematic").get_local_pose()
    pose[1, 0] = 9.0
    sim.get_rigid_object("kinematic").set_local_pose(pose)
    assert sim.get_sensor("b").read_position()[:, 0].tolist() == [4.0, 9.0, 4.0]


@pytest.mark.parametrize(
    ("cfg", "path", "match"),
    [
        (frame(site="top"), "site", "no site is called 'top'; there are: tip"),
        (frame("box", site="tip"), "site", "no site is called 'tip'; there are: none"),
        (frame(site="tip", link_names="upper"), "site", "not both"),
        (frame(site="tip", pos=(1, 0, 0)), "site", "has its own pose"),
        (frame(link_names=".*"), "of.link_names", "one link is wanted"),
        (frame(pos=(1, 0)), "pos", "expected 3 values"),
        (frame(relative_to=LinksCfg(uid="am")), "relative_to.uid", "Did you mean|there are"),
        (
            frame(relative_to=LinksCfg(uid="arm", link_names=".*")),
            "relative_to.link_names",
            "one link is wanted",
        ),
    ],
)
def test_a_wrong_frame_is_refused_with_what_exists(scene, arm, cfg, path, match):
    with pytest.raises(ConfigError, match=match) as error:
        scene([cube("box")], [cfg], robots=[arm])
    assert [p.path for p in error.value.problems] == [f"frame.{path}"]

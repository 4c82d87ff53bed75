"""Inertial measurement units against physics that can be worked out by hand."""

import numpy as np
import pytest

from embodichain.lab.sim.cfg import RobotCfg
from embodichain.lab.sim.sensors import ImuSensorCfg, LinksCfg
from embodichain.utils.errors import ConfigError
from tests.lab.sim.sensors.conftest import cube

G = 9.81
HALF = np.sqrt(0.5)
ABOUT_X = (
    HALF,
    HALF,
    0.0,
    0.0,
)  # a quarter turn: its z axis is the world's -y, its y the world's z


def imu(uid="imu", on="cube", **kwargs):
    links = {"link_names": kwargs.pop("link_names")} if "link_names" in kwargs else {}
    return ImuSensorCfg(uid=uid, of=LinksCfg(uid=on, **links), **kwargs)


def test_at_rest_it_reads_gravity_upwards(scene):
    sim = scene([cube("cube")], [imu()])
    sim.update(step=150)
    sensor = sim.get_sensor("imu")
    np.testing.assert_allclose(sensor.read_acceleration(), [[0, 0, G]] * 3, atol=1e-3)
    np.testing.assert_allclose(sensor.read_angular_velocity(), 0.0, atol=1e-6)
    np.testing.assert_allclose(sensor.read_projected_gravity(), [[0, 0, -1]] * 3, atol=1e-6)
    assert sensor.read_acceleration().dtype == np.float64


def test_in_free_fall_it_reads_nothing(scene):
    sim = scene([cube("cube", pos=(0, 0, 50))], [imu(pos=(0.03, -0.01, 0.02))])
    sim.update(step=20)
    np.testing.assert_allclose(sim.get_sensor("imu").read_acceleration(), 0.0, atol=1e-9)


@pytest.mark.parametrize("body_type", ["kinematic", "static"])
def test_its_axes_are_those_of_the_link_turned_by_the_config(scene, body_type):
    lying = cube("cube", pos=(0, 0, 2), body_type=body_type, init_quat=ABOUT_X)
    sim = scene([lying], [imu("plain"), imu("turned", quat=(HALF, -HALF, 0.0, 0.0))])
    sim.update(step=2)
    plain, turned = sim.get_sensor("plain"), sim.get_sensor("turned")
    np.testing.assert_allclose(plain.read_orientation(), [ABOUT_X] * 3, atol=1e-12)
    np.testing.assert_allclose(plain.read_acceleration(), [[0, G, 0]] * 3, atol=1e-9)
    np.testing.assert_allclose(plain.read_projected_gravity(), [[0, -1, 0]] * 3, atol=1e-12)
    # turned back by the config: its axes are the world's
    np.testing.assert_allclose(turned.read_orientation(), [[1, 0, 0, 0]] * 3, atol=1e-12)
    np.testing.assert_allclose(turned.read_acceleration(), [[0, 0, G]] * 3, atol=1e-9)


def test_a_gyroscope_reads_the_angular_velocity_that_was_set(scene):
    sim = scene([cube("cube", pos=(0, 0, 2), init_quat=ABOUT_X)], [imu()], gravity=0.0)
    world = np.array([[0.0, 0.0, 2.0], [0.0, 3.0, 0.0], [1.0, 0.0, 0.0]])
    sim.get_rigid_object("cube").set_velocity(np.zeros((3, 3)), world)
    # world z is the cube's y, world y its -z, world x its x; before a step and after
    wanted = [[0, 2, 0], [0, 0, -3], [1, 0, 0]]
    sensor = sim.get_sensor("imu")
    np.testing.assert_allclose(sensor.read_angular_velocity(), wanted, atol=1e-6)
    sim.update(step=5)
    np.testing.assert_allclose(sensor.read_angular_velocity(), wanted, atol=1e-6)


def test_a_unit_off_the_axis_reads_the_centripetal_acceleration(scene):
    sensors = [imu("middle"), imu("rim", pos=(0.04, 0.0, 0.0))]
    sim = scene([cube("cube", pos=(0, 0, 2))], sensors, gravity=0.0)
    sim.get_rigid_object("cube").set_velocity(np.zeros((3, 3)), np.tile([0.0, 0.0, 5.0], (3, 1)))
    sim.update(step=1)
    np.testing.assert_allclose(sim.get_sensor("middle").read_acceleration(), 0.0, atol=1e-6)
    # towards the axis: w^2 r = 25 x 0.04
    wanted = [[-1.0, 0.0, 0.0]] * 3
    np.testing.assert_allclose(sim.get_sensor("rim").read_acceleration(), wanted, atol=1e-6)


def test_the_state_is_fresh_after_a_write_and_the_force_of_the_last_step(scene):
    sim = scene([cube("cube")], [imu()])
    sim.update(step=150)
    sensor, box = sim.get_sensor("imu"), sim.get_rigid_object("cube")
    before = sensor.read_acceleration()
    pose = box.get_local_pose()
    pose[1, 3:] = pose.new_tensor(ABOUT_X)
    box.set_local_pose(pose)
    np.testing.assert_allclose(sensor.read_orientation()[1], ABOUT_X, atol=1e-6)
    np.testing.assert_array_equal(sensor.read_acceleration(), before)


def test_what_is_read_is_not_changed_by_what_comes(scene):
    sim = scene([cube("cube", pos=(0, 0, 2))], [imu()])
    sensor = sim.get_sensor("imu")
    readings = [
        sensor.read_acceleration(),
        sensor.read_angular_velocity(),
        sensor.read_orientation(),
        sensor.read_projected_gravity(),
    ]
    kept = [reading.copy() for reading in readings]
    sim.get_rigid_object("cube").set_velocity(np.zeros((3, 3)), np.ones((3, 3)))
    sim.update(step=200)
    sensor.get_data()
    for reading, copy in zip(readings, kept, strict=True):
        np.testing.assert_array_equal(reading, copy)


def test_without_a_link_it_sits_on_the_root_and_one_link_is_wanted(scene):
    robot = RobotCfg(uid="ur10", fpath="UniversalRobots/UR10/UR10.urdf", init_pos=(0, 0, 1))
    sim = scene([], [imu(on="ur10"), imu("tool", on="ur10", link_names="ee_link")], robots=[robot])
    assert sim.get_sensor("imu").names == ("base_link",)
    np.testing.assert_allclose(
        sim.get_sensor("tool").read_orientation(),
        robot_link_quat(sim, "ee_link"),
        atol=1e-6,
    )
    with pytest.raises(ConfigError, match="one link is wanted, these match: wrist_1") as error:
        scene([], [imu(on="ur10", link_names="wrist.*")], robots=[robot])
    assert error.value.problems[0].path == "imu.of.link_names"


def robot_link_quat(sim, link):
    return sim.get_robot("ur10").get_link_pose(link)[:, 3:].numpy()


@pytest.mark.parametrize(
    ("kwargs", "path"),
    [
        ({"quat": (0.0, 0.0, 0.0, 0.0)}, "imu.quat"),
        ({"quat": (1.0, 0.0, 0.0)}, "imu.quat"),
        ({"pos": (np.nan, 0.0, 0.0)}, "imu.pos"),
    ],
)
def test_a_wrong_mount_is_refused(scene, kwargs, path):
    with pytest.raises(ConfigError) as error:
        scene([cube("cube")], [imu(**kwargs)])
    assert [p.path for p in error.value.problems] == [path]

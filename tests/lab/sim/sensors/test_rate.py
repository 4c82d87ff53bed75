"""Sensors with a rate: when they measure, what they return between, resets, restored states."""

import numpy as np
import pytest

from embodichain.lab.sim.sensors import ContactSensorCfg, ImuSensorCfg, LinksCfg
from embodichain.utils.errors import ConfigError
from tests.lab.sim.sensors.conftest import cube

DT = 0.01


def spinning(scene, rate, **kwargs):
    """A simulation of weightless cubes that turn about z at 1 rad/s, each with an IMU."""
    imu = ImuSensorCfg(uid="imu", of=LinksCfg(uid="cube"), rate=rate)
    sim = scene([cube("cube", pos=(0, 0, 2))], [imu], gravity=0.0, physics_dt=DT, **kwargs)
    spin(sim)
    return sim


def spin(sim):
    count = sim.num_envs
    velocity = np.tile([0.0, 0.0, 1.0], (count, 1))
    sim.get_rigid_object("cube").set_velocity(np.zeros((count, 3)), velocity)


def angles(sim):
    """(N,) rad: what the IMU has turned."""
    quat = sim.get_sensor("imu").read_orientation()
    return 2.0 * np.arctan2(quat[:, 3], quat[:, 0])


def steps_seen(sim, count, each=1):
    """The physics step of every reading after 1, 2, ... calls, of environment 0."""
    found = []
    for _ in range(count):
        sim.update(step=each)
        found.append(round(float(angles(sim)[0]) / DT))
    return found


def test_without_a_rate_every_read_measures(scene):
    assert steps_seen(spinning(scene, None), 5) == [1, 2, 3, 4, 5]


def test_readings_are_kept_until_the_next_period_of_simulated_time(scene):
    sim = spinning(scene, 25.0)  # 0.04 s: every fourth step of 0.01 s
    assert angles(sim)[0] == 0.0
    assert steps_seen(sim, 10) == [0, 0, 0, 4, 4, 4, 4, 8, 8, 8]


def test_a_period_that_is_no_multiple_of_the_step_keeps_the_rate_on_average(scene):
    sim = spinning(scene, 40.0)  # 0, 0.025, 0.05, 0.075 s...: the first step at or after each
    angles(sim)
    assert steps_seen(sim, 10) == [0, 0, 3, 3, 5, 5, 5, 8, 8, 10]


def test_a_rate_above_that_of_the_steps_measures_at_every_step(scene):
    sim = spinning(scene, 1000.0)
    assert steps_seen(sim, 4) == [1, 2, 3, 4]


def test_a_period_in_which_nothing_is_read_costs_no_measurement_later(scene):
    sim = spinning(scene, 25.0)
    angles(sim)
    sim.update(step=7)  # the reading of step 4 was not asked for
    assert round(float(angles(sim)[0]) / DT) == 7
    assert steps_seen(sim, 2) == [8, 8]


def test_a_reset_measures_anew_in_the_environments_it_resets(scene):
    sim = spinning(scene, 25.0)
    angles(sim)
    sim.update(step=2)
    sim.reset_objects_state([1])
    turned = sim.get_rigid_object("cube").get_local_pose()[[1]]
    turned[:, 3:] = turned.new_tensor([0.0, 0.0, 0.0, 1.0])  # as an event of a reset would
    sim.get_rigid_object("cube").set_local_pose(turned, [1])
    np.testing.assert_allclose(angles(sim), [0.0, np.pi, 0.0], atol=1e-6)
    sim.update(step=2)  # environment 1 is now 0.02 s old, the others 0.04 s
    np.testing.assert_allclose(angles(sim), [0.04, np.pi, 0.04], atol=1e-6)


def test_a_write_at_the_time_of_a_measurement_is_included(scene):
    sim = spinning(scene, 25.0)
    angles(sim)
    sim.update(step=4)
    angles(sim)
    pose = sim.get_rigid_object("cube").get_local_pose()
    pose[:, 3:] = pose.new_tensor([1.0, 0.0, 0.0, 0.0])
    sim.get_rigid_object("cube").set_local_pose(pose)
    np.testing.assert_allclose(angles(sim), 0.0, atol=1e-12)


def test_a_restored_simulation_returns_the_kept_readings(scene):
    sim = spinning(scene, 25.0)
    angles(sim)
    sim.update(step=2)
    saved = sim.state_dict()
    first = steps_seen(sim, 8)
    sim.load_state_dict(saved)
    assert angles(sim)[0] == 0.0  # of step 0, although step 2 was restored
    assert steps_seen(sim, 8) == first


def test_forces_of_the_last_step_have_a_rate_too(scene):
    touch = ContactSensorCfg(uid="touch", of=LinksCfg(uid="cube"), rate=20.0)
    sim = scene([cube("cube", pos=(0, 0, 0.0505))], [touch], physics_dt=DT)
    sensor = sim.get_sensor("touch")
    assert not sensor.read_found().any()
    sim.update(step=4)
    assert not sensor.read_found().any()  # it has landed since, before the next measurement
    sim.update(step=1)
    assert sensor.read_found().all()


@pytest.mark.parametrize("rate", [0.0, -1.0, float("inf"), float("nan")])
def test_a_rate_is_positive_and_finite(scene, rate):
    with pytest.raises(ConfigError, match="must be positive and finite, Hz") as error:
        spinning(scene, rate)
    assert [p.path for p in error.value.problems] == ["imu.rate"]

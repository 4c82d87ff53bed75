"""Sensors of single physics steps, of all engines, against physics steps taken one by one."""

import mujoco
import numpy as np
import pytest
import torch

from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine
from embodichain.lab.sim.engine.device.device_array import EnvMask
from embodichain.lab.sim.engine.warp.device_engine import DeviceEngine
from embodichain.lab.sim.engine.warp.warp_engine import WarpEngine
from tests.helpers.warp_scene import DEVICE, SCENE, N, close, scatter

ENGINES = {
    "mujoco": lambda model: CpuEngine(model, N, 1),
    "one data an environment": lambda model: CpuEngine(model, N, 1, persistent=True),
    "warp": lambda model: WarpEngine(model, N, 1, DEVICE),
    "device": lambda model: DeviceEngine(model, N, 1, DEVICE),
}
TOUCH = slice(6, 10)
"""Count, and force in N, of contacts of ball and floor."""


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(SCENE)


def made(model, name, count=1):
    """Engines in the same scattered state; the first request of a field computes it."""
    engines = [ENGINES[name](model) for _ in range(count)]
    scatter(CpuEngine(model, N, 1), *engines)
    for engine in engines:
        engine.acceleration("sensordata")
    return engines


def host(array):
    return np.array(array.host() if hasattr(array, "host") else array)


def where(engine, *ids):
    if not isinstance(engine, DeviceEngine):
        return np.array(ids)
    flags = torch.zeros(N, dtype=torch.bool, device=DEVICE)
    flags[list(ids)] = True
    return EnvMask(flags)


@pytest.mark.parametrize("name", ENGINES)
def test_every_physics_step_is_kept(model, name):
    """Of steps of 5, 2 and 4 the last 7; the others are of engines that take one at a time."""
    engine, single = made(model, name, 2)
    engine.keep_sensors(TOUCH, 7)
    engine.keep_sensors(TOUCH, 2)
    wanted = []
    for count in (5, 2, 4):
        engine.step(count)
        for _ in range(count):
            single.step(1)
            wanted.append(host(single.acceleration("sensordata"))[:, TOUCH])
        if len(wanted) >= 7:
            found = host(engine.kept_sensors(TOUCH, 7))
            loose = 0.0 if DEVICE == "cpu" else 1e-4
            close(found, np.stack(wanted[-7:], axis=1), loose)
            assert (host(engine.kept_sensors(TOUCH, 2)) == found[:, -2:]).all()
    assert len({row.tobytes() for row in found[0]}) > 1
    assert (found[:, -1] == host(engine.acceleration("sensordata"))[:, TOUCH]).all()
    close(host(engine.state("qpos")), host(single.state("qpos")), loose)


@pytest.mark.parametrize("name", ENGINES)
def test_after_a_forward_all_steps_are_the_present_state(model, name):
    (engine,) = made(model, name)
    engine.keep_sensors(TOUCH, 3)
    engine.step(3)
    before = host(engine.kept_sensors(TOUCH, 3))
    ids = where(engine, 1, 3)
    engine.write("qpos", 0.097, ids, slice(4, 5))
    engine.forward(ids)
    found, now = host(engine.kept_sensors(TOUCH, 3)), host(engine.acceleration("sensordata"))
    assert (found[[0, 2]] == before[[0, 2]]).all()
    assert (found[[1, 3]] == now[[1, 3], None, TOUCH]).all()
    engine.step(1)  # of those, the one step stands for those before it
    found = host(engine.kept_sensors(TOUCH, 3))
    assert (found[[0, 2], :2] == before[[0, 2], 1:]).all()
    assert (found[[1, 3]] == found[[1, 3], -1:]).all()


@pytest.mark.parametrize("name", ENGINES)
def test_what_is_kept_is_saved(model, name):
    engine, other = made(model, name, 2)
    for each in (engine, other):
        each.keep_sensors(TOUCH, 3)
    engine.step(3)
    other.load_state_dict(engine.state_dict())
    assert (host(other.kept_sensors(TOUCH, 3)) == host(engine.kept_sensors(TOUCH, 3))).all()
    without = other.state_dict()
    del without["sensor_history"]  # as of earlier versions
    other.load_state_dict(without)
    now = host(other.acceleration("sensordata"))[:, None, TOUCH]
    assert (host(other.kept_sensors(TOUCH, 3)) == now).all()


@pytest.mark.parametrize("name", ["mujoco", "one data an environment"])
def test_recorded_steps_are_as_others_to_the_bit_where_one_diverges(model, name):
    """MuJoCo's rollout stops an environment at a warning; the steps after it are taken too."""
    engine, plain = made(model, name, 2)
    engine.keep_sensors(TOUCH, 4)
    for each in (engine, plain):
        each.step(4)
        each.write("qpos", 3e10, np.array([1]), slice(4, 5))
        each.step(4)
    assert (engine.rows == plain.rows).all()
    assert (engine.acceleration("sensordata") == plain.acceleration("sensordata")).all()
    assert engine.take_diverged().tolist() == plain.take_diverged().tolist()
    assert engine.kept_sensors(TOUCH, 4).shape == (N, 4, 4)


def test_some_environments_step(model):
    """As of events that wait until objects have settled."""
    engine, plain = made(model, "mujoco", 2)
    engine.keep_sensors(TOUCH, 2)
    for each in (engine, plain):
        each.step(2)
        each.step(3, np.array([0, 2]))
    assert (engine.rows == plain.rows).all()
    now = plain.acceleration("sensordata")[:, TOUCH]
    assert (engine.kept_sensors(TOUCH, 2)[:, -1] == now).all()

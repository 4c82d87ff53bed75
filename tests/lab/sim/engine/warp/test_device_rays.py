"""Rays of `DeviceEngine` against those of `CpuEngine`, for the model of `test_warp_engine`."""

import mujoco
import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine
from embodichain.lab.sim.engine.device.device_array import DeviceArray, EnvMask
from embodichain.lab.sim.engine.warp.device_engine import DeviceEngine
from tests.lab.sim.engine.warp.test_warp_engine import DEVICE, SCENE, N

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

DOWN = np.array([[0.0, 0.0, -1.0]])
ABOVE_BALL = np.array([[0.0, 0.8, 2.0]])


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(SCENE)


@pytest.fixture
def engines(model):
    return CpuEngine(model, N, 1), DeviceEngine(model, N, 1, DEVICE)


def put(numbers):
    return DeviceArray(torch.from_numpy(np.float32(numbers)).to(DEVICE))


def masked(*ids):
    mask = torch.zeros(N, dtype=torch.bool, device=DEVICE)
    mask[list(ids)] = True
    return EnvMask(mask)


def test_distances_geoms_and_normals(engines, model):
    cpu, device = engines
    draw = np.random.default_rng(0)
    origins = draw.uniform([-1, -1, 1.5], [1, 1, 2.5], (N, 200, 3))
    ways = draw.uniform([-0.4, -0.4, -2], [0.4, 0.4, -1], (N, 200, 3))
    every = np.ones(model.ngeom, np.bool_)
    wanted = cpu.cast_rays(origins, ways, every, normal=True)
    found = device.cast_rays(put(origins), put(ways), every, normal=True)
    assert len(set(wanted.geom.ravel().tolist())) > 2, "the rays hit too little"
    same = found.geom.host() == wanted.geom  # at an edge, rounding decides what is hit
    assert same.mean() > 0.99
    assert_allclose(found.distance.host()[same], wanted.distance[same], atol=1e-4)
    assert_allclose(found.normal.host()[same], wanted.normal[same], atol=1e-3)


def test_rays_broadcast_and_normals_are_given_if_wanted(engines, model):
    floor = np.arange(model.ngeom) == model.geom("floor").id
    found = engines[1].cast_rays(put(ABOVE_BALL), put(2.0 * DOWN), floor)
    assert found.normal is None
    assert_allclose(found.distance.host(), [[1.0]] * N, atol=1e-6)  # in lengths of the direction
    nothing = engines[1].cast_rays(put(ABOVE_BALL), put(-DOWN), floor)
    assert_array_equal(nothing.distance.host(), [[-1.0]] * N)
    assert_array_equal(nothing.geom.host(), [[-1]] * N)


def test_rays_see_the_present_state_of_each_environment(engines, model):
    device = engines[1]
    ball = np.arange(model.ngeom) == model.geom("ball").id
    before = device.cast_rays(put(ABOVE_BALL), put(DOWN), ball).distance.host()[:, 0]
    assert_allclose(before, 2.0 - 0.098 - 0.1, atol=1e-5)
    height = slice(4, 5)  # of the ball, behind two joints, x and y
    device.write("qpos", put([[0.5]] * N), masked(1, 2), height)
    after = device.cast_rays(put(ABOVE_BALL), put(DOWN), ball).distance.host()[:, 0]
    assert_allclose(after, [before[0], 1.4, 1.4, before[3]], atol=1e-5)

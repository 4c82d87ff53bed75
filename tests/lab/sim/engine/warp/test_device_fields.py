"""Model fields of `DeviceEngine` against those of `WarpEngine`, for the model of its tests."""

import mujoco
import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from embodichain.lab.sim.engine.device.device_array import DeviceArray, EnvMask
from embodichain.lab.sim.engine.warp.device_engine import DeviceEngine
from embodichain.utils.errors import ConfigError
from tests.lab.sim.engine.warp.test_warp_engine import DEVICE, SCENE, N, warp_engine

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

CHOSEN = np.array([1, 3])


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(SCENE)


@pytest.fixture
def engine(model):
    return DeviceEngine(model, N, 1, DEVICE)


def chosen():
    mask = torch.zeros(N, dtype=torch.bool, device=DEVICE)
    mask[CHOSEN] = True
    return EnvMask(mask)


def everywhere(numbers):
    """(N, k) numbers on the device."""
    rows = np.broadcast_to(np.float32(numbers), (N, len(numbers)))
    return DeviceArray(torch.from_numpy(rows.copy()).to(DEVICE))


def test_values_are_written_where_a_mask_is_set(engine, model) -> None:
    columns = slice(3, 4)  # the mass of the ball, body 3
    engine.write_model("body_mass", everywhere([0.7]), chosen(), columns)
    assert_allclose(engine.model_field("body_mass").host()[:, 3], [0.5, 0.7, 0.5, 0.7])
    assert engine.model_values("body_mass").shape == (N, model.nbody)
    assert engine.model_values("body_inertia").shape == (1, model.nbody, 3)  # never written


def test_the_host_gets_copies(engine, model) -> None:
    engine.write_model("body_mass", everywhere([0.7]), chosen(), slice(3, 4))
    engine.set_const_later(chosen())
    assert_allclose(engine.model_of(1).body_mass[3], 0.7)
    assert_allclose(engine.model_of(1).body_subtreemass[3], 0.7)  # a constant: it follows
    assert engine.model_of(0).body_mass[3] == model.body_mass[3]
    assert_allclose(engine.model_fields()["body_mass"][:, 3], [0.5, 0.7, 0.5, 0.7])


def test_a_state_continues(engine, model) -> None:
    engine.write_model("body_mass", everywhere([0.7]), chosen(), slice(3, 4))
    engine.write_model("actuator_forcerange", everywhere([-3.0]), chosen(), slice(0, 1))
    engine.set_const_later(chosen())
    engine.step(3)
    state = engine.state_dict()
    other = DeviceEngine(model, N, 1, DEVICE)
    other.load_state_dict(state)
    for now in (engine, other):
        now.step(5)
    assert_allclose(other.host_rows(), engine.host_rows(), rtol=0, atol=1e-7)


def test_new_arrays_of_warp_change_the_revision(engine) -> None:
    first = engine.revision
    engine.write_model("body_mass", everywhere([0.7]), chosen(), slice(3, 4))
    second = engine.revision
    engine.write_model("body_mass", everywhere([0.8]), chosen(), slice(3, 4))
    assert first < second == engine.revision
    engine.set_const()
    assert engine.revision > second


def test_constants_are_computed_before_they_are_written(engine) -> None:
    """Else computing them later would undo the write."""
    engine.write_model("body_mass", everywhere([0.7]), chosen(), slice(3, 4))
    engine.set_const_later(chosen())
    engine.write_model("dof_invweight0", everywhere([5.0]), chosen(), slice(0, 1))
    engine.step(1)
    found = engine.model_field("dof_invweight0").host()
    assert_allclose(found[CHOSEN, 0], 5.0)
    assert found[0, 0] != 5.0


def test_fixed_geoms_are_where_they_are_put(model, engine) -> None:
    host = warp_engine(model)
    turned = [np.cos(0.3), 0.0, np.sin(0.3), 0.0]
    for name, width, numbers in (("pos", 3, [1.0, 2.0, 3.0]), ("quat", 4, turned)):
        columns = slice(width, 2 * width)  # of the post, geom 1
        engine.write_model(f"geom_{name}", everywhere(numbers), chosen(), columns)
        host.write_model(f"geom_{name}", np.tile(numbers, (2, 1)), CHOSEN, columns)
    host.set_const(CHOSEN)  # else MuJoCo takes the orientation of the body
    for name in ("geom_xpos", "geom_xmat"):
        assert_allclose(engine.derived(name).host(), host.derived(name), atol=1e-6)


def test_actuators_without_a_limit_pull_as_far_as_they_can(model, engine) -> None:
    """Warp's flags of limited actuators are shared: elsewhere the range is wide."""
    host = warp_engine(model)
    for now, values, where in (
        (engine, everywhere([1.0]), chosen()),
        (host, np.ones((2, 1)), CHOSEN),
    ):
        now.write_model("actuator_forcelimited", values, where, slice(1, 2))
        now.write_model("actuator_forcerange", -0.5 * values, where, slice(2, 3))
        now.write_model("actuator_forcerange", 0.5 * values, where, slice(3, 4))
        now.write("ctrl", 2.0)
    forces = engine.acceleration("actuator_force").host()
    assert_allclose(forces, host.acceleration("actuator_force"), rtol=1e-5)
    assert_allclose(forces[CHOSEN, 1], 0.5)
    assert (np.abs(forces[[0, 2], 1]) > 10).all()


def test_the_medium_may_differ(model, engine) -> None:
    host = warp_engine(model)
    for now, values in ((engine, everywhere([500.0])), (host, np.full((N, 1), 500.0))):
        now.write_model("opt.density", values)
        now.write("qvel", 1.0)
        now.step(2)
    assert_allclose(engine.host_rows(), host.rows, rtol=1e-5, atol=1e-5)


def test_a_field_that_all_worlds_share_is_refused(engine) -> None:
    with pytest.raises(ConfigError, match="'geom_contype' cannot differ"):
        engine.write_model("geom_contype", everywhere([0.0]), chosen(), slice(0, 1))
    with pytest.raises(ValueError, match="body_mass"):
        engine.model_field("body_mas")

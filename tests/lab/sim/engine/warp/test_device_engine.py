"""`DeviceEngine` against `WarpEngine`: the same physics, with arrays on the device."""

import mujoco
import numpy as np
import pytest
import torch

from embodichain.lab.sim.engine.device.device_array import DeviceArray, EnvMask, HostTransferError
from embodichain.lab.sim.engine.warp.device_engine import DeviceEngine
from embodichain.lab.sim.engine.warp.warp_engine import WarpEngine
from embodichain.utils.errors import ConfigError
from tests.helpers.warp_scene import DEVICE, SCENE, N, close, scatter

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]
IDS = np.array([0, 2])
OUTPUTS = ("qacc", "qfrc_actuator", "sensordata")


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(SCENE)


@pytest.fixture
def both(model):
    found = WarpEngine(model, N, 1, DEVICE), DeviceEngine(model, N, 1, DEVICE)
    scatter(*found)
    return found


def mask(*ids):
    flags = torch.zeros(N, dtype=torch.bool, device=DEVICE)
    flags[list(ids)] = True
    return EnvMask(flags)


def same_states(host, device):
    """Rows to the bit of float32, and the time to that of float64."""
    rows = host.rows.astype(np.float32).astype(np.float64)
    rows[:, host.component("time")] = host.state("time")
    np.testing.assert_array_equal(device.host_rows(), rows)


def test_states_and_fields_are_on_the_device(both):
    same_states(*both)
    for name in ("qpos", "qvel", "ctrl", "mocap_pos", "time"):
        found = both[1].state(name)
        assert type(found) is DeviceArray and found.shape == both[0].state(name).shape
    assert both[1].state("act").shape == (N, 0)
    for name in ("xpos", "geom_xpos", "xmat", "cvel", "subtree_com"):
        assert both[1].derived(name).shape == both[0].derived(name).shape
        close(both[1].derived(name).host(), both[0].derived(name), 1e-6)
    with pytest.raises(HostTransferError, match="state rows of the host do not exist"):
        both[1].rows  # noqa: B018
    with pytest.raises(ValueError, match="efc_force"):
        both[1].derived("efc_force")


def test_derived_fields_follow_writes(both):
    poses = both[1].derived("xpos")
    before = poses.host()
    for engine, where in ((both[0], np.array([1])), (both[1], mask(1))):
        engine.write("qpos", 0.9, where, slice(0, 1))
    assert both[1].derived("xpos") is poses
    moved = (poses.host() != before).reshape(N, -1).any(axis=1)
    assert moved.tolist() == [False, True, False, False]
    close(poses.host(), both[0].derived("xpos"), 1e-6)


WRITES = {
    "all": (None, slice(None), np.linspace(-1, 1, 2)),
    "rows": (IDS, slice(None), np.linspace(-1, 1, 2)),
    "a column": (IDS, slice(1, 2), 0.25),
    "columns by indices": (IDS, np.array([1, 0]), np.array([0.5, -0.5])),
    "columns of all": (None, np.array([1]), -0.75),
}


@pytest.mark.parametrize("how", WRITES)
def test_writes_by_mask_and_columns(both, how):
    ids, columns, values = WRITES[how]
    before = both[1].version
    both[0].write("ctrl", values, ids, columns)
    both[1].write("ctrl", values, None if ids is None else mask(*ids), columns)
    same_states(*both)
    assert both[1].version > before and (both[1].versions == both[1].version).all()


def test_rows_of_all_environments_where_a_mask_is_set(both):
    values = np.arange(2.0 * N).reshape(N, 2)
    both[0].write("ctrl", values[IDS], IDS)
    both[1].write("ctrl", both[1].state("ctrl").copy() * 0 + values, mask(*IDS))
    same_states(*both)


def test_whole_rows(both):
    row = both[0].rows[3].copy()
    row[0] = 1.25  # the time, in float64
    both[0].write("row", row, IDS)
    both[1].write("row", row, mask(*IDS))
    same_states(*both)
    both[0].write("row", 0.5, None, slice(1, 4))
    both[1].write("row", 0.5, None, slice(1, 4))
    same_states(*both)


def test_a_reset(both):
    for engine, where in ((both[0], IDS), (both[1], mask(*IDS))):
        engine.step(2)
        engine.reset(where)
    rows, begun = both[1].host_rows(), np.zeros(N, np.bool_)
    begun[IDS] = True
    np.testing.assert_array_equal(rows[begun], both[0].rows[begun].astype(np.float32))
    assert (rows[~begun, 0] == both[0].rows[~begun, 0]).all() and (rows[~begun, 0] > 0).all()
    for engine in both:
        engine.reset()
    same_states(*both)


def test_a_step(both):
    for engine in both:
        for name in OUTPUTS:
            engine.acceleration(name)
        engine.step(3)
    for name in ("qpos", "qvel"):
        close(both[1].state(name).host(), both[0].state(name), 1e-6)
    np.testing.assert_allclose(both[1].state("time").host(), both[0].state("time"), atol=1e-15)
    for name in OUTPUTS:
        close(both[1].acceleration(name).host(), both[0].acceleration(name), 1e-4)
    for name in ("xpos", "site_xpos", "sensordata"):
        close(both[1].derived(name).host(), both[0].derived(name), 1e-4)


def test_accelerations_are_those_of_the_last_step_or_forward(both):
    """`forward` after a reset changes them for environments that were reset only."""
    engine = both[1]
    engine.acceleration("qacc")
    engine.step(1)
    stepped = engine.acceleration("qacc").host()
    engine.reset(mask(*IDS))
    engine.derived("xpos")
    np.testing.assert_array_equal(engine.acceleration("qacc").host(), stepped)
    engine.forward(mask(IDS[0]))
    engine.forward(mask(IDS[1]))
    saved = engine.state_dict()["acceleration"]["qacc"]
    found = engine.acceleration("qacc")
    np.testing.assert_array_equal(saved, found.host())
    changed = (found.host() != stepped).any(axis=1)
    assert changed.tolist() == [True, False, True, False]
    both[0].acceleration("qacc")
    both[0].step(1)
    both[0].reset(IDS)
    both[0].forward(IDS)
    close(found.host(), both[0].acceleration("qacc"), 1e-4)


def test_environments_that_diverge(both):
    engine = both[1]
    engine.write("qvel", np.nan, mask(1), slice(0, 1))
    engine.write("qvel", 1e12, mask(2), slice(1, 2))
    engine.step(1)
    engine.check_memory()
    assert engine.take_diverged().host().tolist() == [False, True, True, False]
    assert np.isfinite(engine.host_rows()[[0, 3]]).all()
    engine.step(1)
    engine.reset(mask(1, 2))
    assert not engine.take_diverged().host().any()
    engine.step(1)
    assert not engine.take_diverged().host().any() and np.isfinite(engine.host_rows()).all()


@pytest.mark.parametrize("sizes", [{"nconmax": 64, "njmax": 1}, {"nconmax": 1, "njmax": 64}])
def test_too_little_memory_is_reported_by_the_next_steps(model, sizes):
    engine = DeviceEngine(model, N, 1, DEVICE, **sizes)
    # The ball touches the floor and the post, and the first joint is at its limit.
    engine.write("qpos", 2.1, None, slice(0, 1))
    engine.write("qpos", np.array([1.25, 0, 0.098]), None, slice(2, 5))
    engine.check_memory()
    engine.step(1)
    engine.check_memory()
    if DEVICE != "cpu":
        torch.cuda.synchronize()
    key = min(sizes, key=sizes.__getitem__)
    with pytest.raises(ConfigError, match=rf"sim\.warp\.{key}: 1 .* set sim\.warp\.{key}=2"):
        engine.check_memory()


def test_model_fields_differ_between_environments(both):
    for engine, where in ((both[0], IDS), (both[1], mask(*IDS))):
        engine.write_model("body_mass", 2.5, where, slice(2, 3))
        engine.write_model("opt.gravity", np.array([0, 0, -3.0]), where)
        engine.set_const_later(where)
        engine.step(2)
    for name in ("qpos", "qvel"):
        close(both[1].state(name).host(), both[0].state(name), 1e-6)
    fields = both[0].model_fields()
    assert {"body_mass", "opt.gravity", "body_subtreemass"} <= fields.keys()
    for name, values in both[1].model_fields().items():
        np.testing.assert_allclose(values, fields[name], rtol=1e-6)
    values = both[1].state("ctrl") * 0 + 1.5  # (N, 2) on the device
    both[1].write_model("dof_damping", values, mask(3), slice(0, 2))
    found = both[1].model_values("dof_damping")[:, 0].host()
    np.testing.assert_allclose(found, [0.2, 0.2, 0.2, 1.5])


@pytest.mark.parametrize("way", [(0, 1), (1, 0), (1, 1)], ids=["to it", "from it", "its own"])
def test_a_state_can_be_exchanged(model, both, way):
    source = both[way[0]]
    other = (WarpEngine if way[1] == 0 else DeviceEngine)(model, N, 1, DEVICE)
    source.write_model("body_mass", np.linspace(0.5, 2, N)[:, None], None, slice(2, 3))
    source.set_const_later()
    source.acceleration("qacc")
    source.step(3)
    if way[1] == 1:
        other.write("qvel", np.nan)
        other.step(1)
    other.load_state_dict(source.state_dict())
    rows = [engine.state_dict()["rows"] for engine in (source, other)]
    np.testing.assert_allclose(rows[1], rows[0], rtol=0, atol=1e-15)
    forces = [np.asarray(e.state_dict()["acceleration"]["qacc"]) for e in (source, other)]
    np.testing.assert_array_equal(*forces)
    for engine in (source, other):
        engine.step(3)
    rows = [engine.state_dict()["rows"] for engine in (source, other)]
    close(rows[1], rows[0], 1e-6)  # constants are computed in float32 here, in float64 there
    diverged = other.take_diverged()
    assert diverged is None or not diverged.host().any()


def test_a_simulation_on_the_host(both):
    both[1].step(2)
    data = both[1].data_of(2)
    np.testing.assert_array_equal(data.qpos, both[1].state("qpos").host()[2].astype(np.float64))
    close(both[1].derived("xpos").host()[2], data.xpos, 1e-5)


def test_what_is_refused(both):
    engine = both[1]
    with pytest.raises(
        HostTransferError, match="physics steps of some environments are not available"
    ):
        engine.step(1, mask(0))
    with pytest.raises(HostTransferError, match="array of the device was made one of the host"):
        np.asarray(engine.state("qpos"))
    engine.write_model("opt.timestep", np.linspace(0.002, 0.004, N)[:, None])
    with pytest.raises(HostTransferError, match="timesteps that differ between environments"):
        engine.step(1)

"""`WarpEngine` against `CpuEngine`, on Warp's CPU device or EMBODICHAIN_TEST_WARP_DEVICE.

All tests use one model, so that few kernels are compiled where Warp's cache is empty.
"""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine
from embodichain.lab.sim.engine.warp import warp_support
from embodichain.lab.sim.engine.warp.warp_engine import WarpEngine
from embodichain.lab.sim.engine.warp.warp_worlds import measured_sizes
from embodichain.utils.errors import ConfigError
from tests.helpers.warp_scene import DEVICE, SCENE, N, close, scatter

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]


def warp_engine(model, **sizes):
    return WarpEngine(model, N, 1, DEVICE, **sizes)


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(SCENE)


@pytest.fixture
def both(model):
    return CpuEngine(model, N, 1), warp_engine(model)


def compare_step(cpu, warp):
    for name in ("qacc", "qfrc_actuator", "sensordata"):
        cpu.acceleration(name)
        warp.acceleration(name)
    pairs = [(i, *sorted(pair)) for i in range(N) for pair in cpu.data_of(i).contact.geom.tolist()]
    np.testing.assert_array_equal(warp.worlds.contacts(), sorted(pairs))
    assert pairs, "the ball lies on the floor"
    for engine in (cpu, warp):
        engine.step(1)
    close(warp.state("qpos"), cpu.state("qpos"), 1e-6)
    close(warp.state("qvel"), cpu.state("qvel"), 1e-5)
    for name in ("qacc", "qfrc_actuator", "sensordata"):
        close(warp.acceleration(name), cpu.acceleration(name), 1e-4)
    for name in ("xpos", "xquat", "xmat", "geom_xpos", "site_xpos", "cvel", "subtree_com", "cdof"):
        close(warp.derived(name), cpu.derived(name), 1e-5)
    np.testing.assert_array_equal(warp.state("time"), cpu.state("time"))


def test_a_step_from_the_same_state(both):
    scatter(*both)
    compare_step(*both)
    close(both[1].derived("sensordata")[:, 3:6], both[0].derived("sensordata")[:, 3:6], 1e-5)


def test_fields_that_differ_between_environments(both):
    scatter(*both)
    rng = np.random.default_rng(3)
    draws = {
        "body_mass": rng.uniform(0.3, 3, (N, 5)),
        "geom_friction": rng.uniform(0.2, 1, (N, 18)),
        "dof_damping": rng.uniform(0, 2, (N, 8)),
        "opt.gravity": rng.uniform(-11, -8, (N, 3)),
        "actuator_forcelimited": np.array([[1, 1], [0, 0], [1, 0], [0, 1]]),
        "actuator_forcerange": np.tile([-0.5, 0.5, -0.2, 0.2], (N, 1)),
    }
    for engine in both:
        for field, values in draws.items():
            engine.write_model(field, values)
        engine.set_const_later()
    compare_step(*both)
    fields = both[0].model_fields()
    assert {"body_subtreemass", "dof_invweight0"} <= fields.keys()
    for field, values in both[1].model_fields().items():
        np.testing.assert_array_equal(values, fields[field])
    force = both[1].acceleration("qfrc_actuator")[:, :2]
    assert (np.abs(force[[0, 2], 0]) <= 0.5).all() and (np.abs(force[[1, 3], 0]) > 0.5).all()


def test_the_pose_of_a_fixed_geom_may_differ(both):
    origin, way = np.array([0.0, 0.0, 0.25]), np.array([2.0, 0.0, 0.0])
    places = np.tile(both[0].model.geom_pos.reshape(-1), (N, 1))
    places[:, 3] = [1.0, 1.5, 2.0, 3.0]  # x of the post
    post = np.arange(both[0].model.ngeom) == both[0].model.geom("post").id
    hits = []
    for engine in both:
        engine.write_model("geom_pos", places)
        hits.append(engine.cast_rays(origin, way, post, normal=True))
    np.testing.assert_allclose(hits[1].distance[:, 0], (places[:, 3] - 0.2) / 2, rtol=1e-5)
    for mine, reference in zip(hits[1], hits[0], strict=True):
        np.testing.assert_allclose(mine, reference, atol=1e-5)


def test_rays_of_some_environments(both):
    scatter(*both)
    rng = np.random.default_rng(1)
    origins, ways = rng.uniform(-1, 1, (2, 7, 3)), rng.normal(size=(2, 7, 3))
    origins[..., 2] += 1.5
    geoms = np.ones(both[0].model.ngeom, np.bool_)
    cpu, warp = (engine.cast_rays(origins, ways, geoms, np.array([1, 3])) for engine in both)
    np.testing.assert_array_equal(warp.geom, cpu.geom)
    np.testing.assert_allclose(warp.distance, cpu.distance, atol=1e-4)
    assert (cpu.geom >= 0).any() and (cpu.geom < 0).any() and warp.normal is None


def test_a_step_of_some_environments(model):
    engine = warp_engine(model)
    scatter(engine)
    engine.write("ctrl", 0.1)  # not representable in float32
    before, forces = engine.rows.copy(), engine.acceleration("qacc").copy()
    engine.step(2, np.array([0, 2]))
    changed = (engine.rows != before).any(axis=1)
    assert changed.tolist() == [True, False, True, False]
    assert (engine.state("ctrl") == 0.1).all()
    assert (engine.acceleration("qacc") != forces).any(axis=1).tolist() == changed.tolist()


def test_environments_that_diverge(model):
    engine = warp_engine(model)
    scatter(engine)
    engine.write("qvel", np.nan, np.array([1]), slice(0, 1))
    engine.write("qvel", 1e12, np.array([2]), slice(1, 2))
    engine.step(1)
    assert engine.take_diverged().tolist() == [False, True, True, False]
    assert np.isfinite(engine.rows[[0, 3]]).all()
    engine.step(1)
    engine.reset(np.array([1, 2]))
    assert engine.take_diverged() is None
    engine.step(1)
    assert engine.take_diverged() is None and np.isfinite(engine.rows).all()


@pytest.mark.parametrize("sizes", [{"nconmax": 64, "njmax": 1}, {"nconmax": 1, "njmax": 64}])
def test_too_little_memory_names_the_key(model, sizes):
    engine = warp_engine(model, **sizes)
    # The ball touches the floor and the post, and the first joint is at its limit.
    engine.write("qpos", 2.1, None, slice(0, 1))
    engine.write("qpos", [1.25, 0, 0.098], None, slice(2, 5))
    key = min(sizes, key=sizes.__getitem__)
    with pytest.raises(ConfigError, match=rf"sim\.warp\.{key}: 1 .* set sim\.warp\.{key}=2"):
        engine.step(1)


def test_measured_memory(model):
    cpu = CpuEngine(model, 1, 1)
    assert measured_sizes(model, cpu.rows) == {"nconmax": 16, "njmax": 16}


def test_the_state_continues_to_the_bit(model):
    one, other = warp_engine(model), warp_engine(model)
    scatter(one)
    one.write_model("body_mass", np.linspace(0.5, 2, N)[:, None], None, slice(2, 3))
    one.set_const_later()
    one.acceleration("qacc")
    one.step(3)
    other.load_state_dict(one.state_dict())
    np.testing.assert_array_equal(other.acceleration("qacc"), one.acceleration("qacc"))
    for engine in (one, other):
        engine.step(3)
    assert one.rows.tobytes() == other.rows.tobytes()


class Ear:
    def __init__(self):
        self.heard = []

    def on_write(self, write):
        self.heard.append((write.op, write.field))

    def on_physics(self, event):
        self.heard.append((event.phase, event.nstep))


def test_listeners_hear_the_same_calls(both):
    ears = []
    for engine in both:
        ear = Ear()
        ears.append(ear)
        engine.listeners.append(ear)
        engine.reset(np.array([1]))
        engine.write("ctrl", 0.2)
        engine.write_model("body_mass", 2.0, None, slice(2, 3))
        engine.set_const_later()
        engine.derived("xpos")
        engine.step(2)
        engine.forward()
    assert ears[0].heard == ears[1].heard
    assert ears[0].heard.count(("set_const", "")) == 1


def test_a_field_that_warp_has_not(model):
    engine = warp_engine(model)
    engine.write_model("geom_condim", np.full((N, model.ngeom), model.geom_condim))
    engine.step(1)
    engine.write_model("geom_condim", 4, np.array([0]), slice(0, 1))
    with pytest.raises(ConfigError, match="'geom_condim' cannot differ between environments"):
        engine.step(1)
    with pytest.raises(ValueError, match="efc_force"):
        engine.derived("efc_force")


def test_what_warp_lacks_is_listed():
    flags = '<flag autoreset="disable" midphase="disable"/>'
    text = SCENE.replace('integrator="implicitfast"', 'solver="PGS"')
    text = text.replace('<flag autoreset="disable"/>', flags)
    text = text.replace("</actuator>", '<pid name="c" joint="elbow" kp="1" ki="1"/></actuator>')
    problems = warp_support.unsupported(mujoco.MjModel.from_xml_string(text))
    assert [(p.path, p.message) for p in problems] == [
        ("sim.engine", "MuJoCo Warp has no mjDYN_PID (actuator 'c'): use sim.engine=mujoco"),
        ("sim.engine", "MuJoCo Warp has no mjGAIN_PID (actuator 'c'): use sim.engine=mujoco"),
        ("task.physics.solver", "MuJoCo Warp has no mjSOL_PGS; it has cg, newton"),
        (
            "sim.engine",
            "MuJoCo Warp has no flag mjDSBL_MIDPHASE, which a file sets: use sim.engine=mujoco",
        ),
    ]
    with pytest.raises(ConfigError, match="mjSOL_PGS"):
        WarpEngine(mujoco.MjModel.from_xml_string(text), 1)


def test_without_the_extra(monkeypatch):
    # As if the extra were not installed.
    monkeypatch.setattr(warp_support, "find_spec", lambda name: None)
    assert warp_support.why_missing("cpu") == (
        "MuJoCo Warp is not installed (warp, mujoco_warp): pip install 'embodichain[gpu]'"
    )


def test_without_a_card():
    assert warp_support.why_missing("cpu") == ""
    if not warp_support.cuda_devices():
        assert "no CUDA device" in warp_support.why_missing("cuda:0")

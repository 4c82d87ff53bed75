"""Model fields that differ between environments: constants recomputed once, exact resets."""

import mujoco
import numpy as np
import pytest
from mujoco import batch as mjbatch

from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine
from embodichain.lab.sim.engine.fields import DERIVED_FIELDS
from embodichain.utils.errors import ConfigError

XML = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <geom type="plane" size="0 0 .1"/>
    <body name="base" mocap="true" pos="0 0 .5">
      <geom type="box" size=".05 .05 .05" contype="0" conaffinity="0"/>
      <body name="arm" pos="0 0 .1">
        <joint name="hinge" axis="0 1 0" damping="1" armature=".01" range="-1 2"/>
        <geom type="capsule" size=".04" fromto="0 0 0 .3 0 0"/>
        <site name="tip" pos=".3 0 0"/>
      </body>
    </body>
    <body name="cube" pos=".4 0 .05"><freejoint/><geom type="box" size=".05 .05 .05"/></body>
    <body name="ball" pos="0 .4 .05"><freejoint/><geom size=".05"/></body>
  </worldbody>
  <equality><weld name="hold" body1="cube" body2="ball" active="false"/></equality>
  <actuator>
    <position name="drive" joint="hinge" kp="50"/>
    <general joint="hinge" dyntype="filter" dynprm=".1" gainprm="2"/>
  </actuator>
  <sensor><framepos objtype="site" objname="tip"/></sensor>
</mujoco>
"""


@pytest.fixture(scope="module")
def model():
    return mujoco.MjSpec.from_string(XML).compile()


class Ear:
    def __init__(self):
        self.ops = []

    def on_write(self, write):
        self.ops.append((write.op, None if write.env_ids is None else write.env_ids.tolist()))

    def on_physics(self, event):
        self.ops.append((event.phase, None))


def mass(engine, body, value, ids=None):
    column = mujoco.mj_name2id(engine.model, mujoco.mjtObj.mjOBJ_BODY, body)
    engine.write_model("body_mass", value, ids, slice(column, column + 1))


def test_constants_follow_once_whoever_asked(model):
    engine, ear = CpuEngine(model, 4, 2), Ear()
    engine.listeners.append(ear)
    mass(engine, "arm", 3.0, np.array([1]))
    engine.set_const_later(np.array([1]))
    mass(engine, "cube", 2.0, np.array([1, 3]))
    engine.set_const_later(np.array([1, 3]))
    assert [op for op, _ in ear.ops] == ["model", "model"]
    engine.step(1)
    engine.step(1)
    assert ear.ops[2:] == [("set_const", [1, 3]), *[("before", None), ("after", None)] * 2]
    at_once = CpuEngine(model, 4, 2)
    mass(at_once, "arm", 3.0, np.array([1]))
    mass(at_once, "cube", 2.0, np.array([1, 3]))
    at_once.set_const(np.array([1, 3]))
    at_once.step(2)
    assert engine.rows.tobytes() == at_once.rows.tobytes()


@pytest.mark.parametrize(
    "look",
    [
        lambda e: e.derived("xpos"),
        lambda e: e.forward(),
        lambda e: e.acceleration("qacc"),
        lambda e: e.model_field("body_subtreemass"),
        lambda e: e.write_model("body_subtreemass", 1.0),
        lambda e: e.model_of(0),
        lambda e: e.data_of(0),
        lambda e: e.state_dict(),
    ],
)
def test_nobody_sees_constants_that_are_out_of_date(model, look):
    engine, ear = CpuEngine(model, 2, 1), Ear()
    mass(engine, "arm", 3.0)
    engine.set_const_later()
    engine.listeners.append(ear)
    engine.model_field("body_mass")  # an input is current as it is
    mass(engine, "arm", 4.0)
    assert [op for op, _ in ear.ops] == ["model"]
    look(engine)
    assert ("set_const", None) in ear.ops
    assert ear.ops.index(("set_const", None)) == 1
    expected = 4.0 + model.body_subtreemass[0] - model.body("arm").mass[0]
    if ("model", None) not in ear.ops[2:]:
        assert engine.model_field("body_subtreemass")[:, 0] == pytest.approx(expected)


def real_fields(model):
    """Expandable fields that are numbers, not structure: those that a user may randomize."""
    for name in sorted(mjbatch.MODEL_FIELDS):
        owner = model
        *path, last = name.split(".")
        for part in path:
            owner = getattr(owner, part)
        value = np.asarray(getattr(owner, last))
        if value.dtype.kind == "f" and value.size:
            yield name


@pytest.mark.parametrize("persistent", [True, False])
def test_a_reset_is_mujocos_whatever_field_differs(model, persistent):
    """Copying the default row is right for every field that is not on the list of exceptions."""
    copied = 0
    for name in real_fields(model):
        engine = CpuEngine(model, 3, 1, persistent=persistent)
        default = engine.model_field(name).copy()
        engine.write_model(name, default * [[1.0], [1.2], [0.7]] + [[0.0], [0.1], [0.3]])
        # Whether this kind of reset was tried at all.
        copied += engine._fields.resets_alike
        engine.write("qpos", 0.3, None, slice(0, 1))
        engine.write("time", 1.0)
        engine.reset(np.array([1, 2]))
        engine.reset(np.array([0]))
        for env in range(3):
            own, row = engine.model_of(env), np.zeros(engine.rows.shape[1])
            data = mujoco.MjData(own)
            mujoco.mj_resetData(own, data)
            mujoco.mj_getState(own, data, row, mujoco.mjtState.mjSTATE_INTEGRATION)
            assert row.tobytes() == engine.rows[env].tobytes(), name
    assert copied > 60


def test_derived_fields_are_those_that_set_const_changes(model):
    """The list is MuJoCo's: whatever `mj_setConst` changes here is on it."""
    rng = np.random.default_rng(0)
    batch = mjbatch.Batch(model, 2)
    given = ("body_mass", "body_inertia", "body_ipos", "dof_armature", "geom_size", "body_pos")
    for name in (*given, "qpos0", "geom_pos", "site_pos", "geom_margin"):
        values = batch.expand(name)
        values *= rng.uniform(1.0, 1.1, values.shape)
    before = {n for n in mjbatch.MODEL_FIELDS if batch.expanded(n) is not None}
    batch.set_const()
    after = {n for n in mjbatch.MODEL_FIELDS if batch.expanded(n) is not None}
    assert len(after - before) > 5
    assert after - before <= DERIVED_FIELDS


def test_an_older_state_takes_newer_fields_back(model):
    engine = CpuEngine(model, 2, 1)
    saved = engine.state_dict()
    engine.step(3)
    expected = engine.rows.copy()
    mass(engine, "arm", 9.0)
    engine.set_const_later()
    engine.write_model("opt.gravity", 0.0)
    engine.load_state_dict(saved)
    engine.step(3)
    assert engine.rows.tobytes() == expected.tobytes()
    assert engine.model_of(1).body("arm").mass == model.body("arm").mass


@pytest.mark.parametrize("persistent", [True, False])
def test_constants_that_are_due_are_saved(model, persistent):
    engine = CpuEngine(model, 3, 2, persistent=persistent)
    mass(engine, "arm", [[1.0], [2.0], [3.0]])
    engine.set_const_later()
    other = CpuEngine(model, 3, 1, persistent=not persistent)
    other.load_state_dict(engine.state_dict())
    for e in (engine, other):
        e.derived("xpos")
        e.write_model("dof_damping", [[0.5], [1.0], [2.0]], None, slice(0, 1))
        e.step(7)
    assert engine.rows.tobytes() == other.rows.tobytes()


def test_fields_that_mujoco_refuses_are_an_error_not_a_divergence():
    scene = """<mujoco><worldbody><body><freejoint/><geom size=".1"/>
        <geom size=".1" pos=".1 0 0" contype="0" conaffinity="0"/></body></worldbody></mujoco>"""
    engine = CpuEngine(mujoco.MjModel.from_xml_string(scene), 3)
    engine.write_model("geom_contype", [[1, 1]], np.array([1]))
    engine.set_const_later()
    with pytest.raises(ConfigError, match=r"1 of 3 .*geom 1 collides but was not compiled to"):
        engine.step(1)

"""The engine against plain MuJoCo, and its promises: same bytes, isolated failures, one seam."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.engine.api import PhysicsEvent, Write
from embodichain.lab.sim.engine.cpu.cpu_engine import KINEMATIC_STAGES, CpuEngine
from embodichain.lab.sim.engine.fields import row_layout

XML = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast"><flag autoreset="disable"/></option>
  <worldbody>
    <geom type="plane" size="5 5 .1"/>
    <body name="goal" mocap="true" pos="0 0 2">
      <geom type="sphere" size=".02" contype="0" conaffinity="0"/>
    </body>
    <body name="arm" pos="0 0 .6"><joint name="a" axis="0 1 0" damping="1"/>
      <geom type="capsule" size=".05" fromto="0 0 0 .4 0 0" mass="2"/>
      <body name="fore" pos=".4 0 0"><joint name="b" axis="0 1 0" damping="1"/>
        <geom type="capsule" size=".05" fromto="0 0 0 .4 0 0" mass="1"/></body></body>
    <body name="box" pos=".6 0 .12"><freejoint/><geom name="box" type="box" size=".1 .1 .1"/></body>
  </worldbody>
  <actuator><position joint="a" kp="200"/><position joint="b" kp="100"/></actuator>
</mujoco>
"""
STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(XML)


def drive(engine, steps=40, start=0):
    """Random targets that depend on step and environment only; returns the rows after each step."""
    history = []
    for k in range(start, start + steps):
        index = np.arange(engine.num_envs)
        targets = np.stack([np.sin(0.3 * k + index), np.cos(0.2 * k - index)], axis=1)
        engine.write("ctrl", targets)
        engine.step(4)
        if k % 10 == 3:
            engine.write("qvel", 0.1, np.arange(0, engine.num_envs, 2), slice(0, 1))
        if k % 7 == 2:
            engine.derived("xpos")  # looking changes nothing
        history.append(engine.rows.copy())
    return np.stack(history)


def test_rows_equal_a_plain_mujoco_loop(model):
    engine = CpuEngine(model, 2, 2)
    rows = drive(engine)
    data, contacts = mujoco.MjData(model), 0
    for k in range(40):
        data.ctrl[:] = [np.sin(0.3 * k + 1), np.cos(0.2 * k - 1)]
        for _ in range(4):
            mujoco.mj_step(model, data)
            contacts += data.ncon
        row = np.zeros(mujoco.mj_stateSize(model, STATE))
        mujoco.mj_getState(model, data, row, STATE)
        # Environment 1 is never written by `drive`, so it is this loop.
        np.testing.assert_array_equal(rows[k, 1], row)
    assert contacts > 0, "the scene must have contacts"


@pytest.mark.parametrize("num_envs", [3, 64])
@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("persistent", [True, False])
def test_an_environment_has_the_same_bytes_in_every_batch(model, num_envs, threads, persistent):
    alone = drive(CpuEngine(model, 1, 1, persistent=True))
    many = drive(CpuEngine(model, num_envs, threads, persistent=persistent))
    assert many[:, 0].tobytes() == alone[:, 0].tobytes()


@pytest.mark.parametrize("persistent", [True, False])
def test_fields_are_fresh_after_a_step_and_after_a_write(model, persistent):
    engine = CpuEngine(model, 3, 2, persistent=persistent)
    drive(engine, 5)
    engine.write("qpos", 0.7, np.array([1]), slice(0, 1))
    engine.write("mocap_pos", [[1.0, 2.0, 3.0]], np.array([2]))
    for env in range(3):
        data = engine.data_of(env)
        np.testing.assert_array_equal(engine.derived("xpos")[env], data.xpos)
        np.testing.assert_array_equal(engine.derived("cvel")[env], data.cvel)


@pytest.mark.parametrize("persistent", [True, False])
def test_efforts_are_those_of_the_last_physics_step(model, persistent):
    engine = CpuEngine(model, 3, 2, persistent=persistent)
    engine.acceleration("qfrc_actuator")
    drive(engine, 3)
    data = mujoco.MjData(model)
    engine.write("ctrl", 0.3)
    before = engine.rows.copy()
    engine.step(1)
    engine.derived("xpos")
    for env in range(3):
        mujoco.mj_setState(model, data, before[env], STATE)
        mujoco.mj_step(model, data)
        np.testing.assert_array_equal(engine.acceleration("qfrc_actuator")[env], data.qfrc_actuator)


@pytest.mark.parametrize("persistent", [True, False])
@pytest.mark.parametrize("expanded", [True, False])
def test_reset_gives_mujocos_reset_state(model, persistent, expanded):
    engine = CpuEngine(model, 3, 2, persistent=persistent)
    if expanded:  # then a simulation's reset state may be its own
        engine.model_field("body_mass")
    drive(engine, 5)
    others = engine.rows[[0, 2]].copy()
    engine.reset(np.array([1]))
    data = mujoco.MjData(model)
    row = np.zeros(engine.rows.shape[1])
    mujoco.mj_getState(model, data, row, STATE)
    np.testing.assert_array_equal(engine.rows[1], row)
    np.testing.assert_array_equal(engine.rows[[0, 2]], others)


@pytest.mark.parametrize("persistent", [True, False])
def test_an_environment_that_was_reset_is_like_new(model, persistent):
    """Nothing outside the row survives: the next steps are those of a new engine."""
    engine = CpuEngine(model, 3, 2, persistent=persistent)
    engine.write("qpos", np.nan, np.array([2]))
    drive(engine, 7)
    engine.reset()
    assert engine.take_diverged() is None
    assert drive(engine, 7).tobytes() == drive(CpuEngine(model, 3, 2), 7).tobytes()


def poison(engine, name, env):
    where = np.array([env])
    if name == "zero quaternion":
        engine.write("qpos", 0.0, where, slice(5, 9))
    elif name == "heavy":
        engine.write_model("body_mass", 1e30, where)
    else:
        field, value = name.split("=")
        engine.write(field, float(value), where)


POISONS = [
    f"{f}={v}" for f in ("qpos", "qvel", "ctrl", "mocap_pos") for v in ("nan", "inf", "1e30")
]
POISONS += ["zero quaternion", "heavy"]


@pytest.mark.parametrize("name", POISONS)
@pytest.mark.parametrize("persistent", [True, False])
def test_a_poisoned_environment_leaves_its_neighbours_alone(model, name, persistent):
    clean = CpuEngine(model, 5, 2, persistent=persistent)
    sick = CpuEngine(model, 5, 2, persistent=persistent)
    if name == "heavy":  # both run on expanded masses, with one environment apart
        poison(clean, "heavy", 4), clean.write_model("body_mass", model.body_mass, np.array([4]))
    drive(clean, 5), drive(sick, 5)
    poison(sick, name, 2)
    clean.step(4), sick.step(4)
    expected, got = drive(clean, 10, 5), drive(sick, 10, 5)
    healthy = [0, 1, 3, 4]
    assert got[:, healthy].tobytes() == expected[:, healthy].tobytes()
    mask = sick.take_diverged()
    if name.startswith(("qpos", "qvel", "ctrl")):
        assert mask is not None
        assert mask.tolist() == [False, False, True, False, False]
        sick.reset(np.array([2]))
        drive(sick, 2)
        assert sick.take_diverged() is None
    assert clean.take_diverged() is None


def test_no_log_file_is_written_by_a_diverging_simulation(model, tmp_path, monkeypatch, caplog):
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    engine = CpuEngine(model, 64, 2)
    engine.write("qpos", np.nan)
    with caplog.at_level("INFO", "embodichain.mujoco"):
        engine.step(4)
    assert list(folder.iterdir()) == []
    assert "QPOS" in caplog.text


def test_listeners_hear_every_change(model):
    class Ear:
        def __init__(self):
            self.heard = []

        def on_write(self, write: Write):
            kept = None if write.values is None else write.values.copy()
            self.heard.append(write._replace(values=kept))

        def on_physics(self, event: PhysicsEvent):
            self.heard.append((event.phase, event.rows.copy()))

    engine, ear = CpuEngine(model, 2, 1), Ear()
    engine.listeners.append(ear)
    engine.write("ctrl", [[1.0, 2.0], [3.0, 4.0]])
    engine.write("qpos", [[0.5]], np.array([1]), np.array([0]))
    engine.write_model("body_mass", 3.0, np.array([0]), slice(2, 3))
    engine.set_const()
    engine.step(2)
    engine.reset(np.array([0]))
    ctrl, qpos, mass, const, before, after, reset = ear.heard
    assert (ctrl.op, ctrl.field, ctrl.values.tolist()) == (
        "state",
        "ctrl",
        [[1.0, 2.0], [3.0, 4.0]],
    )
    assert (qpos.env_ids.tolist(), qpos.columns.tolist(), qpos.values.tolist()) == (
        [1],
        [0],
        [[0.5]],
    )
    assert (mass.op, mass.field, mass.values.tolist()) == ("model", "body_mass", [[3.0]])
    assert (const.op, reset.op, reset.env_ids.tolist()) == ("set_const", "reset", [0])
    assert (before[0], after[0]) == ("before", "after")
    assert before[1][1, engine.component("ctrl")].tolist() == [3.0, 4.0]
    # What a listener keeps is its own.
    engine.write("ctrl", 0.0)
    assert ctrl.values.tolist() == [[1.0, 2.0], [3.0, 4.0]]


@pytest.mark.parametrize("persistent", [True, False])
def test_a_restored_engine_continues_to_the_bit(model, persistent):
    engine = CpuEngine(model, 3, 2, persistent=persistent)
    engine.acceleration("qfrc_actuator")
    engine.write_model("body_mass", [[2.5], [3.5], [4.5]], None, slice(2, 3))
    engine.set_const()
    drive(engine, 5)
    saved = engine.state_dict()
    expected = drive(engine, 5, 5)
    other = CpuEngine(model, 3, 1, persistent=not persistent)
    other.load_state_dict(saved)
    np.testing.assert_array_equal(
        other.acceleration("qfrc_actuator"), saved["acceleration"]["qfrc_actuator"]
    )
    assert drive(other, 5, 5).tobytes() == expected.tobytes()


def test_randomized_mass_equals_a_model_compiled_with_it(model):
    engine = CpuEngine(model, 2, 1)
    engine.write_model("body_mass", 7.0, np.array([1]), slice(2, 3))
    engine.set_const()
    other = mujoco.MjModel.from_xml_string(XML)
    other.body_mass[2] = 7.0
    mujoco.mj_setConst(other, mujoco.MjData(other))
    heavy = CpuEngine(other, 2, 1)
    assert drive(engine, 5)[:, 1].tobytes() == drive(heavy, 5)[:, 1].tobytes()


def test_writing_the_default_back_changes_no_bit(model):
    engine, same = CpuEngine(model, 2, 1), CpuEngine(model, 2, 1)
    for field in ("body_mass", "geom_friction", "dof_damping", "actuator_gainprm"):
        same.write_model(field, same.model_field(field) * 1.0 + 0.0)
    same.set_const()
    assert drive(engine).tobytes() == drive(same).tobytes()


def test_layout_covers_the_row_and_names_are_checked(model):
    layout = row_layout(model)
    assert sum(s.stop - s.start for s in layout.values()) == mujoco.mj_stateSize(model, STATE)
    engine = CpuEngine(model, 1)
    with pytest.raises(KeyError, match="qpos"):
        engine.component("qpoz")
    with pytest.raises(ValueError, match="Did you mean 'body_mass'"):
        engine.write_model("body_mas", 1.0)


SENSED = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <geom type="plane" size="5 5 .1"/>
    <body name="a" pos="0 0 .3"><joint name="a" axis="0 1 0" range="-.2 .2" limited="true"/>
      <geom type="capsule" size=".05" fromto="0 0 0 .4 0 0" mass="2"/><site name="s" pos=".3 0 0"/>
      <camera pos="0 .1 .2"/><light pos="0 .1 .3" dir="1 0 -1"/>
      <body name="b" pos=".4 0 0"><joint name="b" axis="0 1 0" damping="1"/>
        <geom name="b" type="capsule" size=".05" fromto="0 0 0 .4 0 0" mass="1"/></body></body>
    <body name="box" pos=".6 0 .12"><freejoint/><geom name="box" type="box" size=".1 .1 .1"/></body>
  </worldbody>
  <actuator><position joint="a" kp="200"/><position joint="b" kp="100"/></actuator>
  <sensor>
    <framepos objtype="site" objname="s"/><velocimeter site="s"/><gyro site="s"/>
    <rangefinder site="s"/><jointlimitpos joint="a"/><jointlimitvel joint="a"/>
    <distance geom1="b" geom2="box" cutoff="9"/><subtreelinvel body="a"/><jointvel joint="b"/>
  </sensor>
</mujoco>
"""


@pytest.mark.parametrize("names", [*([name] for name in KINEMATIC_STAGES), list(KINEMATIC_STAGES)])
def test_a_look_computes_what_all_of_mujocos_stages_do(names):
    """With one MjData a thread collisions are left out, with one an environment nothing is."""
    model = mujoco.MjModel.from_xml_string(SENSED)

    def run(persistent):
        engine = CpuEngine(model, 5, 2, persistent=persistent)
        engine.write_model("body_mass", [[2.5], [3.5], [4.5], [2.0], [3.0]], None, slice(2, 3))
        engine.set_const()
        out = []
        for k in range(12):
            engine.write("ctrl", 2 * np.sin(0.3 * k + np.arange(10)).reshape(5, 2))
            engine.step(4)
            out += [engine.derived(name).copy() for name in names]
            engine.write("qpos", 0.3, np.array([1, 3]), slice(0, 1))
            out += [engine.derived(name).copy() for name in names] + [engine.rows.copy()]
        return out

    for all_of_it, alone in zip(run(True), run(False), strict=True):
        np.testing.assert_array_equal(alone, all_of_it)
        assert alone.any()


def test_looks_leave_no_trace_in_the_model(model):
    engine = CpuEngine(model, 4, 2)
    drive(engine)
    assert engine.derived("xpos").any() and not engine.model_fields()
    assert engine.model_of(2).opt.disableflags == model.opt.disableflags
    flags = np.array([[0], [1], [2], [3]]) + int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    engine.write_model("opt.disableflags", flags)
    engine.write("qpos", 0.2)
    assert engine.derived("xpos").any()
    np.testing.assert_array_equal(engine.model_fields()["opt.disableflags"].reshape(4, 1), flags)


EFFORTS = ("qfrc_actuator", "qfrc_damper", "qacc")
ONE = np.array([1])
BETWEEN = {
    "nothing": lambda e: None,
    "a look at poses": lambda e: e.derived("xpos"),
    "a step of one": lambda e: e.step(2, ONE),
    "a look after a step of one": lambda e: (e.step(2, ONE), e.derived("xpos")),
    "a forward of one": lambda e: (e.write("qvel", 0.4, ONE), e.forward(ONE)),
    "a forward of all": lambda e: (e.write("qvel", 0.4), e.forward()),
    "a reset of one": lambda e: (e.reset(ONE), e.derived("xpos")),
    "a reset of all": lambda e: (e.reset(), e.derived("cvel")),
    "other masses": lambda e: (e.write_model("body_mass", 3.0, ONE), e.set_const()),
    "a reset with other poses": lambda e: (e.model_field("qpos0"), e.reset(ONE)),
    "one more field": lambda e: (e.write("ctrl", 0.7), e.acceleration("qfrc_bias")),
    "going back": lambda e: e.load_state_dict(e.state_dict()),
}


@pytest.mark.parametrize("persistent", [True, False, None])
@pytest.mark.parametrize("between", BETWEEN)
def test_efforts_stay_whatever_else_is_computed(model, persistent, between):
    lazy, eager = (CpuEngine(model, 3, 2, persistent=persistent) for _ in range(2))
    for name in EFFORTS:
        lazy.acceleration(name)
        eager.acceleration(name)
    for _ in range(2):  # what happens between is repeated on what it left behind
        kept = []
        for engine in (lazy, eager):
            drive(engine, 2)  # ends without a look
            if engine is eager:  # read at once: nothing can have come between
                kept = [engine.acceleration(name).copy() for name in EFFORTS]
            BETWEEN[between](engine)
        untouched = [0, 2] if "one" in between else [0, 1, 2]
        for name, at_once in zip(EFFORTS, kept, strict=True):
            np.testing.assert_array_equal(lazy.acceleration(name), eager.acceleration(name))
            if between != "a forward of all":
                np.testing.assert_array_equal(
                    lazy.acceleration(name)[untouched], at_once[untouched]
                )
    assert any(np.any(values) for values in kept)

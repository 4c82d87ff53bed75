"""Keeping threads awake between steps: nothing but time depends on it."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.engine.cpu import CpuEngine
from embodichain.lab.sim.engine.pool import Pool

MODEL = """
<mujoco>
  <worldbody>
    <geom type="plane" size="2 2 .1"/>
    <body pos="0 0 .3"><freejoint/><geom size=".1"/>
      <body pos=".2 0 0"><joint name="j" axis="0 1 0"/><geom type="capsule" size=".03 .1"/></body>
    </body>
  </worldbody>
  <actuator><position joint="j" kp="5"/></actuator>
  <sensor><jointactuatorfrc joint="j"/></sensor>
</mujoco>
"""
N = 5


@pytest.fixture
def asked(monkeypatch):
    """Make threads always fall asleep; counts how often they were asked to look on."""
    calls, ask = [], Pool.ask

    def counted(self):
        calls.append(1)
        ask(self)

    monkeypatch.setattr(Pool, "sleeps_soon", lambda self: True)
    monkeypatch.setattr(Pool, "ask", counted)
    return calls


def engine(num_threads=2):
    return CpuEngine(mujoco.MjModel.from_xml_string(MODEL), N, num_threads)


def played(engine, hint, poison=False):
    """States, efforts and who diverged, of 40 steps with two environments that are randomized."""
    generator = np.random.default_rng(0)
    engine.write_model("body_mass", 2.0, np.array([1, 3]), slice(1, 2))
    engine.set_const_later(np.array([1, 3]))
    found = []
    for step in range(40):
        engine.write("ctrl", generator.uniform(-1, 1, (N, 1)))
        if poison and step == 20:
            engine.write("qpos", np.nan, np.array([N - 1]), slice(0, 1))
        engine.step(3)
        if hint:
            engine.stay_awake()
        diverged = engine.take_diverged()
        effort = engine.acceleration("qfrc_actuator").copy()
        found += [engine.rows.copy(), effort, np.zeros(N) if diverged is None else diverged]
    return found


@pytest.mark.parametrize("poison", [False, True])
def test_every_bit_is_the_same(asked, poison):
    for a, b in zip(played(engine(), False, poison), played(engine(), True, poison), strict=True):
        assert a.tobytes() == b.tobytes()
    assert len(asked) == 40


def test_nobody_is_asked_where_fields_are_looked_at_or_somebody_listens(asked):
    class Listener:
        def on_write(self, write): ...

        def on_physics(self, event): ...

    looked, heard, plain = engine(), engine(), engine()
    looked.derived("xpos")
    heard.listeners.append(Listener())
    for each in (looked, heard):
        each.step(1)
        each.stay_awake()
    assert not asked
    plain.step(1)
    plain.stay_awake()
    assert asked


def stepped(pool):
    pool.began()
    pool.ended()
    return pool.sleeps_soon()


def clock(monkeypatch, moments):
    ticks = iter(moment * 1e-6 for moment in moments)
    monkeypatch.setattr("embodichain.lab.sim.engine.pool.time.perf_counter", lambda: next(ticks))


@pytest.mark.parametrize(
    ("moments", "expected"),
    [
        # Microseconds: physics begins, ends, the hint comes, and the same again.
        ((0, 60, 90, 120, 180, 210), True),
        ((0, 60, 90, 145, 180, 210), True),  # one step was a little slow
        ((0, 60, 90, 120, 180, 240), False),  # they are asleep by now
        ((0, 60, 90, 180, 240, 270), False),  # something long is done between steps
        ((0, 600, 630, 660, 1200, 1220), False),  # physics takes long
    ],
)
def test_threads_are_asked_only_where_steps_follow_at_once(monkeypatch, moments, expected):
    clock(monkeypatch, moments)
    pool = Pool(engine()._batch)
    assert not stepped(pool)  # nobody knows yet when physics will be due
    assert stepped(pool) is expected


def test_what_the_asking_takes_is_not_taken_for_a_long_wait(monkeypatch):
    clock(monkeypatch, (0, 60, 90, 120, 180, 210, 300, 330, 390, 420))
    pool = Pool(engine()._batch)
    stepped(pool)
    assert stepped(pool)
    pool.ask()  # to wake one that slept takes longer
    assert stepped(pool)


@pytest.mark.parametrize("threads", [1, 2])
def test_one_thread_never_waits_for_others(monkeypatch, threads):
    clock(monkeypatch, (0, 60, 90, 120, 180, 210))
    pool = Pool(engine(threads)._batch)
    stepped(pool)
    assert stepped(pool) is (threads > 1)

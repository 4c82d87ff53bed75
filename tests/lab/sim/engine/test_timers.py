"""MuJoCo's timers stand still where an engine steps, and are started again as its manual says."""

import mujoco
import pytest

from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine
from embodichain.lab.sim.engine.cpu.mujoco_process import stop_timers

MODEL = mujoco.MjModel.from_xml_string("<mujoco/>")
STEP = int(mujoco.mjtTimer.mjTIMER_STEP)


def timed() -> float:
    data = mujoco.MjData(MODEL)
    for _ in range(100):
        mujoco.mj_step(MODEL, data)
    assert data.timer[STEP].number == 100
    return data.timer[STEP].duration


@pytest.fixture(autouse=True)
def as_the_package_comes():
    mujoco.set_mjcb_time(None)
    assert timed() > 0
    yield
    mujoco.set_mjcb_time(None)
    stop_timers()


def test_an_engine_stops_them_and_mujoco_starts_them_again():
    CpuEngine(MODEL, 2)
    assert timed() == 0
    mujoco.set_mjcb_time(None)
    assert timed() > 0


def test_somebody_elses_callback_stays():
    asked = []

    def clock() -> float:
        asked.append(1)
        return float(len(asked))

    mujoco.set_mjcb_time(clock)
    stop_timers()
    assert timed() > 0
    assert asked

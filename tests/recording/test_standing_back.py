"""The log's process waits while physics takes every core, but not for ever."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from embodichain.recording import McapRecorder, inspect, standing_back, verify
from embodichain.recording.handover import Counters, Slab
from embodichain.recording.standing_back import PhysicsSign, StandingBack
from tests.helpers.writing_here import write_here
from tests.recording.scene import SmallEnv

ROOT = Path(__file__).parents[2]


class Clock:
    """Time that passes only where somebody sleeps, or does physics."""

    def __init__(self):
        self.now, self.naps, self.during = 0.0, 0, lambda: None

    def perf_counter(self):
        return self.now

    monotonic = perf_counter

    def sleep(self, seconds):
        self.now += seconds
        self.naps += 1
        self.during()


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(standing_back, "time", clock)
    return clock


@pytest.fixture
def page():
    return Slab(0, Counters.SIZE)


def call(sign, clock, seconds):
    sign.begins()
    clock.now += seconds
    sign.ends()


def test_the_process_waits_for_the_end_of_a_call_that_will_be_long(clock, page):
    sign, other = PhysicsSign(page, lambda: 5), StandingBack(page)
    call(sign, clock, 0.02)  # the first one: nobody knows that it is long
    sign.begins()
    clock.during = lambda: sign.ends() if clock.naps == 7 else None
    other.wait(5, lambda: True)
    assert clock.naps == 7
    other.wait(5, lambda: True)
    assert clock.naps == 7


def test_the_process_does_not_wait_for_short_calls(clock, page):
    sign, other = PhysicsSign(page, lambda: 5), StandingBack(page)
    call(sign, clock, 0.02)
    call(sign, clock, 0.0001)
    sign.begins()
    other.wait(5, lambda: True)
    assert clock.naps == 0


@pytest.mark.parametrize(("order", "waits"), [(5, True), (4, True), (3, False)])
def test_the_process_does_not_wait_where_orders_do(clock, page, order, waits):
    sign, other = PhysicsSign(page, lambda: 5), StandingBack(page)
    call(sign, clock, 0.02)
    sign.begins()
    other.wait(order, lambda: clock.naps < 3)
    assert clock.naps == (3 if waits else 0)


def test_the_process_does_not_wait_where_somebody_waits_for_it(clock, page):
    sign, other = PhysicsSign(page, lambda: 5), StandingBack(page)
    call(sign, clock, 0.02)
    sign.begins()
    other.wait(5, lambda: clock.naps < 3)
    assert clock.naps == 3


def test_the_process_waits_for_so_long_and_not_again_for_the_same_call(clock, page):
    sign, other = PhysicsSign(page, lambda: 5), StandingBack(page)
    call(sign, clock, 0.02)
    sign.begins()
    other.wait(5, lambda: True)
    waited = clock.naps
    assert waited * standing_back.NAP_SECONDS == pytest.approx(0.1, rel=0.02)
    other.wait(5, lambda: True)
    assert clock.naps == waited
    sign.ends()
    sign.begins()
    other.wait(5, lambda: True)
    assert clock.naps == 2 * waited


@pytest.fixture
def waits(monkeypatch):
    """What the process saw when it asked; physics that has begun never ends."""
    waits = []
    monkeypatch.setattr(standing_back, "LONG_SECONDS", 0.0)
    monkeypatch.setattr(PhysicsSign, "ends", lambda self: setattr(self, "_long", True))
    stand_back = StandingBack.wait

    def wait(self, order, wanted):
        waits.append(bool(self._shown[0]))
        stand_back(self, order, wanted)

    monkeypatch.setattr(StandingBack, "wait", wait)
    write_here(monkeypatch.setattr)
    return waits


CORES = len(os.sched_getaffinity(0))


@pytest.mark.parametrize("threads", sorted({max(1, CORES - 1), CORES}))
def test_a_log_is_whole_whose_process_stands_back(tmp_path, waits, threads):
    env = SmallEnv(num_envs=8 * CORES, threads=threads)
    recorder = McapRecorder(tmp_path / "log.mcap", env)
    env.add_observer(recorder)
    env.reset()
    for _ in range(50):
        env.step()
    recorder.flush()
    for _ in range(50):
        env.step()
    env.close()
    assert verify(tmp_path / "log.mcap").steps == 100
    assert any(waits) is (threads == CORES)


KILLED = """
import os, signal, sys
from embodichain.recording import McapRecorder, standing_back
from tests.recording.scene import SmallEnv

standing_back.LONG_SECONDS = 0.0
standing_back.PhysicsSign.ends = lambda self: setattr(self, "_long", True)
cores = len(os.sched_getaffinity(0))
env = SmallEnv(num_envs=8 * cores, threads=cores)
recorder = McapRecorder(sys.argv[1], env)
env.add_observer(recorder)
env.reset()
for step in range(100):
    env.step()
    if step == 50:
        recorder.flush()
with recorder._file._lock:
    recorder._file._hand_over()
print(recorder.writer_pid, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_log_ends_whose_simulation_was_killed_in_the_midst_of_physics(tmp_path):
    command = [sys.executable, "-c", KILLED, tmp_path / "log.mcap"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == -signal.SIGKILL, done.stderr
    deadline = time.monotonic() + 60
    while (steps := inspect(tmp_path / "log.mcap").steps) < 100 and time.monotonic() < deadline:
        time.sleep(0.1)
    assert steps == 100

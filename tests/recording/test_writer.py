"""The process that writes a log, and the simulation's side of it."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from embodichain import recording
from embodichain.lab.gym.envs.observers import EventRecord
from embodichain.recording import (
    McapRecorder,
    handover,
    inspect,
    verify,
    worker,
    write_process,
    writer,
)
from embodichain.recording.writer import LogWriteError, LogWriter
from embodichain.utils.errors import ConfigError
from tests.helpers.writing_here import write_here
from tests.recording.scene import SmallEnv

ROOT = Path(__file__).parents[2]


def recorded(path, **kwargs):
    env = SmallEnv(**kwargs)
    recorder = McapRecorder(path, env)
    env.add_observer(recorder)
    env.reset()
    return env, recorder


def steps(env, count):
    for _ in range(count):
        env.step()


@contextmanager
def held_up(env, recorder, count):
    """A thread makes steps and waits, with the lock, for a process that has been stopped."""
    recorder.flush()
    os.kill(recorder.writer_pid, signal.SIGSTOP)
    simulation = threading.Thread(target=steps, args=(env, count))
    try:
        simulation.start()
        before = -1
        while env.count != before:
            before = env.count
            simulation.join(2.0)
        assert simulation.is_alive()
        yield
    finally:
        os.kill(recorder.writer_pid, signal.SIGCONT)
        simulation.join()


def test_a_slow_disk_makes_the_simulation_wait_and_drops_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "BUDGET_BYTES", 0)  # as few slabs as there may be
    env, recorder = recorded(tmp_path / "log.mcap")
    steps(env, 3)
    with held_up(env, recorder, 2000):
        assert env.count < 2000
    env.close()
    report = verify(tmp_path / "log.mcap")
    assert report.ok, str(report)
    assert report.steps == 2003


def test_a_writer_that_is_killed_ends_the_run_loudly_and_only_this_one(tmp_path):
    env, recorder = recorded(tmp_path / "log.mcap")
    steps(env, 5)
    recorder.flush()
    os.kill(recorder.writer_pid, signal.SIGKILL)
    said = r"log\.mcap could not be written: the process that writes it has ended \(signal 9\)"
    with pytest.raises(LogWriteError, match=said):
        for _ in range(200):
            env.step()
            recorder.flush()
    with pytest.raises(LogWriteError, match=said):
        env.step()
    recorder.close()  # it was told
    assert inspect(tmp_path / "log.mcap").steps == 5
    again, _ = recorded(tmp_path / "again.mcap")
    steps(again, 3)
    again.close()
    assert verify(tmp_path / "again.mcap").ok


def test_closing_says_what_nobody_was_told(tmp_path):
    env, recorder = recorded(tmp_path / "log.mcap")
    steps(env, 2)
    recorder.flush()
    os.kill(recorder.writer_pid, signal.SIGKILL)
    with pytest.raises(LogWriteError, match="could not be written"):
        recorder.close()
    recorder.close()


def test_what_cannot_be_packed_ends_the_log_with_its_reason(tmp_path, monkeypatch):
    built = threading.Event()

    def refuse(spec):
        built.wait(60)
        raise OSError(2, "No such file or directory", "wheel.stl")

    monkeypatch.setattr("embodichain.recording.attachments.scene_archive", refuse)
    env = SmallEnv()
    recorder = McapRecorder(tmp_path / "log.mcap", env)
    env.add_observer(recorder)
    built.set()
    with pytest.raises(LogWriteError, match=r"No such file or directory: wheel\.stl"):
        recorder.flush()
    with pytest.raises(LogWriteError, match=r"wheel\.stl"):
        env.reset()
    env.close()  # it was told


def test_one_process_writes_one_log_after_another(tmp_path):
    pids = []
    for name in "abc":
        env, recorder = recorded(tmp_path / f"{name}.mcap")
        steps(env, 4)
        pids.append(recorder.writer_pid)
        env.close()
        assert verify(tmp_path / f"{name}.mcap").ok
    assert len(set(pids)) == 1


def test_two_logs_at_once_have_a_process_each(tmp_path):
    logs = [recorded(tmp_path / f"{i}.mcap", seed=i) for i in range(2)]
    assert len({recorder.writer_pid for _, recorder in logs}) == 2
    for _ in range(10):
        for env, _ in logs:
            env.step()
    for env, _ in logs:
        env.close()
    assert all(verify(tmp_path / f"{i}.mcap").steps == 10 for i in range(2))


def test_what_is_larger_than_a_slab_has_one_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "_CONTENT_BYTES", 4096)
    monkeypatch.setattr(writer, "slab_bytes_for", lambda _: 4096)
    env, recorder = recorded(tmp_path / "log.mcap", num_envs=64)
    steps(env, 30)
    env.close()
    report = verify(tmp_path / "log.mcap")
    assert report.ok, str(report)
    assert (report.steps, inspect(tmp_path / "log.mcap").complete) == (30, True)
    del recorder


def status_of_fork(act):
    """How a forked process ends that does this: 0 if it raises nothing and ends by itself."""
    forked = os.fork()
    if not forked:
        status = 1
        try:
            act()
            status = 0
        finally:
            os._exit(status)
    deadline = time.monotonic() + 60
    while not (ended := os.waitpid(forked, os.WNOHANG))[0]:
        if time.monotonic() > deadline:
            os.kill(forked, signal.SIGKILL)
        time.sleep(0.01)
    return os.waitstatus_to_exitcode(ended[1])


def test_a_forked_process_leaves_the_log_alone(tmp_path):
    env, recorder = recorded(tmp_path / "log.mcap")
    steps(env, 3)

    def refused_and_closed():
        with pytest.raises(LogWriteError, match="forked"):
            recorder.flush()
        recorder.close()

    assert status_of_fork(recorder.close) == 0
    assert status_of_fork(refused_and_closed) == 0
    steps(env, 3)
    env.close()
    assert verify(tmp_path / "log.mcap").steps == 6


def test_a_process_forked_while_a_thread_hands_over_leaves_the_log_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "BUDGET_BYTES", 0)
    env, recorder = recorded(tmp_path / "log.mcap")
    with held_up(env, recorder, 2000):
        status = status_of_fork(recorder.close)
    env.close()
    assert status == 0
    assert verify(tmp_path / "log.mcap").steps == 2000


def test_a_forked_process_writes_a_log_of_its_own(tmp_path):
    env, recorder = recorded(tmp_path / "log.mcap")
    steps(env, 3)

    def record():
        own, _ = recorded(tmp_path / "own.mcap")
        steps(own, 5)
        own.close()

    held = threading.Thread(target=lambda: worker._lock.acquire())  # and does not let go
    held.start()
    held.join()
    try:
        assert status_of_fork(record) == 0
    finally:
        worker._lock.release()
    env.close()
    assert verify(tmp_path / "own.mcap").steps == 5
    assert verify(tmp_path / "log.mcap").steps == 3


def test_a_process_that_waits_is_used_and_ends_with_its_program(tmp_path):
    script = """
import sys
from embodichain.recording import worker
worker.warm_up()
worker.warm_up()
first = worker.acquire()
print(first.pid, flush=True)
worker.release(first)
assert worker.acquire() is first
"""
    run = [sys.executable, "-c", script]
    done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, check=True)
    with pytest.raises(ProcessLookupError):
        os.kill(int(done.stdout), 0)


def test_a_program_that_ends_without_closing_has_its_log_and_says_nothing(tmp_path):
    script = """
import sys
from embodichain.recording import McapRecorder
from tests.recording.scene import SmallEnv

env = SmallEnv()
recorder = McapRecorder(sys.argv[1], env)
env.add_observer(recorder)
env.reset()
for _ in range(5):
    env.step()
kept = env, recorder, recorder._file
"""
    run = [sys.executable, "-c", script, tmp_path / "log.mcap"]
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert inspect(tmp_path / "log.mcap").complete
    assert verify(tmp_path / "log.mcap").steps == 5


def test_nothing_heavy_is_imported_by_the_process_that_writes():
    script = """
import sys
import embodichain.recording.write_process
heavy = {"torch", "gymnasium", "hydra", "tensordict", "stable_baselines3"}
print(*sorted(heavy & set(sys.modules)))
"""
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == []


def test_idle_workers_are_few(tmp_path):
    logs = [recorded(tmp_path / f"{i}.mcap") for i in range(3)]
    workers = [recorder._file._worker for _, recorder in logs]
    for env, _ in logs:
        env.close()
    assert sum(w.alive for w in workers) <= 1
    assert len(worker._idle) <= 1


def test_unusual_arrays_arrive_as_they_were(tmp_path):
    env, recorder = recorded(tmp_path / "log.mcap")
    grid = np.arange(12.0).reshape(3, 4)
    drawn = {
        "turned": grid.T[:3],
        "every_other": grid[:, ::2],
        "small": np.arange(3, dtype=np.int16),
        "flags": np.array([True, False, True]),
        "half": np.arange(3, dtype=np.float16),
        "none": np.empty((3, 0)),
        "any": np.array([1, 2, 3], dtype=object),
    }
    recorder.on_event(env, EventRecord("odd", "interval", None, drawn))
    env.close()
    with recording.open(tmp_path / "log.mcap") as log:
        (event,) = (event for event in log.events() if event.term == "odd")
    assert {name: array.tolist() for name, array in event.drawn.items()} == {
        name: array.astype(float).tolist() for name, array in drawn.items()
    }


def test_calls_that_look_alike_and_are_not_arrive_as_they_were(tmp_path):
    env, recorder = recorded(tmp_path / "log.mcap")
    grid = np.arange(12.0).reshape(3, 4)
    drawn = [
        {"a": grid},
        {"a": 2 * grid},
        {"a": np.asfortranarray(3 * grid)},
        {"a": grid[:, :2]},
        {"a": grid.astype(np.int32)},
        {"a": grid, "b": grid},
        {},
        {"a": grid.tolist()},
        {"a": 4 * grid},
    ]
    for values in drawn:
        recorder.on_event(env, EventRecord("step", "interval", None, values))
        env.step()  # has a call of that name, with other arrays
    env.close()
    assert verify(tmp_path / "log.mcap").ok
    with recording.open(tmp_path / "log.mcap") as log:
        found = [event.drawn for event in log.events() if event.term == "step"]
    assert [{n: a.tolist() for n, a in values.items()} for values in found] == [
        {n: np.asarray(a, float).tolist() for n, a in values.items()} for values in drawn
    ]


LOST = """
import os, signal, sys
from embodichain.recording import McapRecorder
from tests.recording.scene import SmallEnv
env = SmallEnv()
recorder = McapRecorder(sys.argv[1], env)
env.add_observer(recorder)
env.reset()
os.kill(recorder.writer_pid, signal.SIGKILL)
try:
    while True:
        env.step()
        recorder.flush()
except OSError as error:
    print("told:", error, file=sys.stderr)
"""


def test_a_program_that_was_told_is_not_told_again_when_it_ends(tmp_path):
    command = [sys.executable, "-c", LOST, tmp_path / "log.mcap"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0
    assert done.stderr.count("could not be written") == 1
    assert "atexit" not in done.stderr


def test_who_was_told_before_the_beginning_was_sent_is_not_told_again(tmp_path, monkeypatch):
    process = worker.Worker()
    os.kill(process.pid, signal.SIGSTOP)  # so that it answers nothing before it ends
    monkeypatch.setattr(worker, "acquire", lambda: process)
    going_on = threading.Event()
    log = LogWriter(tmp_path / "log.mcap", "none", going_on.wait)
    os.kill(log.worker_pid, signal.SIGKILL)
    os.waitid(os.P_PID, log.worker_pid, os.WEXITED | os.WNOWAIT)
    try:
        with pytest.raises(LogWriteError, match="signal 9"):
            log.call_alike("method", (), np.zeros(3))
    finally:
        going_on.set()
    for thread in threading.enumerate():
        if thread.name == "log-head":
            thread.join()
    log.close()


def test_a_busy_machine_does_not_keep_a_log_from_being_written(tmp_path):
    """The writer stands back where a core is wanted, but not for long."""
    burn = [sys.executable, "-c", "while True: pass"]
    busy = [subprocess.Popen(burn) for _ in range(2 * (os.cpu_count() or 1))]
    try:
        env, recorder = recorded(tmp_path / "log.mcap")
        steps(env, 50)
        deadline = time.monotonic() + 60
        while inspect_steps(tmp_path / "log.mcap") < 50 and time.monotonic() < deadline:
            time.sleep(0.1)
        assert inspect(tmp_path / "log.mcap").steps == 50
        env.close()
    finally:
        for process in busy:
            process.kill()
            process.wait()
    assert verify(tmp_path / "log.mcap").ok
    del recorder


@pytest.mark.parametrize("granted", [True, False])
def test_a_writer_of_the_idle_class_offers_its_core_until_somebody_waits(
    tmp_path, monkeypatch, granted
):
    offered = 0

    def yields():
        nonlocal offered
        offered += 1

    def become_idle(*_):
        if not granted:
            raise PermissionError

    write_here(monkeypatch.setattr)
    monkeypatch.setattr(os, "sched_yield", yields)
    monkeypatch.setattr(os, "sched_setscheduler", become_idle)
    env, recorder = recorded(tmp_path / "log.mcap")
    steps(env, 50)
    deadline = time.monotonic() + 60
    while inspect_steps(tmp_path / "log.mcap") < 50 and time.monotonic() < deadline:
        time.sleep(0.1)  # who waits for the log hurries it
    # Steps are several calls; a thread that is no idle one would starve of it.
    assert offered > 50 if granted else not offered
    recorder._file._worker.hurry()
    heard = False
    for _ in range(20):  # what stood back takes a moment to hear of it
        before = offered
        steps(env, 5)
        recorder.flush()
        heard = heard or offered == before
    assert heard
    env.close()
    assert verify(tmp_path / "log.mcap").ok


def inspect_steps(path):
    try:
        return inspect(path).steps
    except ConfigError:
        return 0  # its beginning is not there yet


def test_an_order_that_comes_while_others_take_over_is_theirs():
    """The thread that stands back would carry it out only where no core is wanted."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        writing = write_process._Writing(theirs)
        quiet = threading.Thread(target=writing.carry_on)
        quiet.start()
        writing.pause = True
        handover.send_order(ours, handover.Order(handover.FLUSH, 1, 0, 0, 0, 0), ())
        quiet.join(30.0)
        assert not quiet.is_alive()
        ours.setblocking(False)
        with pytest.raises(BlockingIOError):
            ours.recv(1)
        writing.pause = False
        writing.carry_on()
        assert [kind for kind, *_ in handover.ReplyReader(ours).read()] == [handover.FLUSHED]

"""When a log is written, by which thread, and what is raised when it cannot be."""

import gc
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from embodichain.lab.gym.envs.observers import EventRecord
from embodichain.recording import McapRecorder, inspect, verify
from embodichain.recording.format.options import RecordOptions
from embodichain.recording.write import calls, log_file, recorder, step_buffer, writing
from embodichain.recording.write.writing import LogWriteError
from embodichain.utils.errors import ConfigError
from tests.recording.runs import runs
from tests.recording.scene import SmallEnv

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]


def recorded(path, **kwargs):
    env = SmallEnv(**kwargs)
    log = McapRecorder(path, env)
    env.add_observer(log)
    env.reset()
    return env, log


def steps(env, count):
    for _ in range(count):
        env.step()


def full(*_):
    raise OSError(28, "No space left on device")


def test_a_disk_that_is_full_ends_the_log_loudly_and_only_this_one(tmp_path, monkeypatch):
    env, log = recorded(tmp_path / "log.mcap")
    steps(env, 5)
    log.flush()
    with monkeypatch.context() as patched:
        patched.setattr(os, "write", full)
        said = r"log\.mcap could not be written: No space left on device; it ends after .* step 4"
        with pytest.raises(LogWriteError, match=said):
            for _ in range(200):
                env.step()
                log.flush()
    with pytest.raises(LogWriteError, match=said):
        env.step()
    log.close()  # it was raised before
    assert inspect(tmp_path / "log.mcap").steps == 5
    again, _ = recorded(tmp_path / "again.mcap")
    steps(again, 3)
    again.close()
    assert verify(tmp_path / "again.mcap").ok


def test_closing_raises_what_no_step_raised(tmp_path, monkeypatch):
    env, log = recorded(tmp_path / "log.mcap")
    steps(env, 2)
    log.flush()
    # A disk that is full, which a test cannot make.
    monkeypatch.setattr(os, "write", full)
    with pytest.raises(LogWriteError, match="could not be written"):
        log.close()
    log.close()


def test_what_the_timer_cannot_write_the_next_step_raises(tmp_path, monkeypatch):
    env, log = recorded(tmp_path / "log.mcap")
    with monkeypatch.context() as patched:
        patched.setattr(os, "write", full)
        env.step()
        log._writing._thread.join(60)  # it ends with the error
        with pytest.raises(LogWriteError, match="No space left on device; no control step is in"):
            env.step()
    log.close()


@pytest.mark.parametrize("lacks", [1, 60, 5000])
def test_a_disk_that_takes_a_part_leaves_what_is_said(tmp_path, monkeypatch, lacks):
    env, log = recorded(tmp_path / "log.mcap", num_envs=30)
    steps(env, 3)
    log.flush()
    steps(env, 4)
    took, write = [], os.write

    def partly(descriptor, data):
        if took:
            full()
        took.append(write(descriptor, data[: len(data) - lacks]))
        return took[0]

    with monkeypatch.context() as patched:
        patched.setattr(os, "write", partly)
        with pytest.raises(LogWriteError, match="it ends after control step 2"):
            log.flush()
    log.close()
    assert inspect(tmp_path / "log.mcap").steps == 3


def test_what_cannot_be_packed_raises_at_once(tmp_path, monkeypatch):
    def refuse(spec):
        raise OSError(2, "No such file or directory", "wheel.stl")

    # A mesh that vanishes between the build and the log.
    monkeypatch.setattr("embodichain.recording.format.attachments.scene_archive", refuse)
    with pytest.raises(OSError, match=r"wheel\.stl"):
        McapRecorder(tmp_path / "log.mcap", SmallEnv())
    assert not (tmp_path / "log.mcap").exists()


def test_two_logs_at_once(tmp_path):
    logs = [recorded(tmp_path / f"{i}.mcap", seed=i) for i in range(2)]
    for _ in range(10):
        for env, _ in logs:
            env.step()
    for env, _ in logs:
        env.close()
    assert all(verify(tmp_path / f"{i}.mcap").steps == 10 for i in range(2))


def test_messages_are_short_enough_to_read_one_at_a_time(tmp_path, monkeypatch):
    # Small enough to be reached within a few steps.
    monkeypatch.setattr(step_buffer, "MOST_STEPS", 7)
    env, _ = recorded(tmp_path / "log.mcap", length=100)
    steps(env, 30)
    env.close()
    assert max(run.count for run in runs(tmp_path / "log.mcap")) == 7
    assert verify(tmp_path / "log.mcap").steps == 30


def test_large_steps_are_written_at_once(tmp_path, monkeypatch):
    # Small enough to be reached by one step of 64 environments.
    monkeypatch.setattr(step_buffer, "MOST_BYTES", 4096)
    env, _ = recorded(tmp_path / "log.mcap", num_envs=64, length=100)
    steps(env, 10)
    env.close()
    assert {run.count for run in runs(tmp_path / "log.mcap") if run.steps} == {1}
    assert verify(tmp_path / "log.mcap").steps == 10


def status_of_fork(act):
    """Exit status of a forked process that does this: 0 if it raises nothing and ends by itself."""
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
    env, log = recorded(tmp_path / "log.mcap")
    steps(env, 3)

    def refused_and_closed():
        with pytest.raises(LogWriteError, match="forked"):
            log.flush()
        with pytest.raises(LogWriteError, match="forked"):
            env.step()
        log.close()

    assert status_of_fork(log.close) == 0
    assert status_of_fork(refused_and_closed) == 0
    steps(env, 3)
    env.close()
    assert verify(tmp_path / "log.mcap").steps == 6


def test_a_process_forked_while_a_thread_writes_leaves_the_log_alone(tmp_path):
    env, log = recorded(tmp_path / "log.mcap")
    steps(env, 3)
    # As if the thread wrote just now.
    with log._writing.lock:
        assert status_of_fork(log.close) == 0
    env.close()
    assert verify(tmp_path / "log.mcap").steps == 3


def test_a_forked_process_writes_a_log_of_its_own(tmp_path):
    env, log = recorded(tmp_path / "log.mcap")
    steps(env, 3)

    def record():
        own, _ = recorded(tmp_path / "own.mcap")
        steps(own, 5)
        own.close()

    assert status_of_fork(record) == 0
    env.close()
    assert verify(tmp_path / "own.mcap").steps == 5
    assert verify(tmp_path / "log.mcap").steps == 3


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
"""
    run = [sys.executable, "-c", script, tmp_path / "log.mcap"]
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert inspect(tmp_path / "log.mcap").complete
    assert verify(tmp_path / "log.mcap").steps == 5


LOST = """
import os, sys
from embodichain.recording import McapRecorder
from tests.recording.scene import SmallEnv
env = SmallEnv()
recorder = McapRecorder(sys.argv[1], env)
env.add_observer(recorder)
env.reset()
def full(*_):
    raise OSError(28, "No space left on device")
os.write = full
try:
    while True:
        env.step()
        recorder.flush()
except OSError as error:
    print("raised:", error, file=sys.stderr)
"""


def test_an_error_that_a_program_has_seen_is_not_raised_again_when_it_ends(tmp_path):
    command = [sys.executable, "-c", LOST, tmp_path / "log.mcap"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0
    assert done.stderr.count("could not be written") == 1
    assert "atexit" not in done.stderr


def test_a_recorder_that_nothing_refers_to_ends_its_thread(tmp_path):
    env, log = recorded(tmp_path / "log.mcap")
    # Python lists threads by names alone, and each log has one.
    thread = log._writing._thread
    env.observers.clear()
    del log
    gc.collect()
    thread.join(60)
    assert not thread.is_alive()


INTERRUPTED = """
import signal, sys, threading, os
from embodichain.recording import McapRecorder
from embodichain.recording.write import log_file
from tests.recording.scene import SmallEnv
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where tests run in background
env = SmallEnv()
recorder = McapRecorder(sys.argv[1], env)
env.add_observer(recorder)
env.reset()
write, sent = os.write, []
def interrupted(descriptor, data):
    half = len(data) // 2
    write(descriptor, data[:half])
    sent.append(os.kill(os.getpid(), signal.SIGINT))
    threading.Event().wait(0.05)
    return half + write(descriptor, data[half:])
for count in range(5):
    env.step()
    os.write = interrupted
    try:
        recorder.flush()
    except KeyboardInterrupt:
        print("interrupted")
    os.write = write
assert len(sent) > 9
env.close()
"""


def test_ctrl_c_waits_until_what_is_written_is_whole(tmp_path):
    command = [sys.executable, "-c", INTERRUPTED, tmp_path / "log.mcap"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("interrupted") == 5
    report = verify(tmp_path / "log.mcap")
    assert report.ok and report.steps == 5


def test_ctrl_c_between_two_statements_loses_no_step_and_repeats_none(tmp_path):
    """An interrupt at every line of the recorder in turn, then the end of the program."""
    watched = {module.__file__ for module in (recorder, calls, step_buffer, log_file, writing)}
    line, reached = 0, True
    while reached:
        env, log = recorded(tmp_path / f"{line}.mcap", length=2)
        reached, passed = False, 0

        def interrupt(frame, event, _, line=line, log=log):
            nonlocal passed, reached
            if event == "line" and frame.f_code.co_filename in watched:
                # Inside the lock a signal waits, which another test shows.
                if not log._writing.lock.locked() and passed == line:
                    reached, passed = True, passed + 1
                    raise KeyboardInterrupt
                passed += 1
            return interrupt

        sys.settrace(interrupt)
        try:
            steps(env, 2)
        except KeyboardInterrupt:
            pass
        finally:
            sys.settrace(None)
        made = env.count
        log.close()
        report = verify(tmp_path / f"{line}.mcap")
        assert report.difference is None and report.ok == (report.steps > 0), (line, str(report))
        assert report.steps in (made - 1, made)
        line += 31


@pytest.mark.parametrize("every", [1, 2])
def test_ctrl_c_where_a_step_is_finished_leaves_the_number_of_steps_right(
    tmp_path, every, monkeypatch
):
    """An interrupt at each line that finishes a step; the log ends there, or goes on."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    # The clock must not end a block between two lines.
    monkeypatch.setattr(step_buffer, "MOST_SECONDS", 1e6)
    line = 0
    try:
        while _interrupted_at(tmp_path / f"{line}.mcap", every, line):
            line += 1
    finally:
        signal.signal(signal.SIGINT, before)
    assert line > 20


def _interrupted_at(path, every, line):
    """Record, with an interrupt at a line of finishing the fourth step; False if it has fewer."""
    env = SmallEnv(length=2)
    log = McapRecorder(path, env, options=RecordOptions(every=every))
    env.add_observer(log)
    env.reset()
    steps(env, 3)
    passed = 0

    def trace(frame, event, _):
        nonlocal passed
        name = frame.f_code.co_filename
        if event == "line" and name.endswith(("recorder.py", "step_buffer.py", "writing.py")):
            passed += 1
            if passed == line + 1:
                signal.raise_signal(signal.SIGINT)
        return trace

    def trace_calls(frame, event, _):
        return trace if passed or frame.f_code.co_name == "on_step" else None

    sys.settrace(trace_calls)
    try:
        env.step()
    except KeyboardInterrupt:
        pass
    finally:
        sys.settrace(None)
    with log._writing.lock:  # what the timer does: the step leaves the buffer
        log._write_steps()
    if line % 2:
        steps(env, 2)
    log.close()
    summary = inspect(path)
    assert summary.complete and not summary.warnings, (line, summary.warnings)
    report = verify(path)
    assert report.ok, (line, str(report))
    if every == 1:
        found = [run.steps for run in runs(path)]
        assert sum(found) == log.stats.steps == report.steps == summary.steps, line
    return passed > line


def test_what_no_step_follows_is_written_within_a_while(tmp_path):
    """A policy that takes long after a step: the step is in the file meanwhile."""
    env, log = recorded(tmp_path / "log.mcap")
    deadline = time.monotonic() + 60
    steps(env, 3)
    while time.monotonic() < deadline and steps_in(tmp_path / "log.mcap") < 3:
        time.sleep(0.05)
    assert inspect(tmp_path / "log.mcap").steps == 3
    env.close()
    assert verify(tmp_path / "log.mcap").ok
    del log


def steps_in(path):
    try:
        return inspect(path).steps
    except ConfigError:
        return 0


def test_the_timer_and_the_steps_keep_their_order(tmp_path, monkeypatch):
    """The timer writes all the time, while steps are made."""
    # Instead of four times a second.
    monkeypatch.setattr(writing, "TICK_SECONDS", 0.0)
    monkeypatch.setattr(recorder, "FLUSH_SECONDS", 0.0)
    env, log = recorded(tmp_path / "log.mcap", num_envs=2)
    steps(env, 300)
    env.close()
    report = verify(tmp_path / "log.mcap")
    assert report.ok, str(report)
    assert report.steps == 300
    assert threading.active_count() < 20
    del log


def test_events_between_steps_stay_between_them(tmp_path):
    env, log = recorded(tmp_path / "log.mcap")
    for step in range(4):
        log.on_event(env, EventRecord("mine", "interval", np.array([step % 3]), {}))
        log.flush()
        env.step()
    env.close()
    found = [run for run in runs(tmp_path / "log.mcap") for call in run.calls
             if call.kind.name == "mine"]  # fmt: skip
    assert [run.first for run in found] == [0, 1, 2, 3]
    assert all(run.steps == 1 for run in found)

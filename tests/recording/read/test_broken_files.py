import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mcap.writer import Writer

from embodichain.recording import inspect, verify
from embodichain.recording.format.log_error import LogError
from embodichain.utils.errors import ConfigError

ROOT = Path(__file__).parents[3]

# Steps until it is killed; says, before each step, which one it is about to make: what
# the log's writer got is never more than that.
RUN = """
import sys, time
from embodichain.recording import McapRecorder
from tests.recording.scene import SmallEnv
env = SmallEnv()
recorder = McapRecorder(sys.argv[1], env)
env.add_observer(recorder)
env.reset()
while True:
    print(env.count + 1, flush=True)
    env.step()
    time.sleep(0.01)
"""


@pytest.fixture
def killed(tmp_path):
    """A log whose process got SIGKILL in mid-run, and the number of steps it had begun."""
    path = tmp_path / "killed.mcap"
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [sys.executable, "-c", RUN, path], env=env, stdout=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 60
    # Killed after a flush that holds steps: the first chunk with some is on the disk.
    while time.monotonic() < deadline and not (path.exists() and _has_steps(path)):
        time.sleep(0.1)
    process.send_signal(signal.SIGKILL)
    begun = int(process.stdout.read().split()[-1])
    process.wait()
    return path, begun


def _has_steps(path):
    try:
        return inspect(path).steps > 20
    except ConfigError:
        return False


def test_a_killed_run_reads_up_to_its_last_chunk(killed):
    path, begun = killed
    summary = inspect(path)
    assert 20 < summary.steps <= begun
    assert not summary.complete
    assert summary.warnings == [
        "incomplete: the file ends early: it was not closed, or cut; "
        f"what followed step {summary.steps - 1} is missing"
    ]
    assert set(summary.attachments) >= {"model.mjb.zst", "scene.mjz", "config.yaml"}
    assert summary.episodes
    report = verify(path)
    assert not report.ok
    assert report.difference is None
    assert report.steps == summary.steps
    assert report.problems[0].startswith(f"the log ends after step {summary.steps - 1}: ")


@pytest.mark.parametrize("function", [inspect, verify])
def test_files_that_are_no_logs(tmp_path, function):
    with pytest.raises(ConfigError, match=r"nothing\.mcap does not exist"):
        function(tmp_path / "nothing.mcap")
    with pytest.raises(ConfigError, match=r"rollout\.mcap does not exist"):
        function(tmp_path)
    path = tmp_path / "file.mcap"
    path.write_bytes(b"")
    with pytest.raises(ConfigError, match="is empty"):
        function(path)
    path.write_bytes(b"qpos,qvel\n1,2\n")
    with pytest.raises(ConfigError, match="is not an MCAP file"):
        function(path)


@pytest.mark.parametrize("chunks", [True, False])
@pytest.mark.parametrize("function", [inspect, verify])
def test_somebody_elses_mcap(tmp_path, function, chunks):
    path = tmp_path / "other.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=chunks)
        writer.start()
        channel = writer.register_channel("/sim/state", "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(LogError, match="no metadata record 'embodichain'"):
        function(path)


def test_a_file_cut_anywhere_is_read_without_a_traceback(record, tmp_path):
    data = record(steps=12).read_bytes()
    cut = tmp_path / "cut.mcap"
    whole = inspect(record(name="again.mcap", steps=12)).steps
    for size in [*range(9, len(data), 997), len(data) - 1]:
        cut.write_bytes(data[:size])
        try:
            summary = inspect(cut)
        except LogError:
            continue  # not even the metadata is left
        assert not summary.complete
        assert summary.warnings
        assert summary.steps <= whole
        assert not verify(cut).ok


def test_noise_in_a_file_is_survived(record, tmp_path):
    import numpy as np

    data = record(steps=12).read_bytes()
    rng, bad = np.random.default_rng(0), tmp_path / "bad.mcap"
    for _ in range(60):
        noisy = bytearray(data)
        for at in rng.integers(8, len(data), 3):
            noisy[at] ^= int(rng.integers(1, 256))
        bad.write_bytes(noisy)
        try:
            inspect(bad)
            verify(bad)
        except ConfigError:
            pass  # a report, not a traceback


def test_a_later_format_is_refused(record, tmp_path):
    from tests.recording.rewrite import rewrite

    path = rewrite(
        record(), tmp_path / "new.mcap", metadata=lambda name, v: {**v, "format_version": "5"}
    )
    with pytest.raises(LogError, match="format version '5'; this reads 4"):
        inspect(path)

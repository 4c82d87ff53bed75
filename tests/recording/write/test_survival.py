"""What is left of a log, and of the folder it is in, when something goes wrong while it is made.

`benchmarks/log_survival.py` does the same with fifty kills.
"""

import json
import random
import resource
import shutil
import signal
import time
from contextlib import suppress

import pytest

from embodichain.cli import main
from embodichain.recording import McapRecorder, inspect, verify
from embodichain.recording.read.recover import recover
from embodichain.utils.errors import ConfigError
from tests.recording.scene import SmallEnv

pytestmark = pytest.mark.slow

RUN = ("run", "task=random_reach", "num_envs=2", "seed=3")


def run_in(folder, commands, largest_file=resource.RLIM_INFINITY):
    """A run without an end, and its log, once control steps can be read in it."""
    process = commands.start(*RUN, "episodes=1000000", "--json", cwd=folder)
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (largest_file, largest_file))
    log = folder / "outputs" / "latest" / "rollout.mcap"
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and process.poll() is None:
        with suppress(ConfigError):  # not there yet, or cut within what it begins with
            if inspect(log).steps:
                return process, log.resolve()
        time.sleep(0.05)
    if process.poll() is None:
        process.kill()
    return process, log.resolve()


@pytest.mark.unmeasured  # what a killed process has measured is lost
@pytest.mark.parametrize("moment", range(5))
def test_killed_at_any_moment_it_reads_verifies_and_recovers(tmp_path, commands, moment):
    process, log = run_in(tmp_path, commands)
    time.sleep(random.Random(moment).uniform(0, 1.5))
    process.kill()
    process.communicate()
    before = log.read_bytes()
    broken = verify(log)
    assert broken.difference is None
    assert len(broken.problems) == 1
    assert broken.problems[0].startswith(f"the log ends after step {broken.steps - 1}: ")
    saved = recover(log, tmp_path / "saved.mcap")
    report = verify(saved.path)
    assert report.ok, str(report)
    assert report.steps == broken.steps == inspect(log).steps > 0
    assert log.read_bytes() == before
    names = {path.name for path in log.parent.iterdir()}
    assert names >= {"config.yaml", "overrides.yaml", "command.txt", "versions.json", "run.log"}
    assert not [name for name in names if name.startswith(".")]
    assert json.loads((log.parent / "foxglove_layout.json").read_text())
    assert json.loads((log.parent / "versions.json").read_text())


def test_the_signal_of_batch_systems_ends_a_run_cleanly(tmp_path, commands):
    process, log = run_in(tmp_path, commands)
    process.send_signal(signal.SIGUSR2)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    summary = json.loads(out)
    assert (summary["status"], summary["signal"]) == ("interrupted", "SIGUSR2")
    told = inspect(log)
    assert told.complete
    assert told.steps == summary["control_steps"]


def test_a_full_disk_ends_a_run_loudly(tmp_path, commands):
    """Writing more than this fails, as a full disk does; Python ignores the signal of it."""
    process, log = run_in(tmp_path, commands, largest_file=8_000_000)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1, err
    steps = inspect(log).steps
    assert steps > 0
    end = f"it ends after control step {steps - 1}\n"
    assert f"rollout.mcap could not be written: File too large; {end}" in err
    assert "Traceback" not in err
    summary = json.loads((log.parent / "summary.json").read_text())
    assert summary["status"] == "failed"
    assert "could not be written" in summary["error"]
    saved = recover(log, tmp_path / "saved.mcap")
    assert saved.steps == steps
    assert verify(saved.path).ok


def test_a_folder_that_vanishes_ends_a_run_loudly(tmp_path, commands):
    process, log = run_in(tmp_path, commands)
    shutil.rmtree(log.parent)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1, err
    assert "the log " in err
    assert "the file was removed while it was written" in err
    assert "Traceback" not in err
    assert not log.parent.exists()


def test_an_exception_in_a_users_code_leaves_a_whole_log(tmp_path, capfd, monkeypatch):
    (tmp_path / "raising_policy.py").write_text(
        "def policy(obs, env):\n"
        "    if env.control_step >= 12:\n"
        "        raise RuntimeError('my mistake')\n"
        "    return env.robot.get_qpos()\n"
    )
    monkeypatch.chdir(tmp_path)
    words = ["task=random_reach", "num_envs=2", "policy=raising_policy:policy", "--quiet"]
    assert main(["run", *words]) == 1
    assert "my mistake" in capfd.readouterr().err
    folder = (tmp_path / "outputs" / "latest").resolve()
    assert verify(folder / "rollout.mcap").steps == 12
    assert inspect(folder / "rollout.mcap").complete
    assert json.loads((folder / "summary.json").read_text())["status"] == "failed"


def test_a_growing_log_is_read_by_others(tmp_path):
    env = SmallEnv()
    recorder = McapRecorder(tmp_path / "log.mcap", env)
    env.add_observer(recorder)
    env.reset()
    for steps in (5, 10, 15):
        for _ in range(5):
            env.step()
        recorder.flush()
        summary = inspect(tmp_path / "log.mcap")
        assert summary.steps == steps
        assert not summary.complete
        report = verify(tmp_path / "log.mcap")
        assert (report.steps, report.difference) == (steps, None)
    env.close()
    assert verify(tmp_path / "log.mcap").ok

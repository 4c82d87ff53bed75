"""Logs that go on in other files (`record.max_mb`)."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import embodichain.recording as recording
from embodichain.cli import main
from embodichain.recording import McapRecorder, RecordOptions, diff, inspect, verify
from embodichain.recording.export import FORMATS, Part, export
from embodichain.recording.format.attachments import MODEL as MODEL_FILE
from embodichain.recording.format.attachments import load_mjb, unpack_model
from embodichain.recording.format.log_error import LogError
from embodichain.recording.format.messages.schema import START_TOPIC
from embodichain.recording.read.recover import recover
from embodichain.utils.errors import ConfigError
from tests.recording.runs import changed, flip, runs
from tests.recording.scene import MODEL, SmallEnv

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]


def roll(folder, steps=100, max_mb=0.01, state="all", **kwargs):
    """A log in several files; flushed often, so that it rolls where it should."""
    folder.mkdir()
    env = SmallEnv(**kwargs)
    options = RecordOptions(max_mb=max_mb, state=state, keyframe_every=10)
    recorder = McapRecorder(folder / "rollout.mcap", env, "seed: 0\n", [], options, "small")
    env.add_observer(recorder)
    env.reset()
    for step in range(steps):
        env.step()
        if step % 3 == 0:
            recorder.flush()
    env.close()
    return folder


def files_of(folder):
    return sorted(path.name for path in folder.glob("*.mcap"))


@pytest.fixture(scope="module")
def rolled(tmp_path_factory):
    """Files of one log; not to be changed."""
    return roll(tmp_path_factory.mktemp("parts") / "run")


def test_the_set_is_the_log(rolled, record):
    whole = record(steps=100)
    names = files_of(rolled)
    assert names[:3] == ["rollout.mcap", "rollout_0001.mcap", "rollout_0002.mcap"]
    for path in (rolled, rolled / "rollout.mcap", rolled / "rollout.manifest.json"):
        report = verify(path)
        assert report.ok, str(report)
        assert (report.steps, report.notes) == (100, [])
        summary = inspect(path)
        assert (summary.steps, summary.warnings, summary.files) == (100, [], names)
        assert summary.nbytes == sum((rolled / name).stat().st_size for name in names)
        with recording.open(path) as log, recording.open(whole) as other:
            data, expected = log.read(), other.read()
            assert log.complete and log.warnings == []
            assert data.steps.tolist() == list(range(100))
            for field in expected:
                assert np.array_equal(data[field], expected[field]), field
            assert log.episodes == other.episodes
            assert len(list(log.events())) == len(list(other.events()))
            assert len(list(log.writes())) == len(list(other.writes()))
        assert diff(whole, path).same
    assert verify(rolled, env=1, episode=7).ok


def test_a_range_of_steps_in_a_later_file(rolled):
    with recording.open(rolled) as log:
        whole = log.read()
    with recording.open(rolled) as log:
        part = log.read(["qpos", "rewards"], env=2, start=60, stop=90)
    assert part.steps.tolist() == list(range(60, 90))
    assert np.array_equal(part["qpos"], whole["qpos"][60:90, 2:3])


def test_every_file_stands_alone(rolled, tmp_path):
    manifest = json.loads((rolled / "rollout.manifest.json").read_text())
    assert manifest["complete"]
    with recording.open(rolled) as log:
        whole = log.read()
    at = 0
    for entry in manifest["files"]:
        path = Path(shutil.copy(rolled / entry["name"], tmp_path))
        assert (entry["first_step"], entry["complete"]) == (at, True)
        assert entry["start_s"] == pytest.approx(at * 0.02)
        assert entry["nbytes"] == path.stat().st_size
        at += entry["steps"]
        assert entry["stop_s"] == pytest.approx(at * 0.02)
        report = verify(path)
        assert report.ok, str(report)
        assert report.steps == entry["steps"]
        assert f"from step {entry['first_step']} on" in report.notes[0]
        with recording.open(path) as log:
            data = log.read()
            assert data.steps.tolist() == list(range(entry["first_step"], at))
            for field in whole:
                assert np.array_equal(data[field], whole[field][data.steps]), field
                assert data.names(field) == whole.names(field) or not len(data)
            for env in range(3 if len(data) else 0):
                assert len(log.snapshot(env, step=at - 1).row) == log.header.nstate
            assert log.config == {"seed": 0}
            assert load_mjb(unpack_model(log.attachment(MODEL_FILE))).nq == MODEL.nq
            assert log.complete and log.warnings == report.notes
            topics = [topic for topic, *_ in log.raw_messages()]
            assert "/env_0/scene" in topics or not entry["steps"]
        path.unlink()
    assert at == 100


def test_another_programs_reader_reads_each(rolled):
    from mcap.reader import make_reader

    steps = 0
    for name in files_of(rolled):
        with (rolled / name).open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            count = sum(1 for _ in reader.iter_messages())
            assert count == reader.get_summary().statistics.message_count
        steps += sum(run.steps for run in runs(rolled / name))
    assert steps == 100


def test_a_missing_file_is_named(rolled, tmp_path):
    run = shutil.copytree(rolled, tmp_path / "run")
    entries = json.loads((run / "rollout.manifest.json").read_text())["files"]
    (run / "rollout_0001.mcap").unlink()
    first, gone = entries[0]["steps"], entries[1]
    steps = f"steps {first} to {first + gone['steps'] - 1}"
    says = (
        f"rollout_0001.mcap ({steps}), which continues it, is missing; "
        "rollout_0002.mcap and later files can be read by themselves"
    )
    report = verify(run)
    assert not report.ok
    assert report.problems == [f"the log ends after step {first - 1}: {says}"]
    assert inspect(run).warnings == [
        f"incomplete: {says}; what followed step {first - 1} is missing"
    ]
    with recording.open(run) as log:
        assert len(log.read("qpos")) == first
        assert not log.complete and says in log.warnings[0]
    saved = recover(run, tmp_path / "saved.mcap")
    assert (saved.steps, saved.damage) == (first, says)
    assert verify(saved.path).ok
    assert verify(run / "rollout_0002.mcap").ok


def test_the_set_becomes_one_file(rolled, tmp_path):
    saved = recover(rolled, tmp_path / "one.mcap")
    assert (saved.steps, saved.damage, saved.lost_bytes) == (100, "", 0)
    assert inspect(saved.path).warnings == []
    assert verify(saved.path).ok
    assert diff(rolled, saved.path).same


def test_a_file_of_another_log_is_refused(rolled, tmp_path):
    run = shutil.copytree(rolled, tmp_path / "run")
    other = roll(tmp_path / "other", seed=1)
    shutil.copy(other / "rollout_0001.mcap", run)
    says = "rollout_0001.mcap: it is part of another log"
    assert says in verify(run).problems[0]
    with recording.open(run) as log:
        assert says in log.warnings[0]
    shutil.copy(rolled / "rollout_0002.mcap", run / "rollout_0001.mcap")
    assert "rollout_0001.mcap: it is part 2 of the log, not 1" in verify(run).problems[0]


def test_a_changed_start_of_a_later_file_is_found(rolled, tmp_path):
    """A file alone starts from its own first rows; in the set what precedes it must lead there."""
    run = shutil.copytree(rolled, tmp_path / "run")
    first = json.loads((run / "rollout.manifest.json").read_text())["files"][0]["steps"]
    source, target = (folder / "rollout_0001.mcap" for folder in (rolled, run))
    changed(source, target, first, "start", "row", flip((1, 2)), START_TOPIC)
    assert verify(run).difference.step == first
    assert verify(run / "rollout_0001.mcap").difference.step == first


@pytest.mark.parametrize("content", ["{}", "[]", "nothing", '{"files": [{"name": "../a.mcap"}]}'])
def test_a_manifest_that_is_none(rolled, tmp_path, content):
    run = shutil.copytree(rolled, tmp_path / "run")
    (run / "rollout.manifest.json").write_text(content)
    with pytest.raises(ConfigError, match="is not a manifest of a log"):
        verify(run / "rollout.manifest.json")
    assert verify(run).ok  # the files themselves say what they are


def test_keyframes_and_randomized_models_roll_too(tmp_path):
    run = roll(tmp_path / "run", state="keyframes", settle=3, push=True)
    assert len(files_of(run)) > 1
    for path in [run, *run.glob("rollout_*.mcap")]:
        report = verify(path)
        assert report.ok, str(report)


def test_a_small_log_is_one_file(tmp_path):
    run = roll(tmp_path / "run", steps=10, max_mb=50)
    assert sorted(p.name for p in run.iterdir()) == ["foxglove_layout.json", "rollout.mcap"]


def test_a_renamed_folder_gets_the_later_files(tmp_path):
    (tmp_path / "run").mkdir()
    env = SmallEnv()
    options = RecordOptions(max_mb=0.01)
    recorder = McapRecorder(tmp_path / "run" / "rollout.mcap", env, options=options)
    env.add_observer(recorder)
    env.reset()
    for step in range(100):
        if step == 10:
            (tmp_path / "run").rename(tmp_path / "elsewhere")
        env.step()
        recorder.flush()
    env.close()
    assert recorder.stats.nbytes == inspect(tmp_path / "elsewhere").nbytes
    assert len(files_of(tmp_path / "elsewhere")) > 1
    assert verify(tmp_path / "elsewhere").steps == 100
    assert not (tmp_path / "run").exists()


def test_nothing_is_lost_when_the_next_file_cannot_be_made(tmp_path):
    (tmp_path / "rollout_0001.mcap").write_text("somebody's")
    env = SmallEnv()
    recorder = McapRecorder(tmp_path / "rollout.mcap", env, options=RecordOptions(max_mb=0.01))
    env.add_observer(recorder)
    env.reset()
    said = r"File exists: rollout_0001\.mcap; it ends after control step"
    with pytest.raises(OSError, match=said) as raised:
        for _ in range(200):
            env.step()
            recorder.flush()
    steps = inspect(tmp_path / "rollout.mcap").steps
    assert steps == int(str(raised.value).split()[-1]) + 1 > 5
    assert (tmp_path / "rollout_0001.mcap").read_text() == "somebody's"


KILLED = """
import os, signal, sys
from embodichain.recording import McapRecorder, RecordOptions
from embodichain.recording.write.log_writer import LogWriter
from tests.recording.scene import SmallEnv
env = SmallEnv()
recorder = McapRecorder("rollout.mcap", env, options=RecordOptions(max_mb=0.01))
env.add_observer(recorder)
moment, rename, begin = sys.argv[1], os.replace, LogWriter._write_head

def write_head(self, part, first_step):
    if part == 2 and moment == "new":
        os.kill(os.getpid(), signal.SIGKILL)
    begin(self, part, first_step)

def replace(*args, **kwargs):
    if moment == "manifest":
        os.kill(os.getpid(), signal.SIGKILL)
    rename(*args, **kwargs)

LogWriter._write_head, os.replace = write_head, replace
env.reset()
for step in range(1000):
    env.step()
    recorder.flush()
"""


@pytest.mark.unmeasured
@pytest.mark.parametrize("moment", ["new", "manifest"])
def test_killed_while_it_rolls_it_is_readable(tmp_path, moment):
    done = subprocess.run(
        [sys.executable, "-c", KILLED, moment],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        timeout=120,
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    newest = files_of(tmp_path)[-1]
    assert newest == {"new": "rollout_0002.mcap", "manifest": "rollout_0001.mcap"}[moment]
    summary = inspect(tmp_path)
    assert summary.steps > 5
    assert "ends early" in summary.warnings[0]
    report = verify(tmp_path)
    assert report.steps == summary.steps
    assert report.difference is None
    assert newest in report.problems[0]
    with recording.open(tmp_path) as log:
        assert len(log.read("qpos")) == summary.steps
    saved = recover(tmp_path, tmp_path / "saved.mcap")
    assert verify(saved.path).ok
    assert saved.steps == summary.steps


@pytest.mark.unmeasured
def test_another_process_reads_what_is_there_while_it_grows(tmp_path):
    code = (
        "import sys\n"
        "from embodichain.recording import inspect, verify\n"
        "import embodichain.recording as recording\n"
        "for line in sys.stdin:\n"
        "    found, report = inspect('rollout.mcap'), verify('rollout.mcap')\n"
        "    with recording.open('rollout.mcap') as log:\n"
        "        read = len(log.read('qpos'))\n"
        "    print(found.steps, read, report.steps, report.difference, found.complete)\n"
    )
    reader = subprocess.Popen(
        [sys.executable, "-u", "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    env = SmallEnv()
    recorder = McapRecorder(tmp_path / "rollout.mcap", env, options=RecordOptions(max_mb=0.01))
    env.add_observer(recorder)
    env.reset()
    for step in range(1, 121):
        env.step()
        if step % 40 == 0:
            recorder.flush()
            print("read", file=reader.stdin, flush=True)
            assert reader.stdout.readline().split() == [*[str(step)] * 3, "None", "False"]
    env.close()
    out, _ = reader.communicate("read\n", timeout=60)
    assert out.split() == ["120", "120", "120", "None", "True"]


def test_export_takes_all_files(rolled, tmp_path):
    out = tmp_path / "log.npz"
    assert main(["export", str(rolled), "--format", "npz", "-o", str(out)]) == 0
    assert len(np.load(out)["steps"]) == 100


@pytest.mark.parametrize("format", FORMATS)
def test_export_takes_a_later_file_by_itself(rolled, tmp_path, format):
    path = Path(shutil.copy(rolled / "rollout_0001.mcap", tmp_path))
    with recording.open(path) as log, recording.open(rolled) as whole:
        steps = log.read("rewards").steps
        part = Part(start=int(steps[0]), stop=int(steps[-1]) + 1)
        mine = export(log, format, tmp_path / f"mine{FORMATS[format].suffix}")
        theirs = export(whole, format, tmp_path / f"theirs{FORMATS[format].suffix}", part)
    if format == "csv":
        assert mine.read_text() == theirs.read_text()
    elif format == "npz":
        with np.load(mine) as found, np.load(theirs) as expected:
            assert np.array_equal(found["actions"], expected["actions"])
    else:
        of_files = [p for p in theirs.rglob("*") if p.is_file()] or [theirs]
        for file in of_files:
            other = mine / file.relative_to(theirs)
            assert other.stat().st_size == pytest.approx(file.stat().st_size, rel=0.2)


def test_a_run_rolls(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    words = ["task=cart_pole", "num_envs=64", "max_steps=250", "episodes=20", "record.max_mb=0.05"]
    words += ["record.state=keyframes", "record.keyframe_every=2", "record.compression=none"]
    assert main(["run", *words, "--json"]) == 0
    run = (tmp_path / "outputs" / "latest").resolve()
    assert len(files_of(run)) > 1
    capfd.readouterr()
    assert main(["replay", str(run), "--verify"]) == 0
    assert "verified: 250 steps of 64 environments" in capfd.readouterr().out
    assert main(["replay", str(run / "rollout.manifest.json"), "--verify", "--env", "7"]) == 0
    assert main(["validate", "task=random_reach", "record.max_mb=0"]) == 2
    assert "record.max_mb" in capfd.readouterr().err


def test_states_cannot_be_asked_of_a_log_without_them(tmp_path):
    run = roll(tmp_path / "run", steps=60, max_mb=0.001, state="none")
    with recording.open(run) as log, pytest.raises(LogError, match="has no states"):
        log.read()

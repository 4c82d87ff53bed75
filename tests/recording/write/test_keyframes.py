"""Logs with `record.state: keyframes`: states now and then, everything that leads from one on."""

import mujoco
import numpy as np
import pytest

import embodichain.recording as recording
from embodichain.cli import main
from embodichain.recording import McapRecorder, RecordOptions, diff, inspect, verify
from embodichain.recording.format.log_error import LogError
from embodichain.recording.format.messages.schema import START_TOPIC
from embodichain.recording.read.playback import Playback, Span
from embodichain.utils.errors import ConfigError
from tests.recording.rewrite import rewrite
from tests.recording.runs import changed, flip
from tests.recording.scene import SmallEnv

pytestmark = pytest.mark.slow

KEYFRAMES = RecordOptions(state="keyframes", keyframe_every=8)
CASES = [
    {},
    {"num_envs": 1},
    {"num_envs": 5, "threads": 2},
    {"settle": 25},
    {"settle": 4},  # as long as a control step's own physics
    {"push": True},  # rows become whole between two keyframes
    {"before": 4},  # starts with randomized masses
    {"before": 5, "push": True},
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_what_lies_between_is_simulated_to_the_bit(record, case):
    whole = record("whole.mcap", steps=30, **case)
    sparse = record("sparse.mcap", steps=30, options=KEYFRAMES, **case)
    report = verify(sparse)
    assert report.ok, str(report)
    assert report.steps == 30
    assert diff(whole, sparse).same
    with recording.open(whole) as a, recording.open(sparse, simulate=True) as b:
        expected, found = a.read(list(a.columns)), b.read(list(b.columns))
        assert found.steps.tolist() == list(range(30))
        for field in expected:
            assert expected[field].tobytes() == found[field].tobytes(), field
        part = b.read(["qpos", "ctrl"], env=0, start=13, stop=22)
        assert part.steps.tolist() == list(range(13, 22))
        assert part["qpos"].tobytes() == expected["qpos"][13:22, :1].tobytes()
        episode = b.read("qvel", env=0, episode=2)
        mine = np.flatnonzero(expected["episodes"][:, 0] == 2)
        assert episode.steps.tolist() == mine.tolist()
        assert episode["qvel"].tobytes() == expected["qvel"][mine, :1].tobytes()
        parts = [p["qpos"] for p in b.parts("qpos", steps=7)]
        assert np.concatenate(parts).tobytes() == expected["qpos"].tobytes()


def test_a_diverging_environment_verifies(record, poison):
    assert verify(record(env=poison, options=KEYFRAMES)).ok


def test_only_keyframes_are_read_unless_more_is_asked_for(record):
    path = record(steps=30, options=KEYFRAMES)
    with recording.open(path) as log:
        assert log.header.keyframe_every == 8
        assert log.read("qpos").steps.tolist() == [0, 8, 16, 24]
        assert log.read(["qpos", "rewards"], start=5, stop=20).steps.tolist() == [8, 16]
        assert log.read(["rewards", "actions"]).steps.tolist() == list(range(30))
        assert [e.steps for e in log.episodes if e.env == 0] == [7, 7, 7, 7, 2]


def test_they_are_much_smaller(record):
    whole = record("whole.mcap", steps=400, num_envs=20)
    sparse = record("sparse.mcap", steps=400, num_envs=20, options=RecordOptions("keyframes"))
    assert sparse.stat().st_size < 0.5 * whole.stat().st_size


def test_one_environment_and_one_episode(record):
    path = record(settle=6, options=KEYFRAMES)
    for env in range(3):
        assert verify(path, env=env).ok
    assert verify(path, env=0, episode=1).steps == 7
    report = verify(path, episode=1)
    assert report.ok and report.steps == 18 - 7


def test_a_changed_keyframe_is_found(record, tmp_path):
    path, bad = record(steps=30, options=KEYFRAMES), tmp_path / "bad.mcap"
    path = changed(path, bad, 16, "start", "row", flip((2, 3)), START_TOPIC)
    difference = verify(path).difference
    assert (difference.step, difference.env, difference.field) == (16, 2, "qpos[2]")


def test_a_changed_hash_between_keyframes_is_found(record, tmp_path):
    path, bad = record(steps=30, options=KEYFRAMES), tmp_path / "bad.mcap"
    path = changed(path, bad, 11, "physics", "hashes", flip(1))
    difference = verify(path).difference
    assert (difference.step, difference.env, difference.field) == (11, 1, "hash")
    assert verify(path, env=0).ok
    with (
        recording.open(path, simulate=True) as log,
        pytest.raises(LogError, match="the recorded states when simulated: step 11, environment 1"),
    ):
        log.read("qpos")


def test_a_changed_write_between_keyframes_is_found(record, tmp_path):
    path, bad = record(steps=30, options=KEYFRAMES), tmp_path / "bad.mcap"
    path = changed(path, bad, 5, "write", "values", flip((2, 1), 62), name="ctrl")
    difference = verify(path).difference
    assert difference.env == 2
    assert difference.step == 5


def test_a_cut_log_verifies_up_to_its_end(record, tmp_path):
    options = RecordOptions("keyframes", keyframe_every=8, compression="none")
    path = record(steps=200, options=options, num_envs=100)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    report = verify(cut)
    assert 20 < report.steps < 200
    assert report.difference is None
    assert len(report.problems) == 1
    with recording.open(cut, simulate=True) as log:
        assert len(log.read("qpos")) == report.steps == inspect(cut).steps


def test_another_mujoco_is_approximate(record, tmp_path):
    def metadata(name, values):
        return {**values, "mujoco_version": "4.9.9"} if name == "embodichain" else values

    path = rewrite(record(options=KEYFRAMES), tmp_path / "other.mcap", metadata=metadata)
    report = verify(path)
    assert not report.ok
    assert report.steps == 20
    assert 0 <= report.largest_error["qpos"] < 1e-2
    assert "between keyframes, up to 8 steps" in report.problems[0]
    with recording.open(path) as log:
        assert log.read("qpos").steps.tolist() == [0, 8, 16]
    with recording.open(path, simulate=True) as log, pytest.raises(LogError, match="mujoco==4.9.9"):
        log.read("qpos")


def test_models_that_hide_state_need_every_state(tmp_path):
    xml = (
        "<mujoco><option><flag sleep='enable'/></option>"
        "<worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    env = SmallEnv(model=mujoco.MjSpec.from_string(xml).compile())
    with pytest.raises(ConfigError, match=r"record\.state: keyframes cannot be replayed: .* sleep"):
        McapRecorder(tmp_path / "log.mcap", env, options=KEYFRAMES)
    assert not (tmp_path / "log.mcap").exists()


def test_playback_and_export_have_every_state(record, tmp_path):
    whole = record("whole.mcap", settle=3)
    sparse = record("sparse.mcap", settle=3, options=KEYFRAMES)
    shown = []
    for path in (whole, sparse):
        with recording.open(path) as log:
            play = Playback(log, 1)
            shown.append([play.engine.rows.tobytes() for _ in play.steps(Span())])
        assert main(["export", str(path), "--format", "npz", "-o", f"{path}.npz"]) == 0
    assert shown[0] == shown[1] and len(shown[0]) == 20
    a, b = (np.load(f"{path}.npz") for path in (whole, sparse))
    assert a["qpos"].tobytes() == b["qpos"].tobytes()

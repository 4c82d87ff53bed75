import json

import numpy as np
import pytest

from embodichain.cli import main
from embodichain.recording import RecordOptions, diff
from embodichain.recording.format.log_error import LogError
from embodichain.recording.format.messages.block import pack_steps
from embodichain.recording.format.messages.schema import STEPS_TOPIC
from embodichain.utils.errors import ConfigError
from tests.recording.rewrite import rewrite
from tests.recording.runs import changed, header_of, recorded_steps, unpack


@pytest.fixture
def nudged(record, tmp_path):
    """A log and a copy in which an array of step 6 is changed."""

    def make(kind, array, change, name=""):
        path = record(steps=12)
        return path, changed(path, tmp_path / "changed.mcap", 6, kind, array, change, name=name)

    return make


def test_two_runs_alike_are_the_same(record):
    a = record("a.mcap", steps=15)
    b = record("b.mcap", steps=15, threads=2, options=RecordOptions(compression="lz4"))
    report = diff(a, b)
    assert report.same
    assert report.steps == 15
    assert report.notes == []


def test_another_seed_differs_at_once(record):
    report = diff(record("a.mcap"), record("b.mcap", seed=1))
    assert report.steps == 0
    assert report.difference.step == 0
    assert report.difference.field == "write body_mass"
    assert report.difference.env == 0
    assert "seed: 0 and 1" in report.notes


def test_a_state_is_named_by_joint(nudged):
    def nudge(rows):  # environment 1, column 4 of its rows: time, then qpos
        nudge.values = rows[1, 4], np.nextafter(rows[1, 4], 9.0)
        rows[1, 4] = nudge.values[1]

    a, b = nudged("physics", "rows", nudge)
    found = diff(a, b).difference
    assert (found.step, found.env, found.field, found.column) == (6, 1, "qpos", "cube/free.y")
    assert (found.a, found.b) == nudge.values
    assert diff(a, b).steps == 6


@pytest.mark.parametrize(
    ("array", "change", "expected"),
    [
        ("reward", lambda v: v.__setitem__(2, 7.0), (2, "reward", "", 7.0)),
        ("truncated", lambda v: v.__setitem__(1, ~v[1]), None),
    ],
)
def test_outcomes_are_named(nudged, array, change, expected):
    found = diff(*nudged("step", array, change)).difference
    assert found.step == 6
    if expected is not None:
        assert (found.env, found.field, found.column, found.b) == expected
    else:
        assert found.field == "truncated"


def test_an_action_is_named(record, tmp_path):
    a = record("a.mcap", steps=12)

    def message(topic, data):
        if topic != STEPS_TOPIC:
            return data
        found = unpack(header_of(a), data)
        first, steps = found[0].first, recorded_steps(found)
        if first <= 6 < first + len(steps):
            _, (action, *_) = steps[6 - first][-1]
            action[1, 1] = 7.0  # of the step, not of the write
        return b"".join(pack_steps(first, steps))

    found = diff(a, rewrite(a, tmp_path / "b.mcap", message=message)).difference
    assert (found.step, found.env, found.field) == (6, 1, "action")
    assert (found.column, found.b) == ("1", 7.0)


def test_a_hash_is_named(record, tmp_path):
    a = record(steps=12, options=RecordOptions("keyframes"))
    b = changed(a, tmp_path / "b.mcap", 6, "physics", "hashes", lambda v: v.__setitem__(1, 0xAB))
    found = diff(a, b).difference
    assert (found.step, found.env, found.field) == (6, 1, "result of physics")
    assert (found.column, found.b) == ("hash", "00000000000000ab")


def test_a_write_is_named_by_environment_and_column(nudged):
    def nudge(values):
        values[2, 1] += 1.0

    found = diff(*nudged("write", "values", nudge, "ctrl")).difference
    assert (found.step, found.env, found.field, found.column) == (6, 2, "write ctrl", "1")


def test_a_shorter_log_ends_first(record):
    a, b = record("a.mcap", steps=9), record("b.mcap", steps=12)
    found = diff(a, b).difference
    assert found.step == 9
    assert "physics steps" in found.field or found.field in ("end", "what happened")


def test_a_cut_log_is_compared_as_far_as_it_goes(record, tmp_path):
    a = record(num_envs=64, steps=160)  # several chunks
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(a.read_bytes()[: a.stat().st_size * 2 // 3])
    report = diff(a, cut)
    assert 0 < report.steps < 160
    assert report.difference.field == "end"
    assert "the log ends after" in report.difference.b
    assert any("incomplete" in note for note in report.notes)


def test_other_numbers_of_environments(record):
    found = diff(record("a.mcap"), record("b.mcap", num_envs=4)).difference
    assert (found.field, found.a, found.b) == ("num_envs", 3, 4)


def test_the_command(record, capsys, tmp_path):
    a, b = record("a.mcap", steps=5), record("b.mcap", steps=5, seed=1)
    assert main(["diff", str(a), str(a)]) == 0
    assert "the same: 5 control steps, every bit" in capsys.readouterr().out
    assert main(["diff", str(a), str(b)]) == 1
    assert "step 0, environment 0, write body_mass[4]" in capsys.readouterr().out
    assert main(["diff", str(a), str(b), "--json"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert said["same"] is False
    assert said["difference"]["env"] == 0
    assert main(["diff", str(a), str(tmp_path / "none.mcap")]) == 2
    assert "does not exist" in capsys.readouterr().err


def test_a_log_without_states_cannot_be_compared(record):
    a = record("a.mcap", options=RecordOptions(state="none"))
    with pytest.raises(ConfigError, match="record.state=none"):
        diff(a, a)


def test_a_log_that_claims_to_have_all_states_is_refused(record, tmp_path):
    path = record(options=RecordOptions("keyframes", keyframe_every=5))

    def forge(name, values):
        return values | ({"state": "all", "keyframe_every": "0"} if "state" in values else {})

    with pytest.raises(LogError, match="a message is damaged: step 0 has no rows"):
        diff(path, rewrite(path, tmp_path / "forged.mcap", metadata=forge))

import json

import numpy as np
import pytest

from embodichain.cli import main
from embodichain.recording import RecordOptions, diff
from embodichain.recording.header import LogError
from embodichain.recording.schemas import message_class
from embodichain.utils.errors import ConfigError
from tests.recording.rewrite import rewrite


@pytest.fixture
def changed(record, tmp_path):
    """A log and a copy in which one message of step 6 is changed."""

    def make(topic, kind, change):
        path = record(steps=12)

        def message(found, data):
            if found != topic:
                return data
            decoded = message_class(kind).FromString(data)
            if decoded.step != 6 or make.done:
                return data
            make.done = True
            change(decoded)
            return decoded.SerializeToString(deterministic=True)

        make.done = False
        return path, rewrite(path, tmp_path / "changed.mcap", message=message)

    return make


def test_two_runs_alike_are_the_same(record):
    a = record("a.mcap", steps=15)
    b = record("b.mcap", steps=15, threads=2, options=RecordOptions(compression="zstd"))
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


def test_a_state_is_named_by_joint(changed):
    def nudge(message):  # environment 1, column 4 of its rows: time, then qpos
        at = message.width + 4
        nudge.values = message.state[at], np.nextafter(message.state[at], 9.0)
        message.state[at] = nudge.values[1]

    a, b = changed("/sim/state", "BatchedState", nudge)
    found = diff(a, b).difference
    assert (found.step, found.env, found.field, found.column) == (6, 1, "qpos", "cube/free.y")
    assert (found.a, found.b) == nudge.values
    assert diff(a, b).steps == 6


@pytest.mark.parametrize(
    ("kind", "change", "expected"),
    [
        ("reward", lambda m: m.reward.__setitem__(2, 7.0), (2, "reward", "", 7.0)),
        ("action", lambda m: m.action.__setitem__(3, 7.0), (1, "action", "1", 7.0)),
        (
            "truncated",
            lambda m: setattr(m, "truncated", bytes([0, 1 - m.truncated[1], 0])),
            None,
        ),
        ("hash", lambda m: m.hash.__setitem__(1, 0xAB), (1, "result of physics", "hash",
                                                         "00000000000000ab")),
    ],
)  # fmt: skip
def test_outcomes_are_named(changed, kind, change, expected):
    found = diff(*changed("/sim/step", "Step", change)).difference
    assert found.step == 6
    if expected is not None:
        assert (found.env, found.field, found.column, found.b) == expected
    else:
        assert found.field == "truncated"


def test_a_write_is_named_by_environment_and_column(changed):
    def nudge(message):
        assert message.field == "ctrl"
        message.values[5] += 1.0

    found = diff(*changed("/sim/write", "Write", nudge)).difference
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

    with pytest.raises(LogError, match="a message is damaged: rows have 0 columns"):
        diff(path, rewrite(path, tmp_path / "forged.mcap", metadata=forge))

import json
import shutil
import subprocess
import sys
from pathlib import Path

import mujoco
import pytest
import zstandard

import embodichain.recording as recording
from embodichain.cli import main
from embodichain.recording import inspect, verify
from embodichain.recording.format.attachments import MODEL as MODEL_FILE
from embodichain.recording.format.attachments import (
    cpu_name,
    load_mjb,
    model_bytes,
    model_digest,
    unpack_model,
)
from embodichain.recording.format.messages.schema import START_TOPIC
from embodichain.recording.format.options import RecordOptions
from embodichain.recording.read.playback import Playback, Span
from embodichain.utils.errors import ConfigError
from tests.recording.rewrite import rewrite
from tests.recording.runs import changed, flip, header_of
from tests.recording.scene import MODEL


@pytest.mark.parametrize(
    "case",
    [
        {},
        {"num_envs": 1},
        {"num_envs": 5, "threads": 2},
        {"settle": 25},
        {"settle": 4},  # as long as a control step's own physics
        {"push": True},  # rows become whole in the middle
        {"before": 4},  # starts with randomized masses
        {"before": 5, "push": True},  # starts with an applied force
    ],
    ids=str,
)
def test_a_log_verifies(record, case):
    report = verify(record(**case))
    assert report.ok, str(report)
    assert report.steps == case.get("steps", 20)
    assert report.envs == case.get("num_envs", 3)
    assert report.difference is None


def test_a_diverging_environment_verifies(record, poison):
    report = verify(record(env=poison))
    assert report.ok, str(report)
    assert list(Path.cwd().iterdir()) == []  # MuJoCo's warnings went to nobody's folder


def test_one_environment_and_one_episode(record):
    path = record(settle=6)
    assert verify(path, env=2).envs == 1
    for env in range(3):
        assert verify(path, env=env).ok
    # environment 0 has episodes of 7 steps, 1 of 8, 2 of 9
    assert verify(path, env=0, episode=1).steps == 7
    assert verify(path, env=2, episode=1).steps == 9
    assert verify(path, episode=1).steps == 18 - 7  # steps 7 to 17
    assert verify(path, env=1, episode=2).steps == 4  # cut by the end of the log
    assert verify(path, env=1, episode=2).ok


@pytest.mark.parametrize("arguments", [{"env": 3}, {"env": -1}, {"episode": 9}])
def test_what_is_not_in_the_log(record, arguments):
    with pytest.raises(ConfigError, match=r"there are 0 to 2"):
        verify(record(), **arguments)


@pytest.mark.parametrize(
    ("column", "bit", "field"), [(1, 0, "qpos[0]"), (3, 63, "qpos[2]"), (0, 7, "time[0]")]
)
def test_a_changed_bit_of_a_state_is_named(record, tmp_path, column, bit, field):
    change = flip((1, column), bit)
    path = changed(record(), tmp_path / "bad.mcap", 11, "physics", "rows", change)
    report = verify(path)
    assert not report.ok
    assert (report.difference.step, report.difference.env) == (11, 1)
    assert report.difference.field == field
    assert f"step 11, environment 1, {field}" in str(report)
    # other environments and episodes are none the worse
    assert verify(path, env=0).ok
    assert not verify(path, env=1).ok
    assert verify(path, env=1, episode=0).ok  # steps 0 to 7
    # the episode it is in
    assert verify(path, env=1, episode=1).difference.field == field


def test_a_changed_bit_where_an_episode_is_entered_shows(record, tmp_path):
    # step 8 is the first of environment 1's second episode; what the reset left is changed
    change = flip((0, 1), 40)
    path = changed(record(), tmp_path / "bad.mcap", 7, "write", "values", change, name="row")
    assert verify(path, env=1).difference.field == "qpos[0]"
    path = changed(record("b.mcap"), tmp_path / "c.mcap", 8, "physics", "rows", flip((1, 1), 40))
    difference = verify(path, env=1, episode=1).difference
    assert difference.step == 8
    assert verify(path, env=1).difference.field == "qpos[0]"


def test_another_model_differs_from_the_first_step(record, tmp_path):
    other = load_mjb(model_bytes(MODEL))
    other.actuator_gainprm[0, 0] *= 1 + 1e-12
    mjb = model_bytes(other)

    def metadata(name, values):
        return {**values, "model": model_digest(mjb)} if name == "embodichain" else values

    path = rewrite(
        record(),
        tmp_path / "bad.mcap",
        attachment=lambda name, data: zstandard.compress(mjb) if name == MODEL_FILE else data,
        metadata=metadata,
    )
    report = verify(path)
    assert not report.ok
    assert report.difference.step == 0
    assert report.difference.field.startswith(("qpos", "qvel", "qacc_warmstart"))


def test_a_swapped_attachment_is_not_the_recorded_model(record, tmp_path):
    def swapped(name, data):
        if name != MODEL_FILE:
            return data
        return zstandard.compress(unpack_model(data)[:-1] + b"\x5a")

    path = rewrite(record(), tmp_path / "bad.mcap", attachment=swapped)
    report = verify(path)
    assert not report.ok
    assert report.steps == 0
    problem = "the attachment model.mjb.zst is not the model that was recorded"
    assert report.problems == [problem]
    assert inspect(path).warnings == [problem]


def test_a_changed_write_is_named_by_what_it_moves(record, tmp_path):
    change = flip((2, 1), 62)
    bad = changed(record(), tmp_path / "bad.mcap", 5, "write", "values", change, name="ctrl")
    report = verify(bad)
    assert (report.difference.step, report.difference.env) == (5, 2)
    assert report.difference.field.startswith(("qpos", "qvel", "qacc"))


def test_a_changed_start_is_found(record, tmp_path):
    options = RecordOptions("keyframes", keyframe_every=8)
    column = header_of(path := record(options=options)).layout["mocap_pos"][0]
    change = flip((2, column))
    bad = changed(path, tmp_path / "bad.mcap", 8, "start", "row", change, START_TOPIC)
    report = verify(bad)
    assert (report.difference.step, report.difference.env) == (8, 2)
    assert report.difference.field == "mocap_pos[0]"  # a marker, which moves nothing


def test_a_changed_hash_is_found(record, tmp_path):
    path = record(options=RecordOptions("keyframes"))
    bad = changed(path, tmp_path / "bad.mcap", 4, "physics", "hashes", flip(2))
    difference = verify(bad).difference
    assert (difference.step, difference.env, difference.field) == (4, 2, "hash")


@pytest.mark.parametrize("topic", ["/sim/start", "/sim/steps"])
def test_a_message_that_is_no_message(record, tmp_path, topic):
    def message(this, data):
        return data[: len(data) - 3] if this == topic else data

    report = verify(rewrite(record(settle=3), tmp_path / "bad.mcap", message=message))
    assert not report.ok
    assert report.difference is not None or report.problems


def test_a_cut_file_says_where_it_ends(record, tmp_path):
    path = record(steps=150, options=RecordOptions(compression="none"), num_envs=100)
    cut = tmp_path / "cut.mcap"
    data = path.read_bytes()
    cut.write_bytes(data[: len(data) * 2 // 3])
    report = verify(cut)
    assert not report.ok
    assert 10 < report.steps < 150
    assert report.problems == [
        f"the log ends after step {report.steps - 1}: "
        "the file ends early: it was not closed, or cut"
    ]


def test_a_flipped_byte_breaks_a_checksum(record, tmp_path):
    data = bytearray(record(options=RecordOptions(compression="none")).read_bytes())
    at = data.rindex(b"mocap_pos") + 40
    data[at] ^= 1
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(data)
    report = verify(bad)
    assert not report.ok
    assert "a chunk is damaged: its checksum is wrong" in report.problems[0]


def test_another_mujoco_is_approximate_and_says_so(record, tmp_path):
    def metadata(name, values):
        return {**values, "mujoco_version": "4.9.9"} if name == "embodichain" else values

    report = verify(rewrite(record(), tmp_path / "other.mcap", metadata=metadata))
    assert not report.ok
    assert report.steps == 20
    assert report.difference is None
    assert "bit-exact replay needs mujoco==4.9.9" in report.problems[0]
    assert 0 <= report.largest_error["qpos"] < 1e-3
    assert "approximate only" in str(report)


def test_a_log_without_states_cannot_be_verified(record):
    report = verify(record(options=RecordOptions(state="none")))
    assert not report.ok
    assert report.problems == ["no states were recorded (record.state: none)"]


@pytest.mark.parametrize("option", ['<flag sleep="enable"/>'], ids=["sleep"])
def test_models_that_hide_state_are_marked(record, option):
    xml = mujoco.MjSpec.from_string(
        f"<mujoco><option>{option}</option><worldbody><body><freejoint/><geom size='.1'/></body>"
        "</worldbody></mujoco>"
    )
    from embodichain.recording.format.header import why_unverifiable

    assert "sleep" in why_unverifiable(xml.compile(), "all")
    assert why_unverifiable(MODEL, "all") == ""


@pytest.mark.unmeasured
def test_verifies_in_another_process_from_an_empty_folder(record, tmp_path):
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    path = shutil.copy(record(settle=2), tmp_path / "moved.mcap")
    code = f"from embodichain.recording import verify; print(verify({str(path)!r}).ok)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.stdout == "True\n", done.stderr
    assert list(folder.iterdir()) == []


def test_the_number_of_threads_does_not_matter(record):
    path = record(num_envs=4)
    assert verify(path, num_threads=1).ok
    assert verify(path, num_threads=3).ok


def test_progress_is_told(record):
    steps = []
    verify(record(), progress=steps.append)
    assert steps == list(range(1, 21))


def test_what_is_another_here_is_said_where_physics_differs(record, tmp_path):
    def attachment(name, data):
        if name != "versions.json":
            return data
        versions = json.loads(data)
        assert versions["cpu"] == cpu_name() != ""
        return json.dumps(versions | {"cpu": "Abacus 9000"}).encode()

    whole = record()
    elsewhere = rewrite(whole, tmp_path / "elsewhere.mcap", attachment=attachment)
    assert verify(elsewhere).ok  # a name alone is no difference
    difference = 5, "physics", "rows", flip((1, 3), 2)
    report = verify(changed(elsewhere, tmp_path / "bad.mcap", *difference))
    assert not report.ok
    assert report.notes[0] == f"processor Abacus 9000 there, {cpu_name()} here"
    assert "can be played all the same" in report.notes[1]
    assert report.notes[1] in str(report)
    same = verify(changed(whole, tmp_path / "changed.mcap", *difference))
    assert "the file was changed" in same.notes[0]


def test_another_mujoco_says_what_can_be_played(record, tmp_path, capsys):
    def metadata(name, values):
        return {**values, "mujoco_version": "4.9.9"} if name == "embodichain" else values

    path = rewrite(record(), tmp_path / "other.mcap", metadata=metadata)
    assert main(["replay", str(path), "--verify"]) == 1
    said = capsys.readouterr().err
    assert f"MuJoCo 4.9.9 there, {mujoco.__version__} here" in said
    assert "its recorded states can be played all the same" in said
    with recording.open(path) as log:  # and they can
        assert list(Playback(log, 2).steps(Span(3, 6))) == [3, 4, 5, 6]
    few = record("few.mcap", options=RecordOptions(state="keyframes", keyframe_every=5))
    report = verify(rewrite(few, tmp_path / "few_other.mcap", metadata=metadata))
    assert "every 5th state" in report.notes[-1]
    assert "need mujoco==4.9.9" in report.notes[-1]

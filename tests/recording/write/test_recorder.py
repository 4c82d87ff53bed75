import json
import subprocess
import sys

import mujoco
import numpy as np
import pytest
import yaml

from embodichain import recording
from embodichain.lab.gym.envs.observers import EventRecord
from embodichain.recording import McapRecorder, inspect, verify
from embodichain.recording.format.attachments import MODEL as MODEL_FILE
from embodichain.recording.format.attachments import load_mjb, unpack_model
from embodichain.recording.format.container.archive import load_mjz
from embodichain.recording.format.messages.columns import Moved
from embodichain.recording.format.messages.schema import STEPS_TOPIC
from embodichain.recording.format.options import RecordOptions
from embodichain.recording.write import recorder, step_buffer
from embodichain.utils.errors import ConfigError
from tests.recording.runs import calls, header_of, messages, runs, starts, unpack
from tests.recording.scene import MODEL, XML, SmallEnv


def test_recording_changes_nothing(tmp_path):
    def run(recorded):
        env = SmallEnv(settle=5, push=True)
        if recorded:
            options = RecordOptions(view_envs=(0, 1, 2), view_hz=1000)
            env.add_observer(McapRecorder(tmp_path / "log.mcap", env, options=options))
        env.reset()
        rows = []
        for _ in range(20):
            env.step()
            rows.append(env.sim.engine.rows.tobytes())
        env.close()
        return rows

    assert run(recorded=True) == run(recorded=False)


class _Watcher:
    """Remembers the rows around each physics call."""

    def __init__(self, engine):
        self.before, self.after = [], []
        engine.listeners.append(self)

    def on_physics(self, event):
        ids = slice(None) if event.env_ids is None else event.env_ids
        where = self.before if event.phase == "before" else self.after
        where.append(event.rows[ids].copy())

    def on_write(self, write): ...


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_rows_are_those_that_physics_returned(tmp_path, compression):
    env = SmallEnv(settle=3)
    options = RecordOptions(compression=compression)
    env.add_observer(McapRecorder(tmp_path / "log.mcap", env, options=options))
    seen = _Watcher(env.sim.engine)
    env.reset()
    for _ in range(10):
        env.step()
    env.close()
    moved = header_of(tmp_path / "log.mcap").moved
    found = calls(tmp_path / "log.mcap", "physics")
    assert [step for step, kind, _ in found if kind.nstep == 4] == list(range(10))
    assert len(found) == len(seen.after)
    for (_, _, arrays), rows in zip(found, seen.after, strict=True):
        assert arrays["rows"].tobytes() == Moved(moved).take(rows).tobytes()


def test_a_start_has_the_whole_rows_and_the_randomized_fields(tmp_path):
    env = SmallEnv()
    env.reset()
    rows = env.sim.engine.rows.copy()
    mass = env.sim.engine.model_field("body_mass").copy()
    env.add_observer(McapRecorder(tmp_path / "log.mcap", env))
    env.step()
    env.close()
    (step, row, fields), *_ = starts(tmp_path / "log.mcap")
    assert step == 0
    assert row.tobytes() == rows.tobytes()
    assert fields["body_mass"].tobytes() == mass.tobytes()


def test_starts_come_again_and_say_what_the_simulation_is(tmp_path, monkeypatch):
    # Small enough to be reached within a few steps.
    monkeypatch.setattr(recorder, "START_SHARE", 2)
    monkeypatch.setattr(step_buffer, "MOST_STEPS", 7)
    env = SmallEnv()
    env.add_observer(McapRecorder(tmp_path / "log.mcap", env))
    env.reset()
    rows = []
    for _ in range(60):
        rows.append(env.sim.engine.rows.copy())
        env.step()
    env.close()
    found = starts(tmp_path / "log.mcap")
    assert len(found) > 3
    for step, row, fields in found[1:]:
        assert row.tobytes() == rows[step].tobytes()
        assert fields["body_mass"].shape == (3, MODEL.nbody)
    assert verify(tmp_path / "log.mcap").ok


def test_steps_hold_what_went_in_and_came_out(record):
    path = record(steps=12)
    found = calls(path, "step")
    assert [step for step, _, _ in found] == list(range(12))
    steps = [arrays for _, _, arrays in found]
    done = np.array([s["truncated"] for s in steps])
    assert np.argwhere(done).tolist() == [[6, 0], [7, 1], [8, 2]]
    episodes = [s["episode_ids"].tolist() for s in steps[6:9]]
    assert episodes == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    env = SmallEnv()
    env.reset()
    env.step()
    assert steps[0]["reward"].tolist() == pytest.approx(
        -np.abs(env.sim.engine.state("qpos")[:, :2]).sum(1)
    )


def test_steps_with_the_same_calls_are_one_message(record):
    found = runs(record(steps=30, num_envs=1, length=10))
    assert sum(run.steps for run in found) == 30
    # Of each episode the first step, which has the reset, those between, and the last.
    assert [(run.first, run.count) for run in found if run.steps][:4] == [
        (0, 1), (1, 8), (9, 1), (10, 9),
    ]  # fmt: skip


def test_flush_brings_everything_into_the_file(tmp_path):
    path = tmp_path / "log.mcap"
    env = SmallEnv()
    recorder = McapRecorder(path, env)
    env.add_observer(recorder)
    env.reset()
    for made in (1, 2, 3):
        env.step()
        recorder.flush()
        assert inspect(path).steps == made
    recorder.close()
    size = path.stat().st_size
    recorder.flush()  # nothing is left to write
    assert path.stat().st_size == size
    assert verify(path).ok


def test_every_write_is_there(record):
    path = record(steps=8)
    writes = calls(path, "write")
    assert [(kind.mode, kind.name) for _, kind, _ in writes[:7]] == [
        ("reset", "row"),
        ("model", "body_mass"),
        ("set_const", ""),
        ("state", "qpos"),
        ("state", "ctrl"),
        ("state", "mocap_pos"),
        ("state", "ctrl"),
    ]
    _, kind, arrays = writes[5]
    assert kind.columns == (3, 4, 5)
    assert list(arrays) == ["values"]
    assert arrays["values"].shape == (3, 3)
    step, kind, arrays = [write for write in writes if write[1].mode == "reset"][1]
    assert (step, arrays["env_ids"].tolist()) == (6, [0])
    default = SmallEnv().sim.engine.rows[0]
    assert arrays["values"].tobytes() == default.tobytes()


def test_log_time_is_start_plus_steps(many_chunks):
    path = many_chunks()
    start, found = inspect(path).header.start_ns, messages(path, STEPS_TOPIC)
    assert len(found) > 10
    for time, data in found:
        assert time == start + unpack(header_of(path), data)[0].first * 20_000_000
    assert start > 1_700_000_000_000_000_000


def test_unusual_arrays_are_recorded_as_they_were(tmp_path):
    env = SmallEnv()
    log = McapRecorder(tmp_path / "log.mcap", env)
    env.add_observer(log)
    grid = np.arange(12.0).reshape(3, 4)
    drawn = {
        "turned": grid.T[:3],
        "every_other": grid[:, ::2],
        "small": np.arange(3, dtype=np.int16),
        "flags": np.array([True, False, True]),
        "half": np.arange(3, dtype=np.float16),
        "none": np.empty((3, 0)),
        "any": np.array([1, 2, 3], dtype=object),
        "list": grid.tolist(),
    }
    log.on_event(env, EventRecord("odd", "interval", None, drawn))
    env.close()
    with recording.open(tmp_path / "log.mcap") as found:
        (event,) = (event for event in found.events() if event.term == "odd")
    assert {name: array.tolist() for name, array in event.drawn.items()} == {
        name: np.asarray(array, float).tolist() for name, array in drawn.items()
    }


def test_what_is_recorded_may_change_afterwards(tmp_path):
    """Actions and draws are copied when they are reported."""
    env = SmallEnv()
    log = McapRecorder(tmp_path / "log.mcap", env)
    env.add_observer(log)
    env.reset()
    drawn = np.zeros(3)
    for step in range(5):
        drawn[:] = step
        log.on_event(env, EventRecord("same", "interval", None, {"x": drawn}))
        env.step()
    drawn[:] = -1
    env.close()
    with recording.open(tmp_path / "log.mcap") as found:
        events = [event for event in found.events() if event.term == "same"]
    assert [event.drawn["x"].tolist() for event in events] == [[k] * 3 for k in range(5)]


def test_attachments_come_first_and_load(record):
    from mcap.records import Attachment, Chunk, Metadata
    from mcap.stream_reader import StreamReader

    path = record()
    with path.open("rb") as stream:
        records = [
            r
            for r in StreamReader(stream, emit_chunks=True).records
            if isinstance(r, Attachment | Chunk | Metadata)
        ]
    assert [r.name for r in records[:7]] == [
        "model.mjb.zst",
        "scene.mjz",
        "config.yaml",
        "overrides.yaml",
        "foxglove_layout.json",
        "versions.json",
        "embodichain",
    ]
    found = {r.name: r.data for r in records[:6]}
    assert load_mjb(unpack_model(found[MODEL_FILE])).nbody == MODEL.nbody
    archived = load_mjz(found["scene.mjz"])
    assert archived.nq == MODEL.nq
    assert np.allclose(archived.geom_size, MODEL.geom_size, atol=1e-5)
    assert found["config.yaml"] == b"seed: 0\n"
    assert yaml.safe_load(found["overrides.yaml"]) == ["seed=0"]
    assert json.loads(found["versions.json"])["mujoco"] == mujoco.__version__
    layout = path.with_name("foxglove_layout.json")
    assert json.loads(layout.read_text()) == json.loads(found["foxglove_layout.json"])


def test_the_header_says_what_it_takes_to_read_rows(record):
    header = inspect(record(num_envs=2)).header
    assert (header.task, header.seed, header.num_envs) == ("small", 0, 2)
    assert (header.control_dt, header.physics_dt, header.substeps) == (0.02, 0.005, 4)
    integration = int(mujoco.mjtState.mjSTATE_INTEGRATION)
    assert header.nstate == mujoco.mj_stateSize(MODEL, integration)
    assert header.moved_width == header.nstate - MODEL.nu - 7 * MODEL.nmocap - MODEL.nv - (
        6 * MODEL.nbody
    )
    assert header.layout["qpos"] == (1, 1 + MODEL.nq)
    assert header.unverifiable == ""


def test_a_summary_counts_episodes_and_rewards(record):
    path = record(steps=20)
    summary = inspect(path)
    assert summary.complete
    assert summary.warnings == []
    assert summary.steps == 20
    assert summary.duration_s == pytest.approx(0.4)
    assert [(e.env, e.episode, e.steps) for e in summary.episodes] == [
        (0, 0, 7), (1, 0, 8), (2, 0, 9), (0, 1, 7), (1, 1, 8), (2, 1, 9),
    ]  # fmt: skip
    first = sum(arrays["reward"][0] for _, _, arrays in calls(path, "step")[:7])
    assert summary.episodes[0].total_reward == pytest.approx(first)
    assert not summary.episodes[0].terminated
    counts = {c.topic: c.messages for c in summary.channels}
    assert counts["/sim/steps"] == len(messages(path, STEPS_TOPIC))
    assert summary.messages == sum(counts.values())


def test_an_existing_file_is_never_overwritten(record):
    path = record(steps=1)
    before = path.read_bytes()
    with pytest.raises(FileExistsError):
        record(steps=1)
    assert path.read_bytes() == before


def test_closing_twice_is_closing_once(tmp_path):
    env = SmallEnv()
    recorder = McapRecorder(tmp_path / "log.mcap", env)
    env.add_observer(recorder)
    env.reset()
    env.step()
    recorder.close()
    data = (tmp_path / "log.mcap").read_bytes()
    recorder.close()
    env.close()
    assert (tmp_path / "log.mcap").read_bytes() == data
    assert recorder.stats.nbytes == len(data)
    assert recorder.stats.steps == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"state": "al"},
            "record.state: 'al' is not one of all, keyframes, none. Did you mean 'all'?",
        ),
        ({"keyframe_every": 0}, "record.keyframe_every: 0 must be at least 1"),
        ({"max_mb": 0}, "record.max_mb: 0 must be positive"),
        (
            {"compression": "lz5"},
            "record.compression: 'lz5' is not one of zstd, lz4, none. Did you mean 'lz4'?",
        ),
        ({"view_hz": 0}, "record.view_hz: 0 must be positive (1/s, simulated)"),
        (
            {"view_envs": [0, 3, -1]},
            "record.view_envs: [3, -1] do not exist: there are environments 0 to 2",
        ),
    ],
)
def test_wrong_options(tmp_path, options, message):
    with pytest.raises(ConfigError) as error:
        McapRecorder(tmp_path / "log.mcap", SmallEnv(), options=RecordOptions(**options))
    assert str(error.value) == message
    assert not (tmp_path / "log.mcap").exists()


def test_all_wrong_options_are_listed(tmp_path):
    options = RecordOptions(state="x", compression="y", view_hz=-1, view_envs=[9])
    with pytest.raises(ConfigError) as error:
        McapRecorder(tmp_path / "log.mcap", SmallEnv(), options=options)
    assert len(error.value.problems) == 4


def test_a_program_that_forgets_to_close_leaves_a_whole_log(tmp_path):
    code = """
import sys
import embodichain, torch
from embodichain.recording import McapRecorder
env = embodichain.make("random_reach", num_envs=2)
env.add_observer(McapRecorder(sys.argv[1], env))
env.reset()
for _ in range(3):
    env.step(torch.zeros(2, 6))
raise RuntimeError("the program fails")
"""
    path = tmp_path / "rollout.mcap"
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 1 and "the program fails" in done.stderr
    assert verify(path).ok
    assert inspect(path).complete


def received(path):
    """(step, rows) that physics receives, from starts and writes and what physics returned."""
    header = header_of(path)
    layout, everyone = header.slices(), np.arange(header.num_envs)
    begins = dict((step, row) for step, row, _ in starts(path))
    moved = np.concatenate([np.r_[a:b] for a, b in header.moved])
    rows, found = None, []
    for step, kind, arrays in calls(path):
        if step in begins:
            row = begins.pop(step)
            assert rows is None or step != found[-1][0] + 1 or row.tobytes() == rows.tobytes()
            rows = row.copy()
        ids = arrays.get("env_ids", everyone)
        if kind.kind == "physics":
            found.append((step, rows[ids].copy()))
            rows[np.ix_(ids, moved)] = arrays["rows"]
        elif kind.kind == "write" and kind.mode in ("state", "reset"):
            columns = np.r_[: header.nstate] if kind.name == "row" else np.r_[layout[kind.name]]
            if kind.columns is not None:
                columns = columns[list(kind.columns)]
            rows[np.ix_(ids, columns)] = arrays["values"]
    return found, rows


@pytest.mark.parametrize("options", [{}, {"every": 2}])
@pytest.mark.parametrize("settle", [0, 3])
@pytest.mark.parametrize("push", [False, True])
def test_rows_that_physics_received_follow_from_what_is_recorded(tmp_path, options, settle, push):
    env = SmallEnv(settle=settle, push=push)
    env.add_observer(
        McapRecorder(tmp_path / "log.mcap", env, options=RecordOptions(view_envs=[], **options))
    )
    seen = _Watcher(env.sim.engine)
    env.reset()
    for step in range(40):
        if step == 13:
            env.reset(np.array([1]))
        env.sim.engine.write("qvel", 0.1 * step, np.array([0, 2]), np.array([1, 0]))
        env.step()
    last = env.sim.engine.rows.copy()
    env.close()
    assert verify(tmp_path / "log.mcap").ok
    found, rows = received(tmp_path / "log.mcap")
    if not options:
        assert rows.tobytes() == last.tobytes()
        assert [r.tobytes() for _, r in found] == [r.tobytes() for r in seen.before]
    else:
        every = {r.tobytes() for r in seen.before}
        assert 15 < len(found) < len(seen.before)
        assert all(r.tobytes() in every for _, r in found)


@pytest.mark.parametrize("autoreset", ["enable", "disable"])
def test_rows_of_environments_that_diverge_follow_as_well(tmp_path, autoreset):
    """MuJoCo's own reset writes columns that physics only reads otherwise."""
    flag = f'autoreset="{autoreset}"'
    model = mujoco.MjModel.from_xml_string(XML.replace('autoreset="disable"', flag))
    env = SmallEnv(model=model)
    env.add_observer(McapRecorder(tmp_path / "log.mcap", env, options=RecordOptions(view_envs=[])))
    seen = _Watcher(env.sim.engine)
    env.reset()
    for step in range(12):
        if step == 4:
            env.sim.engine.write("qvel", 1e200, np.array([1]), np.array([0]))
        env.step()
    env.close()
    assert verify(tmp_path / "log.mcap").ok
    found, _ = received(tmp_path / "log.mcap")
    assert [r.tobytes() for _, r in found] == [r.tobytes() for r in seen.before]

import json
import subprocess
import sys
from contextlib import suppress

import mujoco
import numpy as np
import pytest
import yaml
from mcap.reader import make_reader

from embodichain import recording
from embodichain.lab.sim.engine.layout import row_layout
from embodichain.recording import McapRecorder, inspect, verify
from embodichain.recording.archive import load_mjz
from embodichain.recording.attachments import load_mjb
from embodichain.recording.columns import RowColumns
from embodichain.recording.messages import State, StepOutcome, WriteRecord
from embodichain.recording.options import RecordOptions
from embodichain.utils.errors import ConfigError
from tests.recording.scene import MODEL, XML, SmallEnv


def messages(path, topic):
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        return [(m.log_time, m.data) for _, _, m in reader.iter_messages(topics=[topic])]


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


def test_rows_are_those_that_physics_receives(tmp_path):
    env = SmallEnv()
    seen = []

    class Watcher:
        def on_physics(self, event):
            if event.phase == "before":
                seen.append(event.rows.copy())

        def on_write(self, write): ...

    recorder = McapRecorder(tmp_path / "log.mcap", env, options=RecordOptions(compression="zstd"))
    env.add_observer(recorder)
    env.sim.engine.listeners.append(Watcher())
    env.reset()
    for _ in range(10):
        env.step()
    seen.append(env.sim.engine.rows.copy())
    recorder.close()
    inputs = np.zeros(seen[0].shape[1], bool)
    for name in ("ctrl", "mocap_pos", "mocap_quat", "eq_active", "userdata"):
        with suppress(KeyError):
            inputs[env.sim.engine.component(name)] = True
    applied = np.zeros_like(inputs)
    for name in ("qfrc_applied", "xfrc_applied"):
        applied[env.sim.engine.component(name)] = True
    found = [State.decode(data) for _, data in messages(tmp_path / "log.mcap", "/sim/state")]
    assert [s.step for s in found] == list(range(11))
    assert [s.nstep for s in found] == [4] * 10 + [0]
    kept = [~applied & ~inputs] * 11
    kept[0] = kept[-1] = ~applied  # the first state and the last
    for number in (7, 8, 9):  # and those after a reset
        kept[number] = ~applied
    for state, rows, columns in zip(found, seen, kept, strict=True):
        assert state.rows.tobytes() == rows[:, columns].tobytes()


def test_steps_hold_what_went_in_and_came_out(tmp_path, record):
    path = record(steps=12)
    steps = [StepOutcome.decode(data) for _, data in messages(path, "/sim/step")]
    assert [s.step for s in steps] == list(range(12))
    done = np.array([s.truncated for s in steps])
    assert np.argwhere(done).tolist() == [[6, 0], [7, 1], [8, 2]]
    assert [s.episode_ids.tolist() for s in steps[6:9]] == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    env = SmallEnv()
    env.reset()
    env.step()
    assert steps[0].reward.tolist() == pytest.approx(
        -np.abs(env.sim.engine.state("qpos")[:, :2]).sum(1)
    )


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


def test_every_write_is_there(tmp_path, record):
    path = record(steps=8)
    writes = [WriteRecord.decode(data) for _, data in messages(path, "/sim/write")]
    assert [(w.op, w.field) for w in writes[:8]] == [
        ("state", "row"),  # what the simulation was
        ("reset", "row"),
        ("model", "body_mass"),
        ("set_const", ""),
        ("state", "qpos"),
        ("state", "ctrl"),
        ("state", "mocap_pos"),
        ("state", "ctrl"),
    ]
    goal = writes[6]
    assert goal.columns.tolist() == [3, 4, 5]
    assert goal.env_ids is None
    assert goal.values.size == 9
    again = [w for w in writes if w.op == "reset"][1]
    assert (again.step, again.env_ids.tolist()) == (6, [0])


def test_log_time_is_start_plus_steps(record):
    path = record(steps=10)
    start = inspect(path).header.start_ns
    times = [time for time, _ in messages(path, "/sim/state")]
    assert times == [start + step * 20_000_000 for step in range(11)]
    assert start > 1_700_000_000_000_000_000


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
        "model.mjb",
        "scene.mjz",
        "config.yaml",
        "overrides.yaml",
        "foxglove_layout.json",
        "versions.json",
        "embodichain",
    ]
    found = {r.name: r.data for r in records[:6]}
    assert load_mjb(found["model.mjb"]).nbody == MODEL.nbody
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
    assert header.state_sig == int(mujoco.mjtState.mjSTATE_INTEGRATION)
    assert header.nstate == mujoco.mj_stateSize(MODEL, header.state_sig)
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
    steps = [StepOutcome.decode(data) for _, data in messages(path, "/sim/step")]
    first = sum(s.reward[0] for s in steps[:7])
    assert summary.episodes[0].total_reward == pytest.approx(first)
    assert not summary.episodes[0].terminated
    counts = {c.topic: c.messages for c in summary.channels}
    assert counts["/sim/state"] == 21
    assert counts["/sim/step"] == 20
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
            "record.compression: 'lz5' is not one of zstd-fast, lz4, zstd, none. "
            "Did you mean 'lz4'?",
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


class _Looking(McapRecorder):
    """Remembers the rows that physics received."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.received = []

    def on_physics(self, env, event):
        if event.phase == "before" and self._gate.open:
            ids = slice(None) if event.env_ids is None else event.env_ids
            self.received.append(event.rows[ids].copy())
        super().on_physics(env, event)


@pytest.mark.parametrize("options", [{}, {"every": 2}, {"max_mb": 0.2}])
@pytest.mark.parametrize("settle", [0, 3])
@pytest.mark.parametrize("push", [False, True])
def test_rows_that_nobody_copied_are_those_that_physics_received(tmp_path, options, settle, push):
    env = SmallEnv(settle=settle, push=push)
    options = RecordOptions(view_envs=[], **options)
    recorder = _Looking(tmp_path / "log.mcap", env, options=options)
    env.add_observer(recorder)
    env.reset()
    for step in range(40):
        if step == 13:
            env.reset(np.array([1]))
        env.sim.engine.write("qvel", 0.1 * step, np.array([0, 2]), np.array([1, 0]))
        env.step()
    received = [*recorder.received, env.sim.engine.rows.copy()]
    gate_open = recorder._gate.open
    env.close()
    _assert_received(tmp_path / "log.mcap", env, received[: None if gate_open else -1])


@pytest.mark.parametrize("autoreset", ["enable", "disable"])
def test_rows_of_environments_that_diverge_are_those_that_physics_received(tmp_path, autoreset):
    flag = f'autoreset="{autoreset}"'
    model = mujoco.MjModel.from_xml_string(XML.replace('autoreset="disable"', flag))
    env = SmallEnv(model=model)
    recorder = _Looking(tmp_path / "log.mcap", env, options=RecordOptions(view_envs=[]))
    env.add_observer(recorder)
    env.reset()
    for step in range(12):
        if step == 4:
            env.sim.engine.write("qvel", 1e200, np.array([1]), np.array([0]))
        env.step()
    assert env.sim.engine.rows[0].any()
    received = [*recorder.received, env.sim.engine.rows.copy()]
    env.close()
    _assert_received(tmp_path / "log.mcap", env, received)


def _assert_received(path, env, received):
    """The log verifies, and its states are these rows, bit for bit."""
    assert verify(path).ok
    with recording.open(path) as log:
        raw, states = (
            [State.decode(data) for topic, _, data in messages if topic == "/sim/state"]
            for messages in (log.raw_messages(), log.full_messages())
        )
        for state, full in zip(raw, states, strict=True):
            places = np.concatenate(
                [np.r_[a:b] for a, b in log.header.ranges_of(full.rows.shape[1])]
            )
            kept = np.concatenate(
                [np.r_[a:b] for a, b in log.header.ranges_of(state.rows.shape[1])]
            )
            assert state.rows.tobytes() == full.rows[:, np.isin(places, kept)].tobytes()
    whole = env.sim.engine.rows.shape[1]
    assert len(states) == len(received)
    for state, rows in zip(states, received, strict=True):
        kept = rows
        if state.rows.shape[1] < whole:
            kept = np.empty(state.rows.shape)
            RowColumns(row_layout(env.sim.engine.model)).take(rows, kept)
        assert state.rows.tobytes() == kept.tobytes()

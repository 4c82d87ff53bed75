import builtins
import json
import math
import struct
import subprocess
import sys

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import embodichain.recording as recording
from embodichain.recording import RecordOptions
from embodichain.recording.format.log_error import LogError
from embodichain.recording.format.messages.block import ArrayKind, pack_steps
from embodichain.utils.errors import ConfigError
from tests.recording.rewrite import rewrite
from tests.recording.runs import header_of, recorded_steps, unpack
from tests.recording.scene import MODEL


def decoded(path, topic):
    """Messages of a topic as somebody else's library reads them."""
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        found = reader.iter_decoded_messages(topics=[topic], log_time_order=False)
        return [message for *_, message in found]


def calls_of(path):
    """(step, call, its arrays) in order, of the first start and the runs, by that library alone."""
    for message in [*decoded(path, "/sim/start")[:1], *decoded(path, "/sim/steps")]:
        for t in range(message.count):
            for call in message.calls:
                arrays = {}
                if call.steps and t not in call.steps:
                    continue
                number = list(call.steps).index(t) if call.steps else t
                for array in call.arrays:
                    size = math.prod(array.shape)
                    nbytes = size * np.dtype(array.dtype).itemsize
                    found = np.frombuffer(
                        message.data, array.dtype, size, array.offset + number * nbytes
                    )
                    arrays[array.name] = found.reshape(tuple(array.shape))
                yield message.first + t, call, arrays


def rows_of_steps(path, layout, moved):
    """Whole rows that the physics of each control step received, (T, N, nstate)."""
    rows, now = [], None
    for _, call, arrays in calls_of(path):
        envs = arrays.get("env_ids", slice(None))
        if call.kind == "start":
            now = arrays["row"].copy()
        elif call.kind == "physics":
            if call.nstep == 4:
                rows.append(now.copy())
            everyone = np.arange(len(now)) if isinstance(envs, slice) else envs
            now[np.ix_(everyone, moved)] = arrays["rows"]
        elif call.kind == "write" and call.mode == "reset":
            now[envs] = arrays["values"]
        elif call.kind == "write" and call.mode == "state":
            a, b = layout[call.name]
            columns = np.arange(a, b)
            if call.some_columns:
                columns = columns[list(call.columns)]
            everyone = np.arange(len(now)) if isinstance(envs, slice) else envs
            now[np.ix_(everyone, columns)] = arrays["values"]
    return np.stack(rows)


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_arrays_are_what_another_library_reads(record, compression):
    path = record(steps=25, settle=3, options=RecordOptions(compression=compression))
    steps = [arrays for _, call, arrays in calls_of(path) if call.kind == "step"]
    with recording.open(path) as log:
        data = log.read()
        moved = np.concatenate([np.arange(a, b) for a, b in log.header.moved])
        rows = rows_of_steps(path, log.header.layout, moved)
        for name in ("qpos", "qvel", "ctrl", "mocap_pos", "mocap_quat"):
            a, b = log.header.layout[name]
            assert np.array_equal(data[name], rows[..., a:b]), name
        assert log.complete
        assert not log.warnings
    assert data["rewards"].tolist() == [s["reward"].tolist() for s in steps]
    assert data["actions"].tolist() == [s["action"].tolist() for s in steps]
    assert data["truncated"].tolist() == [s["truncated"].tolist() for s in steps]
    assert data["terminated"].tolist() == [s["terminated"].tolist() for s in steps]
    assert data["episodes"].tolist() == [s["episode_ids"].tolist() for s in steps]
    assert data.steps.tolist() == list(range(25))
    assert data.time[-1] == pytest.approx(24 * 0.02)


@pytest.mark.parametrize("simulate", [False, True])
@pytest.mark.parametrize("state", ["all", "keyframes"])
def test_a_part_begins_with_the_inputs_of_the_chunks_before_it(many_chunks, state, simulate):
    fields = ["ctrl", "mocap_pos", "qpos", "rewards"]
    with recording.open(many_chunks("all")) as log:
        whole = log.read(fields)
    assert not np.array_equal(whole["mocap_pos"][30], whole["mocap_pos"][29])
    with recording.open(many_chunks(state), simulate) as log:
        assert len(log.reader.chunks) > 10
        for start in range(119):
            part = log.read(fields, start=start, stop=start + 4)
            if state == "all" or simulate:
                assert part.steps.tolist() == list(range(start, min(start + 4, 120)))
            for name in fields:
                assert np.array_equal(part[name], whole[name][part.steps]), (name, start)
        parts = [*log.parts(fields, steps=10)]
        steps = np.concatenate([part.steps for part in parts])
        joined = np.concatenate([part["ctrl"] for part in parts])
    assert np.array_equal(joined, whole["ctrl"][steps])


def test_columns_have_names_and_units(record):
    with recording.open(record()) as log:
        assert [f"{c.name} [{c.unit}]" for c in log.columns["qpos"][:4]] == [
            *("arm/shoulder [rad]", "arm/elbow [rad]", "cube/free.x [m]", "cube/free.y [m]")
        ]
        assert log.columns["qvel"][-1] == ("cube/free.wz", "rad/s")
        assert log.columns["ctrl"] == [("arm/shoulder", "rad"), ("arm/elbow", "rad")]
        assert log.columns["mocap_pos"][3] == ("goal.x", "m")
        assert log.columns["xfrc_applied"][-1] == ("hidden.tz", "N m")
        data = log.read(["qpos", "ctrl", "rewards"])
    assert data.names("qpos")[2] == "cube/free.x"
    assert [c.name for c, _ in data.flat()][:5] == ["step", "time", "env", "qpos/arm/shoulder",
                                                     "qpos/arm/elbow"]  # fmt: skip


def test_what_was_recorded(record):
    with recording.open(record(seed=4)) as log:
        assert (log.task, log.seed, log.num_envs, log.dt) == ("small", 4, 3, 0.02)
        assert log.config == {"seed": 0}
        assert log.config_yaml == "seed: 0\n"
        assert log.versions["numpy"] == np.__version__
        assert "model.mjb.zst" in log.attachments
        assert np.array_equal(log.model.body_mass, MODEL.body_mass)


def test_a_damaged_config_is_an_error(record, tmp_path):
    def spoiled(name, data):
        return b"seed\xff" if name == "config.yaml" else data

    with recording.open(rewrite(record(), tmp_path / "bad.mcap", attachment=spoiled)) as log:
        with pytest.raises(LogError, match=r"config\.yaml is damaged"):
            log.config_yaml  # noqa: B018
        with pytest.raises(LogError, match=r"config\.yaml is damaged"):
            log.config  # noqa: B018


def test_slices_are_parts_of_the_whole(record):
    path = record(steps=30)
    with recording.open(path) as log:
        whole = log.read()
        part = log.read("qvel", env=[0, 2], start=5, stop=12)
        assert np.array_equal(part["qvel"], whole["qvel"][5:12, [0, 2]])
        assert part.steps.tolist() == list(range(5, 12))
        episode = next(e for e in log.episodes if e.env == 1 and e.episode == 2)
        one = log.read(["qpos", "rewards"], env=1, episode=2)
        assert one["rewards"][:, 0].sum() == pytest.approx(episode.total_reward)
        assert np.array_equal(
            one["qpos"][:, 0], whole["qpos"][episode.first_step : episode.last_step + 1, 1]
        )
        assert len(log.read("qpos", start=30)) == 0
        assert log.read("actions", start=100)["actions"].shape == (0, 3, 2)


def test_a_range_reads_only_the_chunks_it_lies_in(record, tmp_path):
    path = record(num_envs=64, steps=120, options=RecordOptions(compression="none"))
    with recording.open(path) as log:
        places = log.reader.chunks
        assert len(places) > 3
        expected = log.read("qpos", start=0, stop=3)["qpos"]
        middle = places[len(places) // 2]
    data = bytearray(path.read_bytes())
    data[middle.offset + middle.length // 2] ^= 1
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(data)
    with recording.open(broken) as log:
        assert np.array_equal(log.read("qpos", start=0, stop=3)["qpos"], expected)
        assert log.complete  # the damage was not met
        steps = len(log.read("qpos"))
        assert 3 < steps < 120
        assert not log.complete
        assert "checksum" in log.warnings[0]


def test_episodes_cover_every_step_and_say_how_they_ended(record):
    with recording.open(record(steps=30)) as log:
        episodes, data = log.episodes, log.read()
    for env in range(3):
        mine = [e for e in episodes if e.env == env]
        assert sum(e.steps for e in mine) == 30
        assert [e.episode for e in mine] == list(range(len(mine)))
        assert all(e.truncated for e in mine[:-1])
        ended = [e.last_step for e in mine if e.terminated or e.truncated]
        assert ended == np.flatnonzero(data["truncated"][:, env]).tolist()
    for episode in episodes:  # by the metric, which is 1
        assert episode.success is (True if episode.terminated or episode.truncated else None)


def test_rows_that_become_wide_stay_in_one_array(record):
    with recording.open(record(steps=12, push=True)) as log:
        data = log.read(["qpos", "xfrc_applied"])
    forces = data["xfrc_applied"].reshape(12, 3, -1)
    assert not forces[:3].any()
    assert np.flatnonzero(forces[3].any(1)).tolist() == [1]


def test_events_writes_and_metrics(record):
    path = record(steps=8)
    drawn = [(call, arrays) for _, call, arrays in calls_of(path) if call.kind == "event"]
    with recording.open(path) as log:
        events = list(log.events())
        assert [e.term for e in events] == [call.name for call, _ in drawn]
        last = max(i for i, e in enumerate(events) if e.term == "move_goal")
        assert events[last].drawn["position"].shape == (3, 3)
        assert np.array_equal(events[last].drawn["position"], drawn[last][1]["drawn.position"])
        assert {w.op for w in log.writes()} >= {"state", "model"}
        steps, values = log.metrics(0)
        rewards = log.read("rewards", env=0)["rewards"][:, 0]
        assert np.array_equal(values["reward_near_goal"], rewards[steps])
        with pytest.raises(ConfigError, match=r"environment 2 was not viewed; viewed were: 0"):
            log.metrics(2)


def test_torch_and_pandas(record):
    with recording.open(record(steps=6)) as log:
        data = log.read(["qpos", "rewards"])
    tensors = data.torch()
    assert tensors["qpos"].shape == (6, 3, 9)
    frame = data.frame()
    assert len(frame) == 18
    row = frame[(frame.step == 4) & (frame.env == 1)].iloc[0]
    assert row["qpos/arm/elbow"] == data["qpos"][4, 1, 1]
    assert row["rewards"] == data["rewards"][4, 1]


def test_a_frame_without_pandas_says_what_to_install(record, monkeypatch):
    with recording.open(record(steps=3)) as log:
        data = log.read("rewards")
    importing = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name == "pandas":
            raise ImportError(name)
        return importing(name, *args, **kwargs)

    # As if the extra were not installed.
    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(ConfigError, match=r"pip install 'embodichain\[pandas\]'"):
        data.frame()


def test_a_cut_file_is_read_to_its_last_whole_chunk(record, tmp_path):
    path = record(num_envs=64, steps=120)
    with recording.open(path) as log:
        whole = log.read(["qpos", "rewards"])
        second = log.reader.chunks[1]
    data, cut = path.read_bytes(), tmp_path / "cut.mcap"
    for size in (second.offset + second.length, len(data) * 2 // 3, len(data) - 9):
        cut.write_bytes(data[:size])
        with recording.open(cut) as log:
            part = log.read(["qpos", "rewards"])
            assert not log.complete
            assert log.warnings[0].startswith("incomplete: the file ends early")
            assert 0 < len(part) <= 120
            assert np.array_equal(part["qpos"], whole["qpos"][: len(part)])
            assert np.array_equal(part["rewards"], whole["rewards"][: len(part)])
            assert sum(e.steps for e in log.episodes) == 64 * len(part)


def test_zeros_after_a_power_cut_end_reading(record, tmp_path):
    path, padded = record(), tmp_path / "padded.mcap"
    with recording.open(path) as log:
        end = log.reader.chunks[-1].offset + log.reader.chunks[-1].length
        whole = log.read("qpos")["qpos"]
    padded.write_bytes(path.read_bytes()[:end] + bytes(2**26))
    with recording.open(padded) as log:
        assert np.array_equal(log.read("qpos")["qpos"], whole)
        assert "zeros" in log.warnings[0]


def test_noise_is_data_or_one_clear_error(record, tmp_path):
    data = record(steps=12).read_bytes()
    rng, bad = np.random.default_rng(1), tmp_path / "bad.mcap"
    good = 0
    for _ in range(150):
        noisy = bytearray(data[: int(rng.integers(1, len(data)))] if rng.random() < 0.3 else data)
        for at in rng.integers(0, len(noisy), 3):
            noisy[at] ^= int(rng.integers(1, 256))
        bad.write_bytes(noisy)
        try:
            with recording.open(bad) as log:
                log.read("rewards")
                assert log.episodes is not None
                list(log.events())
                good += 1
        except ConfigError:
            continue
    assert good


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        ({"fields": "qpo"}, "no field 'qpo'. Did you mean 'qpos'"),
        ({"env": 3}, "no environment 3 in the log: there are 0 to 2"),
        ({"env": [1, 0]}, "ascending order"),
        ({"episode": 0}, "name one"),
        ({"env": 0, "episode": 9}, "no episode 9 of environment 0 in the log: there are 0 to"),
        ({"start": 5, "stop": 3}, "0 <= from <= to"),
    ],
)
def test_wrong_questions(record, ask, message):
    with recording.open(record()) as log, pytest.raises(ConfigError, match=message):
        log.read(**ask)


def test_a_log_without_states_says_so(record):
    with recording.open(record(options=RecordOptions(state="none"))) as log:
        with pytest.raises(LogError, match="record.state=none"):
            log.read()
        assert log.metrics(0)[1]["reward"].size


def test_a_message_of_a_wrong_size_is_an_error(record, tmp_path):
    path = rewrite(
        record(),
        tmp_path / "odd.mcap",
        message=lambda topic, data: data[:-9] if topic == "/sim/steps" else data,
    )
    with recording.open(path) as log, pytest.raises(LogError, match="a message is damaged"):
        log.read("actions")


def test_opening_reads_no_messages_and_no_torch(record):
    code = "import sys; import embodichain.recording as r; r.open(sys.argv[1]); " \
        "sys.exit('torch' in sys.modules)"  # fmt: skip
    assert subprocess.run([sys.executable, "-c", code, record()]).returncode == 0


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("control_dt", "1e-30", "a control step takes 1e-30 s"),
        ("num_envs", "2", "step 0: a start lacks whole rows"),
        ("nstate", "200", "numbers of state, the rows have 200"),
        ("control_dt", "0.04", "step 1 has another's time"),
        ("control_dt", "1e-7", "step 1 has another's time"),
    ],
)
def test_metadata_that_does_not_fit_is_an_error(many_chunks, tmp_path, key, value, message):
    def forge(name, values):
        return {**values, key: value} if name == "embodichain" else values

    path = rewrite(many_chunks(), tmp_path / "forged.mcap", metadata=forge)
    with pytest.raises(LogError, match=message), recording.open(path) as log:
        log.read("qpos")


def test_metadata_of_another_model_is_an_error(record, tmp_path):
    def forge(name, values):
        if "layout" in values:
            assert "mocap_pos" in values["layout"]
            values["layout"] = values["layout"].replace("mocap_pos", "mocap_pot")
        return values

    path = rewrite(record(), tmp_path / "odd.mcap", metadata=forge)
    with recording.open(path) as log:
        for ask in ({}, {"env": 1, "start": 3}):
            with pytest.raises(LogError, match="metadata says that 'mocap_pot' is columns 78 to"):
                log.read(**ask)
    report = recording.verify(path)
    assert not report.ok
    assert "'mocap_pot' is columns" in report.problems[0]


def test_a_component_that_another_mujoco_has_does_not_hinder_reading(record, tmp_path):
    def forge(name, values):
        if "layout" not in values:
            return values
        nstate, layout = int(values["nstate"]), json.loads(values["layout"])
        layout["userdata"] = [nstate, nstate + 3]
        more = {"nstate": str(nstate + 3), "layout": json.dumps(layout)}
        return {**values, **more, "mujoco_version": "4.9.9"}

    path = record()
    header = header_of(path)

    def wider(topic, data):
        """Whole rows with three numbers more."""
        if not topic.startswith("/sim/"):
            return data
        found, steps = unpack(header, data), []
        for calls in recorded_steps(found):
            steps.append([])
            for kind, arrays in calls:
                rows = ["row"] * (kind.kind == "start") + ["values"] * (kind.mode == "reset")
                rows = rows if kind.kind in ("start", "write") else []
                arrays = tuple(
                    np.pad(values, ((0, 0), (0, 3))) if array.name in rows else values
                    for array, values in zip(kind.arrays, arrays, strict=True)
                )
                named = zip(kind.arrays, arrays, strict=True)
                wide = tuple(ArrayKind(a.name, a.dtype, v.shape) for a, v in named)
                steps[-1].append((kind._replace(arrays=wide), arrays))
        return b"".join(pack_steps(found[0].first, steps))

    with recording.open(path) as log:
        whole = log.read(["qpos", "ctrl"])
    other = rewrite(path, tmp_path / "other.mcap", message=wider, metadata=forge)
    with recording.open(other) as log:
        assert np.array_equal(log.read("qpos")["qpos"], whole["qpos"])
        assert log.columns["ctrl"] == whole.columns["ctrl"]
    assert "numbers of state, the rows have" in recording.verify(other).problems[-1]


@pytest.mark.parametrize("what", ["moved", "missing"])
def test_a_chunk_that_comes_again_or_not_at_all_is_an_error(many_chunks, tmp_path, what):
    data, at, chunks = many_chunks().read_bytes(), 8, []
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == Opcode.CHUNK:
            chunks.append(slice(at, at + 9 + length))
        at += 9 + length
    path, one, last = tmp_path / "changed.mcap", chunks[5], chunks[-1]
    if what == "moved":
        path.write_bytes(data[: last.start] + data[one] + data[last.start :])
    else:
        path.write_bytes(data[: one.start] + data[one.stop :])
    with recording.open(path) as log:
        for ask in (log.read, lambda: list(log.parts(steps=1000)), lambda: log.snapshot(0)):
            with pytest.raises(LogError, match=f"a chunk (is|was) {what}: step .* follows step"):
                ask()


def test_parts_have_steps(record):
    with recording.open(record()) as log, pytest.raises(ConfigError, match="parts of 0 control"):
        next(log.parts(steps=0))


def test_parts_go_on_behind_gaps(record):
    options = RecordOptions(every=2)
    with recording.open(record(steps=60, options=options)) as log:
        whole = log.read()
        assert np.diff(whole.steps).max() > 5
        parts = list(log.parts(steps=2))
    assert np.concatenate([p.steps for p in parts]).tolist() == whole.steps.tolist()
    assert np.array_equal(np.concatenate([p["qpos"] for p in parts]), whole["qpos"])

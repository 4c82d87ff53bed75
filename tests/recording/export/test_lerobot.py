"""LeRobot data sets: as the v3 layout says, as Rerun's reader and LeRobot itself read them."""

import json
import os
import subprocess
from pathlib import Path

import imageio_ffmpeg
import mujoco
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import embodichain.recording as recording
from embodichain.cli import main
from embodichain.lab.gym.envs.mdp.events.record import filmed_from
from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.lab.sim.drawing.states import DataState
from embodichain.recording import McapRecorder
from embodichain.recording.export import Part, export
from embodichain.recording.export.lerobot_writer import count_levels, level_stats
from embodichain.utils.errors import ConfigError
from tests.recording.scene import MODEL, SmallEnv

pytestmark = pytest.mark.slow

LEROBOT_READER = Path(__file__).parents[2] / "helpers/lerobot_reader.py"
CAMERAS = """
task:
  description: Move the arm.
  robot: {uid: arm}
  events:
    front: {func: record_camera_data, mode: interval, params: {name: front, resolution: [64, 48],
      eye: [1.5, -1, 1], target: [0.2, 0, 0.3]}}
    goal: {func: move_goal, mode: interval}
"""


@pytest.fixture
def log(record):
    with recording.open(record(steps=24)) as log:
        yield log


@pytest.fixture
def filmed(tmp_path):
    env = SmallEnv(num_envs=2)
    recorder = McapRecorder(tmp_path / "filmed.mcap", env, CAMERAS, [], None, "small")
    env.add_observer(recorder)
    env.reset()
    for _ in range(10):
        env.step()
    env.close()
    with recording.open(tmp_path / "filmed.mcap") as log:
        yield log


def read(root):
    info = json.loads((root / "meta/info.json").read_text())
    episodes = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    frames = pq.read_table(root / info["data_path"].format(chunk_index=0, file_index=0))
    return info, episodes, frames


def test_frames_are_the_steps_of_episodes(log):
    root = export(log, "lerobot")
    assert root == log.path.with_name("log_lerobot")
    info, episodes, frames = read(root)
    assert (info["codebase_version"], info["fps"]) == ("v3.0", 50)
    assert (info["total_episodes"], info["total_frames"]) == (len(log.episodes), 24 * 3)
    assert info["splits"] == {"train": f"0:{len(log.episodes)}"}
    features = info["features"]
    assert features["observation.state"]["names"] == ["arm/shoulder", "arm/elbow"]
    assert features["observation.environment_state"]["names"][:3] == [
        *("cube/free.x", "cube/free.y", "cube/free.z")
    ]
    assert set(frames.column_names) == set(features)
    kinds = {"float32": pa.float32(), "int64": pa.int64(), "bool": pa.bool_()}
    for key, feature in features.items():
        kind, (width,) = kinds[feature["dtype"]], feature["shape"]
        assert frames.schema.field(key).type == (kind if width == 1 else pa.list_(kind, width))
    data = log.read()
    for number, (row, episode) in enumerate(zip(episodes, log.episodes, strict=True)):
        part = frames.slice(row["dataset_from_index"], row["length"]).to_pydict()
        steps = slice(episode.first_step, episode.last_step + 1)
        env = episode.env
        assert row["episode_index"] == number and row["length"] == episode.steps
        assert (row["source/env"], row["source/episode"]) == (env, episode.episode)
        assert part["frame_index"] == list(range(episode.steps))
        assert part["timestamp"] == pytest.approx(np.arange(episode.steps) * 0.02)
        assert part["index"][0] == row["dataset_from_index"]
        assert set(part["episode_index"]) == {number}
        qpos = data["qpos"][steps, env].astype(np.float32)
        assert np.array_equal(part["observation.state"], qpos[:, :2])
        assert np.array_equal(np.array(part["observation.environment_state"])[:, :7], qpos[:, 2:])
        assert np.array_equal(part["action"], data["actions"][steps, env].astype(np.float32))
        assert np.array_equal(part["next.reward"], data["rewards"][steps, env].astype(np.float32))
        done = [False] * (episode.steps - 1) + [episode.terminated or episode.truncated]
        assert part["next.done"] == done
        mean = np.mean(part["observation.state"], axis=0)
        assert row["stats/observation.state/mean"] == pytest.approx(mean, abs=1e-6)
    stats = json.loads((root / "meta/stats.json").read_text())
    whole = np.array(frames["action"].to_pylist())
    for name, expected in (
        ("mean", whole.mean(axis=0)),
        ("std", whole.std(axis=0)),
        ("min", whole.min(axis=0)),
    ):
        assert stats["action"][name] == pytest.approx(expected, abs=1e-6)
    assert stats["action"]["count"] == [72]
    tasks = pd.read_parquet(root / "meta/tasks.parquet")
    assert tasks.index.tolist() == ["small"] and tasks["task_index"].tolist() == [0]


def test_a_part(log, tmp_path):
    root = export(log, "lerobot", tmp_path / "part", Part(1, None, 3, 12))
    _, episodes, frames = read(root)
    firsts = [(e["source/env"], e["source/first_step"]) for e in episodes]
    expected = [(e.env, max(3, e.first_step)) for e in log.episodes if e.env == 1]
    assert firsts == [found for found in expected if found[1] < 12]
    assert len(frames) == 9


def test_films_show_the_states(filmed, tmp_path):
    root = export(filmed, "lerobot", tmp_path / "set")
    info, episodes, _ = read(root)
    assert info["robot_type"] == "arm"
    key = "observation.images.front"
    assert info["features"][key]["shape"] == [48, 64, 3]
    data, state = filmed.read(), mujoco.MjData(MODEL)
    view = filmed_from((64, 48), [1.5, -1, 1], [0.2, 0, 0.3])  # a focal length of 600 pixels
    renderer = OffscreenRenderer(filmed.model)
    seen = []
    for row, episode in zip(episodes, filmed.episodes, strict=True):
        where = {name: row[f"videos/{key}/{name}"] for name in ("chunk_index", "file_index")}
        assert (row[f"videos/{key}/from_timestamp"], row[f"videos/{key}/to_timestamp"]) == (
            *(0.0, pytest.approx(episode.steps / 50)),
        )
        path = root / info["video_path"].format(video_key=key, **where)
        _, *pictures = imageio_ffmpeg.read_frames(str(path))
        assert len(pictures) == episode.steps
        for step, picture in enumerate(pictures, start=episode.first_step):
            state.qpos[:] = data["qpos"][step, episode.env]
            state.mocap_pos[:] = data["mocap_pos"][step, episode.env].reshape(-1, 3)
            state.mocap_quat[:] = data["mocap_quat"][step, episode.env].reshape(-1, 4)
            mujoco.mj_forward(MODEL, state)
            color = renderer.draw(DataState(state), [view])[0]["color"]
            expected = color[0, ..., :3].astype(np.int64)
            found = np.frombuffer(picture, np.uint8).reshape(48, 64, 3)
            assert np.abs(found - expected).mean() < 6  # what the encoder loses
            seen.append(expected)
    renderer.close()
    assert np.std(seen, axis=0).mean() > 0.5  # things moved: a still film would be found out
    means = np.array(seen).mean(axis=(0, 1, 2)) / 255
    stats = json.loads((root / "meta/stats.json").read_text())[key]
    assert np.array(stats["mean"]).shape == (3, 1, 1)
    assert np.ravel(stats["mean"]) == pytest.approx(means, abs=0.01)


def test_rerun_reads_the_data_set(filmed, tmp_path):
    pytest.importorskip("rerun")
    from rerun.experimental import LeRobotReader

    reader = LeRobotReader(export(filmed, "lerobot", tmp_path / "set"))
    assert reader.version == "v3"
    assert reader.episodes() == list(range(len(filmed.episodes)))
    for number, episode in enumerate(filmed.episodes):
        rows, films = {}, 0
        for chunk in reader.stream(number):
            if not chunk.is_static:
                rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + len(chunk)
                films += "VideoStream" in str(chunk.to_record_batch().schema)
        for key in ("/observation.state", "/observation.environment_state", "/action", "/task"):
            assert rows[key] == episode.steps
        assert films


@pytest.mark.skipif(
    "LEROBOT_PYTHON" not in os.environ,
    reason="LEROBOT_PYTHON names no interpreter with LeRobot: `make lerobot` makes one (8 GB) and "
    "runs this",
)
def test_lerobot_itself_loads_the_data_set(filmed, tmp_path):
    root, out = export(filmed, "lerobot", tmp_path / "set"), tmp_path / "read.npz"
    subprocess.run(
        [os.environ["LEROBOT_PYTHON"], LEROBOT_READER, root, out],
        env=os.environ | {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path)},
        check=True,
    )
    found = dict(np.load(out))
    assert found["about"].tolist() == [20, len(filmed.episodes), 50]
    assert set(found["tasks"]) == {"Move the arm."}
    data = filmed.read()
    steps = [(e.env, slice(e.first_step, e.last_step + 1)) for e in filmed.episodes]

    def whole(name):
        return np.concatenate([data[name][part, env] for env, part in steps])

    assert np.array_equal(found["observation.state"], whole("qpos")[:, :2].astype(np.float32))
    assert np.array_equal(found["action"], whole("actions").astype(np.float32))
    assert np.array_equal(found["next.reward"], whole("rewards").astype(np.float32))
    # What comes one step ahead stays within its episode: the last action stands for the next.
    later = [np.append(a[1:], a[-1:], axis=0) for a in (data["actions"][p, e] for e, p in steps)]
    assert np.array_equal(found["two_actions"][:, 1], np.concatenate(later).astype(np.float32))
    films = [imageio_ffmpeg.read_frames(str(p)) for p in sorted(root.glob("videos/*/*/*"))]
    raw = b"".join(picture for _, *film in films for picture in film)
    expected = np.frombuffer(raw, np.uint8).reshape(-1, 48, 64, 3) / 255
    pictures = found["observation.images.front"].transpose(0, 2, 3, 1)
    assert np.abs(pictures - expected).mean(axis=(1, 2, 3)) == pytest.approx(0, abs=0.02)
    assert found["mean/observation.images.front"].shape == (3, 1, 1)


def test_statistics_are_of_all_frames(log, tmp_path):
    # A target that stays for an episode: quantiles of episodes say nothing about those of frames.
    root = export(log, "lerobot")
    info, _, frames = read(root)
    stats = json.loads((root / "meta/stats.json").read_text())
    shares = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
    for key in info["features"]:
        whole = np.array(frames[key].to_pylist(), np.float64).reshape(72, -1)
        for name, share in shares.items():
            assert stats[key][name] == pytest.approx(np.quantile(whole, share, axis=0)), key
        for name in ("min", "max", "mean", "std"):
            assert stats[key][name] == pytest.approx(getattr(whole, name)(axis=0)), key
        assert stats[key]["count"] == [72]


def test_statistics_of_pictures_are_those_of_their_pixels():
    rng = np.random.default_rng(0)
    pictures = rng.integers(3, 240, (5, 20, 30, 3), np.uint8) // np.array([1, 2, 3], np.uint8)
    stats, pixels = level_stats(count_levels(pictures), 5), pictures.reshape(-1, 3) / 255
    assert stats["count"] == [5]
    for name, expected in {
        **{name: getattr(pixels, name)(axis=0) for name in ("min", "max", "mean", "std")},
        **{f"q{q:02d}": np.quantile(pixels, q / 100, axis=0) for q in (1, 10, 50, 90, 99)},
    }.items():
        assert stats[name][:, 0, 0] == pytest.approx(expected), name


def test_pictures_of_episodes_are_counted_together(filmed, tmp_path):
    root = export(filmed, "lerobot", tmp_path / "set")
    _, episodes, _ = read(root)
    key = "observation.images.front"
    stats = json.loads((root / "meta/stats.json").read_text())[key]
    own = [[np.ravel(row[f"stats/{key}/{name}"]) for row in episodes] for name in ("min", "max")]
    assert np.array_equal(np.ravel(stats["min"]), np.min(own[0], axis=0))
    assert np.array_equal(np.ravel(stats["max"]), np.max(own[1], axis=0))
    counts = [row[f"stats/{key}/count"][0] for row in episodes]
    assert stats["count"] == [sum(counts)]
    means = np.array([np.ravel(row[f"stats/{key}/mean"]) for row in episodes])
    assert np.ravel(stats["mean"]) == pytest.approx(np.average(means, axis=0, weights=counts))


def test_frames_a_second_are_whole(record, tmp_path):
    class Slow(SmallEnv):
        def __init__(self, **kwargs):
            super().__init__(**kwargs)
            self.sim_steps_per_control = self.physics_steps_per_call = 3
            self.step_dt = 0.015

    said = r"whole number of frames a second; control steps make 66\.66"
    with recording.open(record(env=Slow, steps=5)) as log, pytest.raises(ConfigError, match=said):
        export(log, "lerobot", tmp_path / "set")


def test_the_command(record, tmp_path, capsys):
    path = record(steps=8)
    arguments = ["export", str(path), "--format", "lerobot", "-o", str(tmp_path / "set")]
    assert main([*arguments, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    files = [p for p in (tmp_path / "set").rglob("*") if p.is_file()]
    assert said["bytes"] == sum(p.stat().st_size for p in files)
    assert main(arguments) == 2
    assert "exists; it is never replaced" in capsys.readouterr().err

"""Data sets with the task's observations: robomimic's files and LeRobot's folders."""

import json
import os
import subprocess
from pathlib import Path

import h5py
import imageio_ffmpeg
import numpy as np
import pyarrow.parquet as pq
import pytest

import embodichain.recording as recording
from embodichain.cli import main
from embodichain.recording import read_episodes
from embodichain.recording.export import export_episodes
from embodichain.utils.errors import ConfigError
from tests.recording.live import NOISY, record_task

pytestmark = pytest.mark.slow

LEROBOT_READER = Path(__file__).parents[2] / "helpers/lerobot_reader.py"
ROBOMIMIC_READER = LEROBOT_READER.with_name("robomimic_reader.py")
NEAR = "task.metrics.success.shape.below=0.3"


@pytest.fixture
def logs(tmp_path):
    """Two logs of one task, with successes and failures."""
    where = [tmp_path / name for name in ("a.mcap", "b.mcap")]
    for seed, path in enumerate(where):
        record_task(path, [*NOISY, NEAR, f"seed={3 + seed}"], 18)
    return where


def test_robomimic_has_what_the_policy_saw(logs, tmp_path):
    said = []
    path = export_episodes(logs, "robomimic", tmp_path / "set.hdf5", progress=said.append)
    episodes = list(read_episodes(logs))
    assert said == list(range(1, len(episodes) + 1))
    assert {episode.path for episode in episodes} == set(logs)
    with h5py.File(path) as file, recording.open(logs[0]) as log:
        root = file["data"]
        assert len(root) == len(episodes)
        assert root.attrs["total"] == sum(map(len, episodes))
        args = json.loads(root.attrs["env_args"])
        assert (args["env_kwargs"]["name"], args["type"]) == ("reach", 2)
        assert args["env_kwargs"]["config"]["task"]["max_episode_steps"] == 9
        for number, episode in enumerate(episodes):
            demo = root[f"demo_{number}"]
            assert demo.attrs["num_samples"] == len(episode) == len(demo["actions"])
            assert (demo.attrs["log"], demo.attrs["env"]) == (episode.path.name, episode.env)
            names = set(episode.groups["policy"])
            assert set(demo["obs"]) == set(demo["next_obs"]) == {*names, "flat"}
            assert np.array_equal(demo["obs/flat"], episode.group()[:-1])
            assert np.array_equal(demo["next_obs/flat"], episode.group()[1:])
            for name in names:
                values = episode.observations[name]
                assert np.array_equal(demo["obs"][name], values[:-1])
                assert np.array_equal(demo["next_obs"][name], values[1:])
            assert np.array_equal(demo["actions"], episode.actions)
            assert np.array_equal(demo["rewards"], episode.rewards)
            assert demo["dones"][:].tolist() == [0] * (len(episode) - 1) + [1]
            assert demo.attrs["model_file"].startswith("<mujoco")
        states = episodes[0].env, episodes[0].first_step
        data = log.read(["qpos", "mocap_pos"], states[0], start=states[1], stop=states[1] + 9)
        names = list(root["demo_0/states"].attrs["names"])
        at = names.index("qpos/" + data.names("qpos")[0])
        found = root["demo_0/states"][:]
        assert np.array_equal(found[:, at : at + 6], data["qpos"][:, 0])
        at = names.index("mocap_pos/" + data.names("mocap_pos")[0])
        assert np.array_equal(found[:, at : at + 6], data["mocap_pos"][:, 0])
        train, valid = (set(file["mask"][name][:].tolist()) for name in ("train", "valid"))
        assert train | valid == {name.encode() for name in root} and not train & valid
        assert len(valid) == 1


def test_lerobot_has_states_of_robot_and_scene_apart(logs, tmp_path):
    root = export_episodes(logs, "lerobot", tmp_path / "set", failures=True)
    episodes = list(read_episodes(logs, failures=True))
    info = json.loads((root / "meta/info.json").read_text())
    features = info["features"]
    assert (info["total_episodes"], info["fps"], info["robot_type"]) == (len(episodes), 50, "ur10")
    assert features["observation.environment_state"]["names"] == [f"to_goal[{i}]" for i in range(3)]
    robot = ["qpos", "qvel", "action", "past"]
    names = features["observation.state"]["names"]
    assert [name for name in names if name.endswith("[0]")] == [f"{name}[0]" for name in robot]
    rows = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    frames = pq.read_table(root / "data/chunk-000/file-000.parquet")
    for row, episode in zip(rows, episodes, strict=True):
        part = frames.slice(row["dataset_from_index"], row["length"]).to_pydict()
        assert (row["source/log"], row["source/env"]) == (episode.path.name, episode.env)
        seen = np.concatenate([episode.observations[name] for name in robot], axis=1)
        assert np.array_equal(part["observation.state"], seen[:-1])
        to_goal = episode.observations["to_goal"][:-1]
        assert np.array_equal(part["observation.environment_state"], to_goal)
        assert np.array_equal(part["action"], episode.actions)
        assert part["next.success"] == [False] * (len(episode) - 1) + [episode.success]
    assert {episode.success for episode in episodes} == {True, False}


def test_pictures_of_the_policy_become_videos_and_arrays(tmp_path):
    twice = "{func: camera_image, name: a/b, history_length: 2, params: {sensor: front}}"
    overrides = [
        "task=reach_vision",
        "task.max_episode_steps=3",
        f"+task.observations.twice={twice}",
    ]
    log, _ = record_task(tmp_path / "log.mcap", overrides, 3)
    episodes = list(read_episodes(log, failures=True))
    path = export_episodes(log, "robomimic", tmp_path / "set.hdf5", failures=True)
    with h5py.File(path) as file:
        for number, episode in enumerate(episodes):
            for name, key in (("front", "front_image"), ("a/b", "a_b_image")):
                pictures = episode.observations[name].transpose(0, 2, 3, 1)
                demo = file[f"data/demo_{number}"]
                assert np.array_equal(demo["obs"][key], pictures[:-1])
                assert np.array_equal(demo["next_obs"][key], pictures[1:])
    root = export_episodes(log, "lerobot", tmp_path / "set", failures=True)
    info = json.loads((root / "meta/info.json").read_text())
    images = {key for key in info["features"] if "images" in key}
    assert images == {"observation.images.front", "observation.images.side"}
    for number, episode in enumerate(episodes):
        film = root / f"videos/observation.images.side/chunk-000/file-{number:03d}.mp4"
        _, *pictures = imageio_ffmpeg.read_frames(str(film))
        found = np.frombuffer(b"".join(pictures), np.uint8).reshape(-1, 64, 64, 3).astype(int)
        expected = episode.observations["side"][:-1].transpose(0, 2, 3, 1)
        assert found.shape == expected.shape
        assert np.abs(found - expected).mean() < 6  # what the encoder loses


def test_the_command(logs, tmp_path, capsys):
    out = str(tmp_path / "set.hdf5")
    arguments = ["export", *map(str, logs), "--format", "robomimic", "-o", out]
    assert main([*arguments, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    with h5py.File(out) as file:
        assert said["episodes"] == len(file["data"])
    for wrong, why in {
        (*arguments,): "exists; it is never replaced",
        (*arguments[:-1], "x.hdf5", "--env", "0"): "--env does not go with observations",
        (*arguments[:-1], "x.hdf5", "--group", "actor"): "no observation group 'actor'",
        ("export", "a", "--format", "csv", "--observations"): "csv has no observations",
        ("export", "a", "--format", "lerobot", "--failures"): "--failures needs --observations",
        ("export", "a", "b", "--format", "lerobot"): "one log at a time: a, b",
        ("export", "a", "--observations"): "--format is needed: csv, hdf5",
    }.items():
        assert main(list(wrong)) == 2
        assert why in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "cwd").iterdir()] == []
    with pytest.raises(ConfigError, match="robomimic has the task's observations: use export_epi"):
        recording.export.export(recording.open(logs[0]), "robomimic")


def test_an_interrupted_export_leaves_nothing(logs, tmp_path):
    def interrupt(done):
        if done == 2:
            raise KeyboardInterrupt

    for form in ("robomimic", "lerobot"):
        before = set(tmp_path.rglob("*"))
        with pytest.raises(KeyboardInterrupt):
            export_episodes(logs, form, tmp_path / "set", progress=interrupt)
        assert set(tmp_path.rglob("*")) == before


def test_another_group_alone(logs, tmp_path):
    path = export_episodes(logs[0], "robomimic", group="critic")
    assert path == logs[0].with_name("a_robomimic.hdf5")
    episodes = list(read_episodes(logs[0]))
    with h5py.File(path) as file:
        for number, episode in enumerate(episodes):
            demo = file[f"data/demo_{number}"]
            assert list(demo["obs"]) == ["flat", "latest"]
            # What follows an action is observed with it as the last action.
            assert np.array_equal(demo["next_obs/latest"], demo["actions"])
            assert np.array_equal(demo["obs/latest"][1:], episode.actions[:-1])
            assert not demo["obs/latest"][0].any()
    root = export_episodes(logs[0], "lerobot", group="critic")
    features = json.loads((root / "meta/info.json").read_text())["features"]
    assert features["observation.state"]["shape"] == [6]
    assert "observation.environment_state" not in features


@pytest.mark.skipif(
    "LEROBOT_PYTHON" not in os.environ,
    reason="LEROBOT_PYTHON names no interpreter with LeRobot: `make lerobot` makes one (8 GB) and "
    "runs this",
)
def test_lerobot_itself_loads_observations(logs, tmp_path):
    root, out = export_episodes(logs, "lerobot", tmp_path / "set"), tmp_path / "read.npz"
    subprocess.run(
        [os.environ["LEROBOT_PYTHON"], LEROBOT_READER, root, out],
        env=os.environ | {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path)},
        check=True,
    )
    found, episodes = dict(np.load(out)), list(read_episodes(logs))
    assert found["about"].tolist() == [sum(map(len, episodes)), len(episodes), 50]
    to_goal = np.concatenate([e.observations["to_goal"][:-1] for e in episodes])
    assert np.array_equal(found["observation.environment_state"], to_goal)
    actions = np.concatenate([e.actions for e in episodes])
    assert np.array_equal(found["action"], actions)
    assert found["action_names"].tolist() == [f"arm/Joint{i}" for i in range(1, 7)]
    whole = {"observation.environment_state": to_goal, "action": actions}
    for key, values in whole.items():
        for name in ("min", "max", "mean", "std"):
            expected = getattr(values.astype(np.float64), name)(axis=0)
            assert found[f"{name}/{key}"] == pytest.approx(expected, rel=1e-5, abs=1e-7)
        for name, share in {"q01": 0.01, "q50": 0.5, "q99": 0.99}.items():
            expected = np.quantile(values.astype(np.float64), share, axis=0)
            assert found[f"{name}/{key}"] == pytest.approx(expected, rel=1e-5, abs=1e-7)
        assert found[f"count/{key}"].tolist() == [len(values)]


@pytest.mark.skipif(
    "ROBOMIMIC_PYTHON" not in os.environ,
    reason="ROBOMIMIC_PYTHON names no interpreter with robomimic 0.3.0 and this package (a virtual "
    "environment of their own: it needs torchvision, diffusers and the old package gym)",
)
def test_robomimic_itself_makes_the_environment(logs, tmp_path):
    path, out = export_episodes(logs, "robomimic", tmp_path / "set.hdf5"), tmp_path / "read.npz"
    subprocess.run([os.environ["ROBOMIMIC_PYTHON"], ROBOMIMIC_READER, path, out], check=True)
    found, (episode, *_) = dict(np.load(out)), list(read_episodes(logs))
    assert found["action_dimension"] == 6
    assert found["observation"].shape == episode.group()[0].shape
    assert np.isfinite(found["rewards"]).all() and found["rewards"].shape == (5,)
    assert found["length"] == len(episode)

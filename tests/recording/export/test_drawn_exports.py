"""What was drawn for an episode stands in every format with episodes, read by other programs."""

import json

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader

import embodichain.recording as recording
from embodichain.cli import main
from embodichain.recording import read_episodes
from embodichain.recording.export import Part, export, export_episodes
from tests.recording.live import NOISY, record_task
from tests.recording.scene import SmallEnv

pytestmark = pytest.mark.slow


class _Sometimes(SmallEnv):
    """An event that draws in the first episode of each environment only."""

    def reset(self, ids=None):
        ids = np.arange(self.num_envs) if ids is None else ids
        first = ids[self.episodes[ids] < 0]
        if len(first):
            self._event("first", "reset", first, {"twice": self._draw(first, 2)})
        else:
            self._event("first", "reset", ids, {})
        super().reset(ids)


@pytest.fixture
def log(record):
    with recording.open(record(steps=24, env=_Sometimes)) as log:
        yield log


@pytest.fixture
def drawn(log):
    """(environment, episode) to what was drawn, of the episodes that ended."""
    found = {(e.env, e.episode): e.drawn for e in log.episodes if e.terminated or e.truncated}
    assert set(found[0, 0]) == {"first.twice", "mass.scale"}
    assert set(found[0, 1]) == {"mass.scale"}
    return found


def test_hdf5_has_attributes_of_each_demonstration(log, drawn):
    with h5py.File(export(log, "hdf5")) as file:
        found = {}
        for demo in file["data"].values():
            if "drawn" in demo:
                values = {name: array.tolist() for name, array in demo["drawn"].attrs.items()}
                found[int(demo.attrs["env"]), int(demo.attrs["episode"])] = values
    assert found == drawn


def test_npz_has_a_row_for_each_episode(log, drawn):
    with np.load(export(log, "npz")) as file:
        keys = zip(file["drawn.env_ids"].tolist(), file["drawn.episodes"].tolist(), strict=True)
        for row, key in enumerate(keys):
            assert file["drawn.mass.scale"][row].tolist() == drawn[key]["mass.scale"]
            twice = file["drawn.first.twice"][row]
            if "first.twice" in drawn[key]:
                assert twice.tolist() == drawn[key]["first.twice"]
            else:
                assert np.isnan(twice).all()
        assert len(file["drawn.env_ids"]) == len(drawn)


def test_npz_of_a_part_has_its_episodes(log, drawn, tmp_path):
    with np.load(export(log, "npz", tmp_path / "part.npz", Part(env=1, episode=1))) as file:
        assert file["drawn.mass.scale"].tolist() == [drawn[1, 1]["mass.scale"]]
        assert "drawn.first.twice" not in file


def test_parquet_has_them_in_its_metadata(log, drawn):
    metadata = pq.read_schema(export(log, "parquet")).metadata
    rows = json.loads(metadata[b"drawn"])
    assert {(row["env"], row["episode"]): row["drawn"] for row in rows} == drawn


def test_lerobot_has_columns_of_its_episodes(log, drawn):
    root = export(log, "lerobot")
    rows = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    found = {}
    for row in rows:
        values = {
            name.removeprefix("drawn/"): value
            for name, value in row.items()
            if name.startswith("drawn/") and value is not None
        }
        if values:
            found[row["source/env"], row["source/episode"]] = values
    assert found == drawn


def test_ros_2_has_them_in_its_metadata(log, drawn, tmp_path):
    path = export(log, "ros2", tmp_path / "bag.mcap", Part(env=1))
    with path.open("rb") as stream:
        (record,) = make_reader(stream).iter_metadata()
    found = {name: json.loads(text) for name, text in record.metadata.items()}
    assert record.name == "drawn"
    assert found == {f"env_1/episode_{k}": values for (env, k), values in drawn.items() if env == 1}


def test_rerun_has_curves_of_them(log, drawn, tmp_path, monkeypatch):
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    monkeypatch.setenv("HOME", str(tmp_path))
    path = export(log, "rrd", tmp_path / "a.rrd", Part(env=0))
    firsts = {e.episode: e.first_step for e in log.episodes if e.env == 0}
    found = {}
    for chunk in RrdReader(path).stream():
        if "/drawn/" not in chunk.entity_path:
            continue
        batch = chunk.to_record_batch()
        columns = {name: batch.column(name).to_pylist() for name in batch.schema.names}
        name = chunk.entity_path.rpartition("/")[2].replace("\\", "")
        for step, values in zip(columns["step"], columns["Scalars:scalars"], strict=True):
            found[name, step] = values
    assert found == {
        (name, firsts[episode]): values
        for (env, episode), draws in drawn.items()
        if env == 0
        for name, values in draws.items()
    }


def test_data_sets_with_observations_have_them(tmp_path):
    log, _ = record_task(tmp_path / "log.mcap", NOISY, 18)
    episodes = list(read_episodes(log, failures=True))
    with recording.open(log) as opened:
        drawn = {(e.env, e.episode): e.drawn for e in opened.episodes if e.drawn}
    assert {"observations.past.delay"} < set(drawn[0, 0])
    assert {(e.env, e.episode): e.drawn for e in episodes if e.drawn} == drawn
    with h5py.File(export_episodes(log, "robomimic", tmp_path / "set.hdf5", failures=True)) as file:
        for number, episode in enumerate(episodes):
            attributes = file[f"data/demo_{number}/drawn"].attrs
            assert {name: values.tolist() for name, values in attributes.items()} == episode.drawn
    root = export_episodes(log, "lerobot", tmp_path / "set", failures=True)
    rows = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for row, episode in zip(rows, episodes, strict=True):
        assert {name: row[f"drawn/{name}"] for name in episode.drawn} == episode.drawn


def test_the_page_about_a_run_shows_them(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = ["task=push_cube", "num_envs=1", "max_steps=9", "task.max_episode_steps=3"]
    assert main(["run", *lines, "output_dir=out", "-q"]) == 0
    (path,) = (tmp_path / "out").rglob("rollout.mcap")
    assert main(["report", str(path.parent)]) == 0
    page = path.with_name("report.html").read_text()
    with recording.open(path) as log:
        x = log.episodes[0].drawn["place_goal.position"][0]
    assert "<th>drawn</th>" in page and f"place_goal.position {x:.4g} " in page

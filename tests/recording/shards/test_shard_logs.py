"""Logs of shards: joined, they are the log of one batch, also if shards were lost."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import embodichain
from embodichain import recording
from embodichain.config.resolved import dump_yaml, resolve
from embodichain.recording import McapRecorder, RecordOptions, read_episodes
from embodichain.recording.format.log_error import LogError
from embodichain.recording.shards.shard_logs import ShardLogs, read_shards
from embodichain.utils.errors import ConfigError
from tests.helpers.local_shards import sharded

pytestmark = pytest.mark.slow

LINES = ["task.max_episode_steps=12", "+task.observations.qvel.noise={std: 0.01}"]
STEPS = 31
QUOTA = [1, 2, 0, 2, 1]
"""Episodes that count in each environment."""


def build(first: int, count: int) -> Any:
    lines = [*LINES, f"sim.first_env={first}", "sim.num_threads=1"]
    return embodichain.make("cart_pole", count, lines, seed=3)


def config_of(first: int, count: int) -> str:
    lines = ["task=cart_pole", *LINES, f"sim.first_env={first}", f"num_envs={count}", "seed=3"]
    return dump_yaml(resolve(lines).tree)


def play(env: Any, losing: dict[int, Any] | None = None) -> None:
    env.reset()
    for step in range(STEPS):
        if losing is not None and step in losing:
            losing[step]()
        env.step(env.rand("policy", (1,), -1, 1))


def record(folder: Path, shards: int, losing: Any = None, **options: Any) -> tuple[Path, Any]:
    """Record a batch of five, in shards that are lost at some steps; return the manifest."""
    folder.mkdir()
    with sharded(build, 5, shards, save_every=8) as (env, source):
        about = RecordOptions(**options), config_of, "", "cart_pole", "random", QUOTA
        logs = ShardLogs(folder / "rollout.mcap", env, *about)
        found = json.loads(logs.manifest.read_text())
        assert not found["complete"] and [s["node"] for s in found["shards"]] == ["n0", "n1"]
        play(env, None if losing is None else losing(source))
    assert logs.stats.steps == STEPS
    sizes = [f.stat().st_size for f in folder.glob("*.mcap") if ".lost" not in f.name]
    assert logs.stats.nbytes == sum(sizes)
    return logs.manifest, env.pool.rebuilt


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of the same batch in one process."""
    path = tmp_path_factory.mktemp("whole") / "rollout.mcap"
    env = build(0, 5)
    options = RecordOptions(view_envs=[1, 4])
    recorder = McapRecorder(
        path, env, config_of(0, 5), options=options, task="cart_pole", quota=QUOTA
    )
    env.add_observer(recorder)
    play(env)
    env.close()
    return path


def assert_same_logs(manifest: Path, whole: Path) -> None:
    with recording.open(manifest) as joined, recording.open(whole) as one:
        assert joined.num_envs == 5 and joined.complete and joined.warnings == []
        a, b = joined.read(), one.read()
        assert list(a) == list(b) and a.env_ids.tolist() == [0, 1, 2, 3, 4]
        for name in b:
            assert a[name].tobytes() == b[name].tobytes(), name
        assert joined.episodes == one.episodes
        counted = [sum(bool(e.counted) for e in joined.episodes if e.env == i) for i in range(5)]
        assert counted == QUOTA and joined.header.quota == tuple(QUOTA)
        part = joined.read("qpos", env=[1, 3], start=9, stop=20)
        assert np.array_equal(part["qpos"], b["qpos"][9:20, [1, 3]])
        third = joined.read("rewards", env=3, episode=1)
        assert np.array_equal(third["rewards"], one.read("rewards", env=3, episode=1)["rewards"])
        assert sum(len(p) for p in joined.parts("qpos", steps=7)) == STEPS
        for env in (1, 4):
            assert np.array_equal(joined.metrics(env)[0], one.metrics(env)[0])
        with pytest.raises(ConfigError, match="environment 2 was not viewed"):
            joined.metrics(2)
        drawn = [{}, {}]
        for log, found in zip((joined, one), drawn, strict=True):
            for event in log.events():
                ids = range(5) if event.env_ids is None else event.env_ids.tolist()
                for row, env in enumerate(ids):
                    values = {k: v[row].tolist() for k, v in event.drawn.items()}
                    found.setdefault((event.step, env, event.term), []).append(values)
        assert drawn[0] == drawn[1]
        assert len(list(joined.writes())) >= len(list(one.writes()))
        moment, other = joined.snapshot(4, 1, 2), one.snapshot(4, 1, 2)
        assert moment.row.tobytes() == other.row.tobytes() and moment.elapsed == 2
        with pytest.raises(ConfigError, match="one by one: rollout.shard0.mcap, rollout.shard1"):
            joined.raw_messages()
        with pytest.raises(ConfigError, match="environment 5"):
            joined.part_of(5)
    report = recording.verify(manifest)
    assert report.ok and (report.envs, report.steps) == (5, STEPS), str(report)
    assert recording.verify(manifest, env=4).envs == 1
    found, wanted = recording.inspect(manifest.parent), recording.inspect(whole)
    assert found.episodes == wanted.episodes and found.steps == wanted.steps
    assert found.header.view_envs == [1, 4]


def test_joined_they_are_the_log_of_one_process(tmp_path: Path, whole: Path) -> None:
    manifest, rebuilt = record(tmp_path / "run", 2, view_envs=[1, 4])
    assert rebuilt == []
    assert_same_logs(manifest, whole)
    files = sorted(f.name for f in manifest.parent.glob("rollout.shard1*.mcap"))
    assert files == ["rollout.shard1.mcap"] + [f"rollout.shard1_000{i}.mcap" for i in (1, 2, 3)]
    ours = list(read_episodes(manifest.parent, failures=True))
    theirs = list(read_episodes(whole, failures=True))
    assert len(ours) == len(theirs)
    firsts = {"rollout.shard0.mcap": 0, "rollout.shard1.mcap": 3}
    by_key = {(e.env, e.episode): e for e in theirs}
    for one in ours:
        other = by_key[one.env + firsts[one.path.name], one.episode]
        assert one.observations["qvel"].tobytes() == other.observations["qvel"].tobytes()


def test_lost_shards_leave_no_gap(tmp_path: Path, whole: Path) -> None:
    """Lost before the first saved state, between two, twice, and when the run ends."""

    def losing(source: Any) -> dict[int, Any]:
        return {
            5: source.running[1].lose,
            12: lambda: source.running[1].lose(),
            14: lambda: source.running[1].lose(),
            26: lambda: source.running[0].lose(),
            30: lambda: source.running[1].end(),
        }

    manifest, rebuilt = record(tmp_path / "run", 2, losing, view_envs=[1, 4])
    assert_same_logs(manifest, whole)
    at = [(r["shard"], r["lost_at_step"], r["continued_from_step"]) for r in rebuilt]
    assert at == [(1, 5, 0), (1, 12, 8), (1, 14, 8), (0, 26, 24), (1, 30, 24)]
    found = json.loads(manifest.read_text())
    assert found["complete"] and found["rebuilt"] == rebuilt
    lost = sorted(f.name for f in manifest.parent.glob("*.lost*"))
    assert lost == [
        "rollout.shard0_0003.lost1.mcap",
        "rollout.shard1.lost1.mcap",
        "rollout.shard1_0001.lost2.mcap",
        "rollout.shard1_0001.lost3.mcap",
        "rollout.shard1_0003.lost4.mcap",
    ]


def test_damage_is_named_with_the_file_of_its_shard(tmp_path: Path) -> None:
    manifest, _ = record(tmp_path / "run", 2, compression="none")
    path = manifest.with_name("rollout.shard1_0002.mcap")
    with recording.open(manifest) as log:
        value = log.read("qpos", env=4, start=20, stop=21)["qpos"].tobytes()
    data = path.read_bytes()
    assert data.count(value)
    where = data.rindex(value)
    path.write_bytes(data[:where] + bytes([data[where] ^ 1]) + data[where + 1 :])
    report = recording.verify(manifest)
    assert not report.ok
    (damage,) = report.damage
    assert (damage.file, damage.kind) == ("rollout.shard1_0002.mcap", "chunk")
    assert "rollout.shard1.mcap: " in str(report)
    # metadata of another shard, in its first file: nothing is read of either
    first = manifest.with_name("rollout.shard0.mcap")
    data = first.read_bytes()
    where = data.index(b"log_id") + 20
    first.write_bytes(data[:where] + bytes([data[where] ^ 1]) + data[where + 1 :])
    both = recording.verify(manifest)
    assert [d.file for d in both.damage] == ["rollout.shard0.mcap", "rollout.shard1_0002.mcap"]
    assert both.steps == both.envs == 0


def test_a_shorter_log_shortens_the_whole(tmp_path: Path) -> None:
    manifest, _ = record(tmp_path / "run", 2)
    manifest.with_name("rollout.shard0_0003.mcap").unlink()
    with recording.open(manifest) as log:
        assert log.read("rewards").steps.tolist() == list(range(24))
        assert not log.complete and "rollout.shard0.mcap: " in log.warnings[0]
    found = recording.inspect(manifest)
    assert found.steps == 24 and "rollout.shard0.mcap: " in found.warnings[0]
    assert not recording.verify(manifest).ok


def test_wrong_manifests_are_refused(tmp_path: Path) -> None:
    manifest, _ = record(tmp_path / "run", 2)
    good = json.loads(manifest.read_text())
    assert [entry.first_env for entry in read_shards(manifest)] == [0, 3]

    def refused(change: Any, words: str, error: type[Exception] = ConfigError) -> None:
        content = json.loads(json.dumps(good))
        change(content)
        manifest.write_text(json.dumps(content))
        with pytest.raises(error, match=words):
            recording.open(manifest)

    refused(lambda c: c.pop("shards"), "is not a manifest of shards: KeyError")
    refused(lambda c: c["shards"].pop(), "3 of 5 environments")
    refused(lambda c: c["shards"].reverse(), "does not continue it")
    refused(lambda c: c["shards"][1].update(log="../x.mcap"), "does not continue it")
    refused(lambda c: c["shards"][1].update(log="gone.mcap"), "gone.mcap does not exist")

    def moved(content: Any) -> None:
        content["shards"][0]["num_envs"], content["shards"][1]["first_env"] = 2, 2
        content["shards"][1]["num_envs"] = 3

    refused(moved, "is not the log that", LogError)
    manifest.write_text("{")
    with pytest.raises(ConfigError, match="is not a manifest of shards"):
        recording.inspect(manifest)
    manifest.unlink()
    with pytest.raises(ConfigError, match="cannot be read"):
        recording.verify(manifest)


def test_logs_of_different_runs_are_not_joined(tmp_path: Path) -> None:
    manifest, _ = record(tmp_path / "run", 2)
    other = tmp_path / "other.mcap"
    env = embodichain.make("cart_pole", 2, [*LINES, "sim.first_env=3"], seed=4)
    env.add_observer(McapRecorder(other, env, task="cart_pole"))
    env.reset()
    env.close()
    content = json.loads(manifest.read_text())
    other.rename(manifest.with_name("other.mcap"))
    content["shards"][1]["log"] = "other.mcap"
    manifest.write_text(json.dumps(content))
    with pytest.raises(LogError, match=r"is not of the batch of .*: seed is 4, not 3"):
        recording.open(manifest)

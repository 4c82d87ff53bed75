"""Episodes read from logs have the observations that were live, bit for bit."""

import json

import numpy as np
import pytest

import embodichain.recording as recording
from embodichain.cli import main
from embodichain.config.resolved import dump_yaml, resolve
from embodichain.recording import RecordOptions, read_episodes
from embodichain.recording.demos.collection import read_collection
from embodichain.recording.format.log_error import LogError
from embodichain.utils.errors import ConfigError
from tests.recording.live import NOISY, record_task

pytestmark = pytest.mark.slow


@pytest.fixture
def record(tmp_path):
    """Records a run of a task with random actions; returns the log and the observations."""

    def run(overrides, steps, name="rollout.mcap", *args, **kwargs):
        return record_task(tmp_path / name, overrides, steps, *args, **kwargs)

    return run


def same(episode, seen):
    """Whether its observations are those that were live; says which are not."""
    for name, values in episode.observations.items():
        expected = np.stack([one[name] for one in seen])
        assert values.dtype == expected.dtype and np.array_equal(values, expected), name
    return set(episode.observations) == set(seen[0])


def test_observations_are_those_of_the_run(record, caplog):
    path, seen = record(NOISY, steps=30, cut=(4, 6, 17))
    found = {(e.env, e.episode): e for e in read_episodes(path, failures=True)}
    assert set(found) == {key for key, rows in seen.items() if len(rows) > 1}
    assert not caplog.records
    with recording.open(path) as log:
        data, episodes = log.read(["actions", "rewards", "qpos"]), log.episodes
        first, last = log.header.layout["qpos"]
    for one in episodes:
        episode = found[one.env, one.episode]
        assert same(episode, seen[one.env, one.episode])
        steps = slice(one.first_step, one.last_step + 1)
        assert len(episode) == one.steps and episode.first_step == one.first_step
        for mine, name in ((episode.actions, "actions"), (episode.rewards, "rewards")):
            assert np.array_equal(mine, data[name][steps, one.env])
        assert np.array_equal(episode.states[:, first:last], data["qpos"][steps, one.env])
        ended = one.terminated or one.truncated
        assert episode.dones.tolist() == [False] * (one.steps - 1) + [ended]
        assert (episode.terminated, episode.truncated) == (one.terminated, one.truncated)
        names = episode.groups["policy"]
        flat = [seen[one.env, one.episode][2][name].ravel() for name in names]
        assert np.array_equal(episode.group()[2], np.concatenate(flat))
    assert episode.groups["critic"] == ("latest",)
    with pytest.raises(ConfigError, match=r"no observation group 'actor'; there are: policy, crit"):
        episode.group("actor")


def test_pictures_are_those_that_the_policy_saw(record):
    size = ["task.sensors.front.width=320", "task.sensors.front.height=240"]  # kept in a file
    path, seen = record(["task=reach_vision", "task.max_episode_steps=3", *size], steps=7)
    episodes = list(read_episodes(path, failures=True))
    assert len(episodes) == 9
    for episode in episodes:
        assert same(episode, seen[episode.env, episode.episode])
        assert episode.observations["front"].shape == (len(episode) + 1, 3, 240, 320)
    with pytest.raises(ConfigError, match="front, side: an image cannot be part of a vector"):
        episode.group()


def test_a_log_of_keyframes_has_the_same_episodes(record):
    options = RecordOptions(state="keyframes", keyframe_every=7)
    found = [
        list(read_episodes(record(NOISY, 20, name, option)[0], failures=True))
        for name, option in (("all.mcap", None), ("keyframes.mcap", options))
    ]
    for a, b in zip(*found, strict=True):
        assert (a.env, a.episode) == (b.env, b.episode)
        assert np.array_equal(a.states, b.states)
        assert all(np.array_equal(o, b.observations[n]) for n, o in a.observations.items())


def test_what_a_person_pushed_is_observed(record, caplog):
    def push(env, step):
        if step in (2, 8):
            qvel = env.sim.engine.state("qvel")[1]
            env.sim.engine.write("qvel", qvel[None] + 0.5, np.array([1]))

    path, seen = record(NOISY, steps=12, touch=push)
    for episode in read_episodes(path, failures=True):
        assert same(episode, seen[episode.env, episode.episode])
    (said,) = caplog.messages
    assert "2 of 36 states differ from the recorded ones" in said


def test_successes_only_unless_failures_are_wanted(record):
    near = ["task.metrics.success.shape.below=0.6"]
    path, _ = record([*NOISY, *near], steps=30)
    said = []
    found = list(read_episodes(path, progress=lambda *counts: said.append(counts)))
    with recording.open(path) as log:
        wanted = {(e.env, e.episode) for e in log.episodes if e.metrics.get("success")}
        count = len(log.episodes)
    assert 0 < len(found) < count and {(e.env, e.episode) for e in found} == wanted
    assert all(episode.success for episode in found)
    assert said == [(k + 1, len(found)) for k in range(len(found))]
    path, _ = record(["task=reach", "task.metrics.success.shape.below=1e-6"], 3, "none.mcap")
    with pytest.raises(ConfigError, match="no episode ended; --fail"):
        next(read_episodes(path))


def test_several_logs_are_one_data_set_of_one_task(record):
    a, _ = record(NOISY, 9, "a.mcap")
    b, _ = record([*NOISY, "seed=4"], 9, "b.mcap")
    found = list(read_episodes([a, b], failures=True))
    assert [e.path for e in found] == [a] * 3 + [b] * 3
    other, _ = record(["task=reach", "~task.observations.action"], 3, "other.mcap")
    with pytest.raises(ConfigError, match=r"other\.mcap .* belong together .* other action, past"):
        list(read_episodes([a, other], failures=True))


def test_logs_that_cannot_be_reenacted_are_refused(record, tmp_path):
    def refused(why, path, kind=ConfigError):
        with pytest.raises(kind, match=why):
            list(read_episodes(path, failures=True))

    few = ["task=reach", "task.max_episode_steps=4"]
    path, _ = record(few, 9, "none.mcap", RecordOptions(state="none"))
    refused("record.state=none", path, LogError)
    path, _ = record(few, 9, "every.mcap", RecordOptions(every=2))
    refused("record.every=2", path)
    path, _ = record(few, 3, "bare.mcap", said="seed: 3")
    refused("contains no config", path)
    changed = {
        "seed": "begins in another state than recorded",
        "goal": "its scene has other joints or bodies",
        "time": "step 1: the episode of environment 0 is truncated here, not when recorded",
    }
    overrides = {
        "seed": "task.events.place_goal.params.position_range=[[-0.1,-0.1,-0.1],[0.1,0.1,0.1]]",
        "goal": "+task.objects.ball={shape: {shape_type: Sphere, radius: 0.01}}",
        "time": "task.max_episode_steps=2",
    }
    for name, why in changed.items():
        said = dump_yaml(resolve(["num_envs=3", "seed=3", *few, overrides[name]]).tree)
        path, _ = record(few, 5, f"{name}.mcap", said=said)
        refused(why, path)
    with pytest.raises(ConfigError, match=r"has no rollout\.mcap"):
        next(read_episodes(tmp_path / "cwd"))


def test_a_resumed_collection_is_one_data_set(tmp_path):
    """Attempts draw by their number, whichever environment and log they are in."""
    words = ["task=reach", "policy=random", "task.max_episode_steps=9", "seed=1", "-q"]
    words += ["task.metrics.success.shape.below=0.3", "collect.success_steps=1", "num_envs=3"]
    words += [NOISY[2]]

    def collect(name, *more):
        assert main(["collect", *words, f"output_dir={tmp_path / name}", *more]) == 0
        return next((tmp_path / name).glob("*/*_reach"))

    whole = collect("whole", "episodes=5")
    parts = collect("parts", "episodes=2")
    assert main(["collect", f"resume={parts}", "episodes=5", "-q"]) == 0
    found = []
    for folder in (whole, parts):
        listed = {(e.log, e.env, e.episode): e for e in read_collection(folder, failures=True)}
        episodes = list(read_episodes(folder, failures=True))
        assert {(e.path.name, e.env, e.episode) for e in episodes} == set(listed)
        numbers = {listed[e.path.name, e.env, e.episode].attempt: e for e in episodes}
        assert len(numbers) == len(listed)
        found.append(numbers)
        wanted = {number for number, e in numbers.items() if e.success}
        successes = {e.attempt for e in read_collection(folder)}
        assert wanted == successes and len(list(read_episodes(folder))) == 5
    assert found[0].keys() == found[1].keys()
    for number, episode in found[0].items():
        for name, values in episode.observations.items():
            assert np.array_equal(values, found[1][number].observations[name])
    alone = list(read_episodes(whole / "rollout.mcap"))
    assert len(alone) == 5


def test_a_pushed_episode_is_corrected_and_others_are_exact(record, caplog):
    """Corrections are of one environment; commands, noise and delays of all stay the run's."""

    def lift(env, step):
        if step == 5:
            goal = env.sim.engine.state("mocap_pos")[2].copy()
            goal[-1] += 0.3
            env.sim.engine.write("mocap_pos", goal[None], np.array([2]))

    path, seen = record(NOISY, steps=18, touch=lift)
    found = list(read_episodes(path, failures=True))
    moved = next(e for e in found if (e.env, e.episode) == (2, 0))
    heights = moved.observations["to_goal"][:, 2]
    assert heights[6] - heights[5] > 0.2
    for episode in found:
        assert same(episode, seen[episode.env, episode.episode])
    assert len(caplog.messages) == 1 and "1 of 54 states differ" in caplog.messages[0]


def test_a_command_and_its_observation_are_those_of_the_run(record):
    """The task of a walker: commands that change within an episode, gravity, contacts, events."""
    overrides = ["task=quadruped_velocity", "task.max_episode_steps=8"]
    path, seen = record(overrides, steps=20, cut=(5,))
    episodes = list(read_episodes(path, failures=True))
    assert len(episodes) >= 6
    for episode in episodes:
        assert same(episode, seen[episode.env, episode.episode])


def test_the_last_episode_is_cut_where_the_log_ends(record):
    path, seen = record(NOISY, steps=13)
    cut = [e for e in read_episodes(path, failures=True) if not (e.terminated or e.truncated)]
    assert [(e.env, e.episode, len(e)) for e in cut] == [(i, 1, 4) for i in range(3)]
    for episode in cut:
        assert episode.success is None and not episode.dones.any()
        assert same(episode, seen[episode.env, episode.episode])


def test_lists_of_a_collection_that_do_not_fit_its_log(record, tmp_path):
    path, _ = record(NOISY, steps=9)
    line = {"attempt": 0, "log": path.name, "env": 0, "episode": 0, "first_step": 0, "steps": 9}
    line |= {"total_reward": 0.0, "success": True, "failure": None}
    lists = tmp_path / "successes.jsonl"
    lists.write_text(json.dumps(line | {"episode": 7}) + "\n")
    with pytest.raises(LogError, match="lacks episode 7 of environment 0, which the collection l"):
        list(read_episodes(tmp_path))
    # Attempt 5 begins in another state than environment 0 did.
    lists.write_text(json.dumps(line | {"attempt": 5}) + "\n")
    with pytest.raises(ConfigError, match="environment 0 begins in another state than recorded"):
        list(read_episodes(tmp_path, failures=True))
    lists.write_text("")
    with pytest.raises(ConfigError, match="the collection has no episode yet"):
        list(read_episodes(tmp_path))

"""Episodes read from logs have the observations that were live, bit for bit."""

import numpy as np
import pytest
import torch

import embodichain.recording as recording
from embodichain.config.factory import make_env
from embodichain.config.resolved import dump_yaml, resolve
from embodichain.lab.gym.envs.observers import StepObserver
from embodichain.recording import McapRecorder, RecordOptions, read_episodes
from embodichain.recording.log_error import LogError
from embodichain.utils.errors import ConfigError
from embodichain.utils.tensor_mapping import leaves_of


class Live(StepObserver):
    """Stores what the policy sees: per environment and episode, first and final ones included."""

    def __init__(self, env, first):
        self.seen = {(i, 0): [self.row(first, i)] for i in range(env.num_envs)}

    @staticmethod
    def row(obs, i):
        return {"/".join(path): np.array(leaf[i].numpy()) for path, leaf in leaves_of(obs)}

    def on_step(self, env, step):
        for i, episode in enumerate(step.episode_ids.tolist()):
            done = step.terminated[i] or step.truncated[i]
            self.seen[i, episode].append(self.row(step.info["final_obs"] if done else step.obs, i))
            if done:
                self.seen[i, episode + 1] = [self.row(step.obs, i)]


@pytest.fixture
def record(tmp_path):
    """Records a run of a task with random actions; returns the log and the observations."""

    def run(overrides, steps, name="rollout.mcap", options=None, cut=(), touch=None, said=None):
        resolved = resolve(["num_envs=3", "seed=3", *overrides])
        env = make_env(resolved)
        path = tmp_path / name
        text = dump_yaml(resolved.tree) if said is None else said
        env.add_observer(McapRecorder(path, env, text, [], options, resolved.task_name))
        obs, _ = env.reset()
        live = Live(env, obs)
        env.add_observer(live)
        draw = torch.Generator().manual_seed(1)
        for step in range(steps):
            if step in cut:
                env.truncate(np.array([step % 3]))
            if touch is not None:
                touch(env, step)
            env.step(2 * torch.rand((3, *env.single_action_space.shape), generator=draw) - 1)
        env.close()
        return path, live.seen

    return run


def same(episode, seen):
    """Whether its observations are those that were live; says which are not."""
    for name, values in episode.observations.items():
        expected = np.stack([one[name] for one in seen])
        assert values.dtype == expected.dtype and np.array_equal(values, expected), name
    return set(episode.observations) == set(seen[0])


NOISY = [
    "task=reach",
    "task.max_episode_steps=9",
    "+task.observations.past={func: joint_position, history_length: 3, delay: [1, 2], "
    "noise: {type: gaussian, std: 0.1}, params: {of: {uid: ur10}}}",
    "+task.observations.latest={func: last_action, group: critic}",
]


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
    with pytest.raises(ConfigError, match="front, side: an image is no part of a vector"):
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
    with pytest.raises(ConfigError, match="has no log"):
        next(read_episodes(tmp_path / "cwd"))

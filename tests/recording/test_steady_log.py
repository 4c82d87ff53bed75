"""Control steps that are written together are those that are written one by one."""

from collections import defaultdict
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import embodichain
from embodichain import recording
from embodichain.config import list_options
from embodichain.recording import McapRecorder, batches, recorder, seen_together, steady_log
from embodichain.recording.options import RecordOptions
from embodichain.recording.replay import verify
from tests.helpers.writing_here import write_here

STEPS = 150  # numbers of steps become longer after 127


def messages(path):
    """Topic to times and contents, in the order of the file."""
    found = defaultdict(list)
    with recording.open(path) as log:
        for topic, time_ns, data in log.raw_messages():
            found[topic].append((time_ns, bytes(data)))
    return found


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Records a task with the writer in this process; messages, and steps written together."""
    write_here(monkeypatch.setattr)
    monkeypatch.setattr(recorder, "time", SimpleNamespace(time_ns=lambda: 10**18))
    steps = []
    finish = steady_log.SteadySteps.finish

    def counted(self):
        steps.append(self.count)
        finish(self)

    monkeypatch.setattr(steady_log.SteadySteps, "finish", counted)

    def run(name, task, *overrides, num_envs=4, act=None, **options):
        steps.clear()
        env = embodichain.make(task, num_envs, overrides)
        env.reset(seed=0)
        path = tmp_path / name
        log = McapRecorder(path, env, options=RecordOptions(view_envs=[0, 2], **options))
        env.add_observer(log)
        space, generator = env.single_action_space, np.random.default_rng(0)
        for step in range(STEPS):
            part = generator.uniform(0.4, 0.6, (num_envs, *space.shape))
            action = space.low + part * (space.high - space.low)
            env.step(torch.from_numpy(action.astype(np.float32)))
            if act is not None:
                act(env, step)
        env.close()
        return messages(path), sum(steps), path

    return run


def one_by_one(monkeypatch):
    """From here on steps are written alone, and so is what viewers see of each."""
    monkeypatch.setattr(batches, "_MOST_BYTES", 0)
    monkeypatch.setattr(seen_together, "_MOST", 1)


@pytest.mark.parametrize("task", list_options("task"))
def test_steps_of_every_task_are_the_same_together(written, monkeypatch, task):
    together, count, path = written("together.mcap", task, view_hz=12.5)
    assert count > STEPS / 2
    assert verify(path).ok
    one_by_one(monkeypatch)
    alone, none, _ = written("alone.mcap", task, view_hz=12.5)
    assert none == 0
    assert together.keys() == alone.keys()
    for topic, expected in alone.items():
        assert together[topic] == expected, topic


def velocities(env, step):
    env.sim.engine.write("qvel", np.full((env.num_envs, 1), 0.01 * step), None, np.array([0]))


def colours(env, step):
    env.sim.engine.write_model("geom_rgba", 0.001 * step, None, np.arange(3))


def forces(env, step):
    """An input that was not in use, written now and then, to some or to all."""
    if step % 20 == 7:
        env.sim.engine.write("xfrc_applied", 0.1 * step, np.array([1, 3]), np.array([6]))
    elif step > 90:
        env.sim.engine.write("xfrc_applied", 0.01 * step, None, np.array([8, 6]))


def both(env, step):
    """Two writes of one input in a step: the last one counts."""
    env.sim.engine.write("ctrl", 0.1, None, np.array([0]))
    env.sim.engine.write("ctrl", 0.01 * step, None, np.array([0, 2]))


@pytest.mark.parametrize(
    ("act", "options", "some"),
    [
        (velocities, {}, False),  # physics' own columns: those steps are taken one by one
        (both, {}, False),
        (colours, {}, False),
        (forces, {}, True),
        (None, {"every": 2}, True),
        (None, {"state": "none"}, False),
        (None, {"state": "keyframes"}, False),
    ],
    ids=lambda value: getattr(value, "__name__", str(value)),
)
def test_whatever_comes_between_is_the_same_together(written, monkeypatch, act, options, some):
    episode = "task.max_episode_steps=30"
    together, count, path = written("together.mcap", "random_reach", episode, act=act, **options)
    assert bool(count) == some
    if options.get("state") != "none":
        assert verify(path).ok
    one_by_one(monkeypatch)
    assert written("alone.mcap", "random_reach", episode, act=act, **options)[0] == together


def test_rewards_are_shown_with_the_weights_they_had(written, monkeypatch):
    def shown(path):
        with recording.open(path) as log:
            return log.metrics(2)[1]["reward_distance"]

    weights = []

    def change(env, step):
        weights.append(env.reward_manager.weights["distance"])
        if step % 40 == 7:
            env.reward_manager.set_weight("distance", 2.0 * weights[-1])

    unchanged = shown(written("unchanged.mcap", "reach", view_hz=1000)[2])
    together, count, path = written("together.mcap", "reach", act=change, view_hz=1000)
    assert count > STEPS / 2
    assert len(set(weights)) > 3
    assert np.array_equal(shown(path), unchanged * weights)
    one_by_one(monkeypatch)
    weights.clear()
    assert written("alone.mcap", "reach", act=change, view_hz=1000)[0] == together


def test_a_log_of_several_files_verifies_and_each_shows_its_own_steps(written):
    sizes = {"num_envs": 256, "max_mb": 0.5, "view_hz": 1000}
    _, count, path = written("log.mcap", "random_reach", **sizes)
    parts = list(path.parent.glob("*.mcap"))
    assert len(parts) > 1
    assert count
    assert verify(path).ok
    for part in parts:
        found = messages(part)
        steps = {time_ns for time_ns, _ in found["/sim/step"]}
        assert {time_ns for time_ns, _ in found["/env_2/metrics"]} == steps
        # one more where the log ends: the last state
        assert len({time_ns for time_ns, _ in found["/tf"]} - steps) <= 1


@pytest.mark.parametrize("end", ["flush", "close"])
def test_what_viewers_see_is_in_a_log_that_is_not_finished(tmp_path, end):
    env = embodichain.make("random_reach", 2, ())
    env.reset(seed=0)
    path = tmp_path / "log.mcap"
    log = McapRecorder(path, env, options=RecordOptions(view_hz=1000))
    env.add_observer(log)
    for half in range(2):
        for _ in range(7):
            env.step(torch.zeros((2, 6)))
        if half == 0 or end == "flush":
            log.flush()
    if end == "close":
        log._file.close()  # as at the end of a program that closes nothing
    found = messages(path)
    assert len(found["/sim/step"]) == len(found["/env_0/metrics"]) == len(found["/tf"]) == 14
    env.remove_observer(log)
    log.close()
    env.close()

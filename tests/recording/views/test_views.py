"""`Views` with a sink that keeps what it is sent: what is declared, weighed and left alone."""

from types import SimpleNamespace

import numpy as np
import pytest
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from embodichain.lab.gym.envs.managers.term import CommandMarker, CommandTerm
from embodichain.lab.gym.envs.observers import StepObserver, StepRecord
from embodichain.recording.format.messages.schema import scalars_class
from embodichain.recording.format.options import RecordOptions
from embodichain.recording.views.views import Views
from tests.recording.scene import MODEL, SmallEnv

FIELDS = [
    *("reward", "terminated", "truncated", "elapsed_steps"),
    *("reward_near_goal", "reward_effort", "metric_success"),
    *("command_walk_0", "command_walk_1", "command_walk_2"),
]


class Walk(CommandTerm):
    marker = CommandMarker("velocity", MODEL.body("cube").id)

    def __init__(self):
        self.values = np.array([[0.5, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.8, -0.5]])


class Sink:
    def __init__(self):
        self.channels, self.found = {}, []

    def channel(self, topic, schema, data=None):
        assert self.channels.setdefault(topic, (schema, data)) == (schema, data)

    def send(self, time_ns, messages):
        self.found += [(topic, time_ns, data) for topic, data in messages]

    def of(self, topic):
        return [data for found, _, data in self.found if found == topic]


class Watcher(StepObserver):
    """Hands everything to the views."""

    def __init__(self, env, sink):
        self.step = 0
        options = RecordOptions(view_envs=[0, 2], view_hz=1000)
        self.views = Views(env, options, sink, lambda: self.step)

    def on_write(self, env, write):
        if write.op == "model":
            self.views.on_model_write(write)

    def on_physics(self, env, event):
        if event.phase == "before" and event.env_ids is None:
            self.views.on_rows(self.step, event.rows)

    def on_event(self, env, event):
        self.views.on_event(event)

    def on_reset(self, env, env_ids):
        self.views.on_reset(env_ids)

    def on_step(self, env, step):
        self.views.on_step(self.step, step)
        self.step += 1

    def on_close(self, env):
        self.views.close(self.step, env.sim.engine.rows)


@pytest.fixture
def watched():
    """An environment with a command, and the sink of its views."""
    env, sink = SmallEnv(), Sink()
    env.command_manager = SimpleNamespace(terms={"walk": SimpleNamespace(instance=Walk())})
    env.reward_manager = SimpleNamespace(weights={"near goal": 3.0, "effort": -0.5})
    env.add_observer(Watcher(env, sink))
    env.reset()
    return env, sink


def test_it_writes_to_declared_channels_only(watched):
    env, sink = watched
    for _ in range(9):
        env.step()
    env.close()
    names = "scene", "joint_states", "markers", "metrics"
    topics = {f"/env_{i}/{name}" for i in (0, 2) for name in names} | {"/tf", "/log"}
    assert set(sink.channels) == {topic for topic, *_ in sink.found} == topics
    assert len(sink.of("/tf")) == 10


def test_reward_terms_are_shown_as_they_add_to_the_reward(watched):
    env, sink = watched
    metrics = scalars_class("Metrics", FIELDS)
    env.step()
    (before,) = map(metrics.FromString, sink.of("/env_2/metrics"))
    assert before.reward < 0
    assert before.reward_near_goal == 3.0 * before.reward
    assert before.command_walk_1 == 0.8
    env.reward_manager.weights = {"near goal": 0.5, "effort": -0.5}
    env.step()
    _, after = map(metrics.FromString, sink.of("/env_2/metrics"))
    assert after.reward_near_goal == 0.5 * after.reward


def test_other_scalars_than_the_first_steps_are_refused(watched):
    env, sink = watched
    env.step()
    flags = np.zeros(3, np.bool_)
    info = {"elapsed_steps": np.zeros(3), "rewards": {"near goal": np.zeros(3)}}
    step = StepRecord(2, np.zeros((3, 2)), np.zeros(3, np.float32), flags, flags, info, {}, flags)
    with pytest.raises(ValueError, match="not those of the first one"):
        env.observers[0].on_step(env, step)


def test_looks_are_those_at_the_time_of_the_sample_and_the_engines_model_is_left_alone(watched):
    env, sink = watched
    geom = MODEL.geom("cube/geom").id
    column = np.array([4 * geom])
    engine = env.sim.engine
    engine.write_model("geom_rgba", 0.25, np.array([2]), column)
    engine.write_model("geom_rgba", 0.75, np.array([2]), column)
    column[:] = 0  # the caller's own again
    env.step()
    assert [_red(data) for data in sink.of("/env_2/scene")] == [0.75]
    assert [_red(data) for data in sink.of("/env_0/scene")] == [0.0]
    assert engine.model.geom_rgba[geom, 0] == 0.0
    engine.write_model("geom_rgba", 0.5, np.array([2]), np.array([4 * geom]))
    env.step()
    assert len(sink.of("/env_2/scene")) == 1  # until a reset, or until it is asked for
    env.observers[0].views.show([1, 2])
    env.step()
    assert [_red(data) for data in sink.of("/env_2/scene")] == [0.75, 0.5]
    assert len(sink.of("/env_0/scene")) == 1


def _red(data):
    (cube,) = (e for e in SceneUpdate.FromString(data).entities if e.id.endswith("/cube"))
    return round(cube.cubes[0].color.r, 6)

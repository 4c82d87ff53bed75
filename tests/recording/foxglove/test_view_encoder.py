"""What the simulation pushes for people is plain data, enough for another process."""

import pickle
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from embodichain.lab.gym.envs.managers.term import CommandMarker, CommandTerm
from embodichain.lab.gym.envs.observers import EventRecord, StepObserver
from embodichain.recording.attachments import load_mjb, model_bytes
from embodichain.recording.foxglove.view_encoder import PUSHED, ViewEncoder
from embodichain.recording.foxglove.view_spec import ViewSpec
from embodichain.recording.foxglove.views import Views
from embodichain.recording.options import RecordOptions
from tests.recording.scene import MODEL, SmallEnv


class Walk(CommandTerm):
    marker = CommandMarker("velocity", MODEL.body("cube").id)

    def __init__(self):
        self.values = np.array([[0.5, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.8, -0.5]])


class Sink:
    """Keeps what is declared and written."""

    def __init__(self):
        self.found = []

    def channel(self, topic, schema, data=None):
        self.found.append((topic, schema, data))

    def send(self, time_ns, messages):
        self.found += [(topic, time_ns, data) for topic, data in messages]


class Watcher(StepObserver):
    """Hands everything to the views."""

    def __init__(self, env, push):
        self.step = 0
        options = RecordOptions(view_envs=[0, 2], view_hz=1000)
        self.views = Views(env, options, push, lambda: self.step)
        self.views.start(env.sim.engine.state_dict()["model"])

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


def run(push):
    """A run in which everything happens that views heed; returns what the encoder is built from."""
    env = SmallEnv()
    env.command_manager = SimpleNamespace(terms={"walk": SimpleNamespace(instance=Walk())})
    env.reward_manager = SimpleNamespace(weights={"near goal": 1.0, "effort": -0.5})
    watcher = Watcher(env, push)
    env.add_observer(watcher)
    env.reset()
    columns = np.array([4 * MODEL.geom("cube/geom").id])
    env.sim.engine.write_model("geom_rgba", 0.75, np.array([2]), columns)
    columns[:] = 0  # the caller's own again
    for _ in range(9):
        env.step()
    env.close()
    return watcher.views.spec


def plain(value):
    """Whether a value is data and nothing else."""
    if isinstance(value, dict):
        return all(plain(item) for pair in value.items() for item in pair)
    if isinstance(value, tuple | list):
        return all(map(plain, value))
    if isinstance(value, np.ndarray):
        return value.dtype != object
    if isinstance(value, slice):
        return plain((value.start, value.stop, value.step))
    return value is None or type(value) in (int, float, bool, str)


@pytest.fixture(scope="module")
def pushed():
    """The calls of a run, each with how it was pickled at once; and the spec."""
    calls = []
    spec = run(lambda method, *args: calls.append((method, args, pickle.dumps(args))))
    return calls, spec


def test_everything_that_may_be_pushed_is_a_method(pushed):
    calls, _ = pushed
    # this run pushes each of them; with `show` rows are known, and no sample is pushed
    assert {method for method, *_ in calls} == PUSHED - {"show"}
    own = {name for name in vars(ViewEncoder) if not name.startswith("_")}
    asked = {"is_due", "look", "scenes_due", "look_often", "numbers_often", "lines_due"}
    assert own == PUSHED | asked


def test_what_is_pushed_is_plain_data(pushed):
    calls, _ = pushed
    for method, args, _ in calls:
        assert plain(args), (method, args)


def test_nobody_writes_into_what_was_pushed(pushed):
    calls, _ = pushed
    for method, args, then in calls:
        assert pickle.dumps(args) == then, method


def test_from_another_process_the_messages_are_the_same(pushed):
    calls, spec = pushed
    near, far = Sink(), Sink()
    here = ViewEncoder(MODEL, spec, near)
    model = load_mjb(model_bytes(MODEL))
    there = ViewEncoder(model, pickle.loads(pickle.dumps(spec)), far)
    for method, args, data in calls:
        getattr(here, method)(*args)
        getattr(there, method)(*pickle.loads(data))
    assert near.found == far.found
    assert len(near.found) > 50


def test_memory_of_what_was_handed_over_is_used_again(pushed):
    """Arrays lie in memory that is lent: nothing may be kept of them, commands the least."""
    calls, spec = pushed
    near, far = Sink(), Sink()
    here, there = ViewEncoder(MODEL, spec, near), ViewEncoder(MODEL, spec, far)

    def lent(method, *args):
        args = pickle.loads(pickle.dumps(args))
        getattr(there, method)(*args)
        for arg in args:
            if isinstance(arg, np.ndarray):
                arg[...] = 77

    for method, args, _ in calls:
        getattr(here, method)(*args)
        if method == "sample":  # as if the rows were known there
            time_ns, rows, scenes, *commands = args
            lent("show", scenes, *commands)
            lent("look", time_ns, rows)
        else:
            lent(method, *args)
    assert {"/env_2/markers", "/tf"} <= {topic for topic, *_ in far.found}
    assert near.found == far.found


def test_it_writes_to_declared_channels_only(pushed):
    calls, spec = pushed
    sink = Sink()
    encoder = ViewEncoder(MODEL, spec, sink)
    for method, args, _ in calls:
        getattr(encoder, method)(*args)
    declared = {topic for topic, schema, _ in sink.found if isinstance(schema, str)}
    assert declared == {"/env_0/metrics", "/env_2/metrics"}
    assert {topic for topic, *_ in sink.found} == declared | set(spec.channels)


def test_what_an_event_drew_is_copied():
    calls = []
    options = RecordOptions(view_envs=[1])
    views = Views(SmallEnv(), options, lambda *call: calls.append(call), lambda: 0)
    drawn = {"mass": np.array([1.0, 2.5, 3.0])}
    views.on_event(EventRecord("weigh", "reset", None, drawn))
    assert len(calls) == 1
    assert plain(calls[0])
    drawn["mass"][:] = 0
    assert calls[0][-1].tolist() == [1.0, 2.5, 3.0]


def test_numbers_without_names_are_refused():
    with pytest.raises(RuntimeError, match="before the names"):
        ViewEncoder(MODEL, ViewSpec(), Sink()).numbers(0, np.zeros((1, 0)))


def test_a_process_that_encodes_starts_without_torch():
    code = (
        "import sys, embodichain.recording.foxglove.view_encoder\n"
        "heavy = 'torch', 'tensordict', 'gymnasium', 'hydra', 'scipy', 'embodichain.lab.gym'\n"
        "print([name for name in heavy if name in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"

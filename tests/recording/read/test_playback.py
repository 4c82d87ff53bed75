"""A recorded environment shown again: the states and the model that physics received."""

import numpy as np
import pytest

import embodichain.recording as recording
from embodichain.lab.gym.envs.observers import StepObserver
from embodichain.recording import RecordOptions
from embodichain.recording.format.log_error import LogError
from embodichain.recording.read.playback import Playback, Span, span_of
from embodichain.utils.errors import ConfigError
from tests.recording.scene import SmallEnv


class _Watched(SmallEnv):
    """Keeps what physics received in every control step: rows and masses."""

    def __init__(self, seen, **kwargs):
        super().__init__(**kwargs)
        self.add_observer(_Watcher(seen))


class _Watcher(StepObserver):
    def __init__(self, seen):
        self.seen = seen

    def on_physics(self, env, event):
        if event.phase == "before" and event.env_ids is None:
            fields = env.sim.engine
            self.seen.append((event.rows.copy(), fields.model_field("body_mass").copy()))


@pytest.mark.parametrize("settle", [0, 4])
@pytest.mark.parametrize("push", [False, True])
@pytest.mark.parametrize("before", [0, 9])
def test_rows_and_masses_are_those_of_each_step(record, settle, push, before):
    seen = []
    path = record(env=_Watched, seen=seen, settle=settle, push=push, before=before)
    seen = seen[-20:]
    with recording.open(path) as log:
        for env in range(3):
            playback = Playback(log, env)
            steps = []
            for step in playback.steps(Span()):
                rows, mass = seen[step]
                assert playback.engine.rows[0].tobytes() == rows[env].tobytes(), (env, step)
                assert np.array_equal(playback.engine.model_field("body_mass")[0], mass[env])
                steps.append(step)
            assert steps == list(range(20))


class _Stepwise(SmallEnv):
    """Writes controls before every physics step."""

    def __init__(self, seen, **kwargs):
        super().__init__(**kwargs)
        self.physics_steps_per_call, self.seen = 1, seen

    def step_physics(self):
        engine = self.sim.engine
        for step in range(self.sim_steps_per_control):
            engine.write("ctrl", 0.3 * step)
            if not step:
                self.seen.append(engine.rows.copy())
            engine.step(1)


@pytest.mark.parametrize("settle", [0, 1, 4])
@pytest.mark.parametrize("before", [0, 9])
def test_states_of_steps_with_several_physics_calls(record, settle, before):
    seen = []
    path = record(env=_Stepwise, seen=seen, settle=settle, before=before)
    seen = seen[-20:]
    assert recording.verify(path).ok
    with recording.open(path) as log:
        playback = Playback(log, 1)
        for step in playback.steps(Span()):
            assert playback.engine.rows[0].tobytes() == seen[step][1].tobytes(), step
        assert step == 19


def test_pictures_and_views_of_steps_with_several_physics_calls(record):
    def messages(path):
        with recording.open(path) as log:
            start_ns, found = log.header.start_ns, list(log.reader.messages())
        return [(topic, time - start_ns) for topic, time, _ in found if "/env_" in topic]

    several = messages(record(name="a.mcap", env=_Stepwise, seen=[]))
    assert several and several == messages(record(name="b.mcap"))


def test_a_range_and_every_third(record):
    with recording.open(record()) as log:
        assert list(Playback(log, 1).steps(Span(4, 12), every=3)) == [4, 7, 10]
        assert list(Playback(log, 1).steps(Span(18))) == [18, 19]
        assert list(Playback(log, 1).steps(Span(30))) == []


def test_spans_of_episodes(record):
    # environment 0 has episodes of 7 steps, 2 of 9
    with recording.open(record()) as log:
        assert span_of(log, 0) == Span(0, None)
        assert span_of(log, 0, 1) == Span(7, 13)
        assert span_of(log, 2, 1, first=3, last=11) == Span(9, 11)
        assert span_of(log, 2, 2) == Span(18, 19)
        for arguments, message in (
            ((3,), "no environment 3 in the log: there are 0 to 2"),
            ((0, 5), "no episode 5 of environment 0 in the log: there are 0 to 2"),
            ((0, 1, 14), "no control steps from 14 to 13"),
            ((0, None, -1), "no control steps from -1"),
        ):
            with pytest.raises(ConfigError, match=message):
                span_of(log, *arguments)


def test_a_log_without_states(record):
    path = record(options=RecordOptions(state="none"))
    with recording.open(path) as log, pytest.raises(LogError, match=r"record\.state=none"):
        Playback(log, 0)


def test_a_cut_log_is_played_to_its_last_whole_step(record, tmp_path):
    whole = record(steps=150, num_envs=64)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size * 2 // 3])
    with recording.open(cut) as log:
        steps = list(Playback(log, 3).steps(Span()))
        assert steps == list(range(len(log.read("rewards"))))
        assert 10 < len(steps) < 150

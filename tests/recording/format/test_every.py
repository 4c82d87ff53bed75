"""`record.every`: only every k-th episode is in the log, and that says so."""

import json

import pytest
import torch

import embodichain
import embodichain.recording as recording
from embodichain.cli import main
from embodichain.recording import McapRecorder, RecordOptions, inspect, verify
from embodichain.recording.read.playback import Playback, Span
from tests.recording.runs import changed, flip
from tests.recording.scene import SmallEnv

# Environment 0 has episodes of 7 steps: 0 to 6, 21 to 27, 42 to 48 of every third.
WANTED = [*range(7), *range(21, 28), *range(42, 49)]
NOTE = "only one in 3 episodes of environment 0 is in the log"


@pytest.mark.parametrize("state", ["all", "keyframes"])
@pytest.mark.parametrize("case", [{}, {"settle": 4}, {"settle": 25}, {"push": True}], ids=str)
def test_the_episodes_that_are_there_are_whole(record, state, case):
    options = RecordOptions(state, every=3, keyframe_every=5)
    whole, some = record("a.mcap", 60, **case), record("b.mcap", 60, options, **case)
    report = verify(some)
    assert report.ok, str(report)
    assert report.steps == len(WANTED)
    assert report.notes == [NOTE]
    assert verify(some, env=0, episode=3).steps == 7
    with recording.open(whole) as a, recording.open(some, simulate=True) as b:
        expected, found = a.read(), b.read()
        assert found.steps.tolist() == WANTED
        for field in expected:
            assert expected[field][WANTED].tobytes() == found[field].tobytes(), field
        assert b.read("qpos", env=0, episode=6).steps.tolist() == list(range(42, 49))
        assert len(b.read("rewards", env=0, episode=5)) == 0
        # Every reset that led to a recorded step has told what it drew; behind a gap with it.
        wanted = [e for e in a.events() if e.step in {*WANTED, 20, 41}]
        drawn = [(e.step + (e.step in {20, 41}), e.term) for e in wanted]
        assert [(e.step, e.term) for e in b.events()] == drawn
        assert list(Playback(b, 0).steps(Span(21, 27))) == list(range(21, 28))


def test_every_episode_is_told_of(record):
    whole, some = record("a.mcap", 60), record("b.mcap", 60, RecordOptions(every=3))
    with recording.open(whole) as a, recording.open(some) as b:
        ended = [e for e in a.episodes if e.truncated]
        assert [e for e in b.episodes if e.truncated] == ended
        assert b.warnings == []
    found = inspect(some).episodes
    assert [(e.env, e.episode, e.steps) for e in found] == [
        (e.env, e.episode, e.steps) for e in inspect(whole).episodes
    ]


def test_it_is_smaller(record):
    whole, some = record("a.mcap", 400), record("b.mcap", 400, RecordOptions(every=10))
    head = record("c.mcap", 0).stat().st_size
    assert some.stat().st_size - head < 0.25 * (whole.stat().st_size - head)


def test_viewers_see_the_scene_again(record):
    path = record("b.mcap", 60, RecordOptions(every=3, view_envs=(1,), view_hz=1000))
    with recording.open(path) as log:
        scenes = [t for topic, t, _ in log.raw_messages() if topic == "/env_1/scene"]
        frames = [t for topic, t, _ in log.raw_messages() if topic == "/tf"]
        start, period = log.header.start_ns, log.header.period_ns
    # Environment 1 leads: episodes of 8 steps.
    wanted = [*range(8), *range(24, 32), *range(48, 56)]
    assert [(t - start) // period for t in frames][: len(wanted)] == wanted
    assert [(t - start) // period for t in scenes][:3] == [0, 24, 48]


def test_a_changed_step_is_found(record, tmp_path):
    path = record("b.mcap", 60, RecordOptions(every=3))
    path = changed(path, tmp_path / "c.mcap", 23, "physics", "rows", flip((1, 2)))
    difference = verify(path).difference
    assert (difference.step, difference.env, difference.field) == (23, 1, "qpos[1]")


def test_it_rolls_as_well(tmp_path):
    env = SmallEnv()
    options = RecordOptions(every=3, max_mb=0.01)
    recorder = McapRecorder(tmp_path / "rollout.mcap", env, options=options)
    env.add_observer(recorder)
    env.reset()
    for _ in range(300):
        env.step()
        recorder.flush()
    env.close()
    assert len(list(tmp_path.glob("*.mcap"))) > 1
    for path in tmp_path.glob("*.mcap"):
        assert verify(path).ok, path
    with recording.open(tmp_path) as log:
        steps = log.read("qpos").steps
    assert steps.tolist() == [s for s in range(300) if s // 7 % 3 == 0]


def test_a_run_with_a_reset_between_steps(tmp_path):
    env = SmallEnv(settle=4)
    recorder = McapRecorder(tmp_path / "log.mcap", env, options=RecordOptions(every=2))
    env.add_observer(recorder)
    env.reset()
    env.reset()  # nobody has stepped: still the first episode
    for step in range(30):
        if step % 5 == 0:
            env.reset()
        env.step()
    env.close()
    report = verify(tmp_path / "log.mcap")
    assert report.ok, str(report)
    with recording.open(tmp_path / "log.mcap") as log:
        assert log.read("qpos").steps.tolist() == [s for s in range(30) if s // 5 % 2 == 0]


def test_from_the_command_line(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    words = ["task=random_reach", "max_steps=12", "task.max_episode_steps=3", "episodes=9"]
    assert main(["run", *words, "record.every=2", "--quiet"]) == 0
    capfd.readouterr()
    assert main(["replay", "last", "--verify", "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["steps"] == 6


def test_an_episode_behind_a_gap_is_restored(tmp_path):
    whole, some = (
        embodichain.make("random_reach", num_envs=2, overrides=["seed=3"]) for _ in range(2)
    )
    for env, name, every in ((whole, "a.mcap", 1), (some, "b.mcap", 2)):
        env.add_observer(McapRecorder(tmp_path / name, env, options=RecordOptions(every=every)))
        env.reset()
        for step in range(3 * env.max_episode_steps):
            env.step(torch.full(env.action_space.shape, 0.1 * (step % 3)))
        env.close()
    fresh = embodichain.make("random_reach", num_envs=1)
    states = []
    for name in ("a.mcap", "b.mcap"):
        with recording.open(tmp_path / name) as log:
            for step in (0, 4):
                fresh.restore(log, env=1, episode=2, step=step)
                states.append(fresh.sim.engine.rows.tobytes())
    assert states[:2] == states[2:]
    fresh.close()

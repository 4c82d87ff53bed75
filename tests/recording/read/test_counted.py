"""Which episodes of a log count: said by its header, or listed while it is written."""

import pytest
import torch

import embodichain
import embodichain.recording as recording
from embodichain.recording import McapRecorder, RecordOptions
from embodichain.recording.format.log_error import LogError
from embodichain.recording.read.recover import recover
from tests.recording.rewrite import rewrite

STEPS = 20
"""Of episodes of 6 control steps: three of each environment end, a fourth is cut by the log."""


def played(path, during=None, **about):
    """A log of two environments of `reach`; `during(recorder, step)` is called after each step."""
    env = embodichain.make("reach", num_envs=2, overrides=["task.max_episode_steps=6"])
    recorder = McapRecorder(path, env, **about)
    env.add_observer(recorder)
    env.reset()
    for step in range(STEPS):
        env.step(torch.zeros(env.action_space.shape))
        if during is not None:
            during(recorder, step)
    env.close()
    if about.get("lists_counted"):
        recorder.count([0], [0])  # closed: nothing happens
    return path


def counted_in(path):
    with recording.open(path) as log:
        return {(e.env, e.episode): e.counted for e in log.episodes}


@pytest.mark.parametrize("state", ["all", "none"])
def test_the_first_of_each_environment_count(tmp_path, state):
    options = RecordOptions(state=state)
    path = played(tmp_path / "a.mcap", options=options, quota=[1, 9])
    expected = {(0, 0): True, (0, 1): False, (0, 2): False}
    expected |= dict.fromkeys([(1, 0), (1, 1), (1, 2)], True)
    if state == "all":  # what the log cut short is in no result
        expected |= {(0, 3): False, (1, 3): False}
    assert counted_in(path) == expected
    assert recording.inspect(path).counted == 4


def test_a_log_that_does_not_say_is_read(tmp_path):
    path = played(tmp_path / "a.mcap")
    assert set(counted_in(path).values()) == {None}
    assert recording.inspect(path).counted is None

    def older(name, values):
        return {k: v for k, v in values.items() if k not in ("quota", "lists_counted")}

    old = rewrite(path, tmp_path / "old.mcap", metadata=older)
    assert set(counted_in(old).values()) == {None}


@pytest.mark.parametrize("files", [1, 2])
def test_episodes_are_listed_later_in_one_file_or_several(tmp_path, files):
    def during(recorder, step):
        if step == 12 and files == 2:
            recorder.begin_part()
        if step == 13:  # both environments have ended episodes 0 and 1
            recorder.count([0, 1], [0, 1])

    path = played(tmp_path / "a.mcap", during, lists_counted=True)
    assert len(list(tmp_path.glob("*.mcap"))) == files
    found = counted_in(path)
    assert {key for key, value in found.items() if value} == {(0, 0), (1, 1)}
    assert all(value is False for key, value in found.items() if key not in {(0, 0), (1, 1)})
    assert recording.inspect(path).counted == 2
    assert recording.verify(path).ok
    recover(path, tmp_path / "copy.mcap")
    assert counted_in(tmp_path / "copy.mcap") == found


def test_what_is_impossible_is_refused(tmp_path):
    env = embodichain.make("reach", num_envs=2)
    with pytest.raises(ValueError, match="3 numbers for 2 environments"):
        McapRecorder(tmp_path / "a.mcap", env, quota=[1, 1, 1])
    env.close()

    def lists(recorder, step):
        with pytest.raises(ValueError, match="lists_counted=True"):
            recorder.count([0], [0])

    path = played(tmp_path / "b.mcap", lists, quota=[1, 1])
    for number, bad in enumerate(("[1]", "[1, -1]", "[1, true]", "3")):

        def change(name, values, bad=bad):
            return {**values, "quota": bad} if name == "embodichain" else values

        wrong = rewrite(path, tmp_path / f"bad{number}.mcap", metadata=change)
        with pytest.raises(LogError, match="damaged"):
            recording.open(wrong)


def test_a_damaged_list_is_refused(tmp_path):
    def during(recorder, step):
        if step == 13:
            recorder.count([0, 1], [0, 1])

    path = played(tmp_path / "a.mcap", during, lists_counted=True)

    def cut(topic, data):
        return data[:-1] if topic == "/counted" else data

    wrong = rewrite(path, tmp_path / "wrong.mcap", message=cut)
    with recording.open(wrong) as log, pytest.raises(LogError, match="counted episodes"):
        _ = log.episodes
    assert not recording.inspect(wrong).complete

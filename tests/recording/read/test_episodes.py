"""What a log tells of the episodes of all environments, viewed or not."""

import numpy as np
import pytest
import torch
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import embodichain
import embodichain.recording as recording
from embodichain.lab.gym.envs.observers import StepRecord
from embodichain.recording import McapRecorder, RecordOptions
from embodichain.recording.format.log_error import DamageError
from embodichain.recording.format.messages.episodes import Ends, EpisodeSums, encode_ends
from embodichain.recording.read.episodes import decode_ends


@pytest.fixture(scope="module", params=["all", "none"])
def played(request, tmp_path_factory):
    """A log of `reach`, environment 0 viewed, and what `step` said at the end of each episode."""
    path = tmp_path_factory.mktemp("episodes") / "rollout.mcap"
    env = embodichain.make("reach", num_envs=3, overrides=["task.max_episode_steps=6"])
    recorder = McapRecorder(path, env, options=RecordOptions(state=request.param))
    env.add_observer(recorder)
    env.reset()
    told, ids, totals, lengths = {}, [0, 0, 0], np.zeros(3), [0, 0, 0]
    for step in range(20):
        _, reward, terminated, truncated, info = env.step(torch.zeros(env.action_space.shape))
        totals += reward.numpy()
        for i in range(3):
            lengths[i] += 1
            if not (terminated[i] or truncated[i]):
                continue
            told[i, ids[i]] = {
                "last_step": step,
                "steps": lengths[i],
                "total_reward": totals[i],
                "terminated": bool(terminated[i]),
                "truncated": bool(truncated[i]),
                "success": bool(info["success"][i]),
                "rewards": {k: float(v[i]) for k, v in info["episode_sums"].items()},
                "metrics": {k: float(v[i]) for k, v in info["metrics"].items()},
                "fired": {k for k, v in env.termination_manager.values.items() if v[i]},
            }
            ids[i], totals[i], lengths[i] = ids[i] + 1, 0, 0
    env.close()
    return path, told


def test_every_ended_episode_is_told_of(played):
    path, told = played
    with recording.open(path) as log:
        found = {(e.env, e.episode): e for e in log.episodes}
        everything = log.header.state == "all"
    assert len(told) == 9
    assert told.keys() == {k for k, e in found.items() if e.terminated or e.truncated}
    for key, expected in told.items():
        episode = found[key]
        assert expected.pop("fired") <= set(episode.reasons)
        assert expected["rewards"] and expected["metrics"]
        for name, value in expected.items():
            assert getattr(episode, name) == value, (key, name)
        assert episode.first_step == episode.last_step - episode.steps + 1
        assert episode.success == (episode.metrics["success"] > 0)
        assert "success" not in episode.reasons  # a metric ends nothing
    rest = found.keys() - told.keys()
    assert rest == ({(0, 3), (1, 3), (2, 3)} if everything else set())
    assert all(found[key].success is None and not found[key].rewards for key in rest)
    assert list(found) == sorted(found)


@pytest.mark.parametrize("state", ["all", "none"])
@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
def test_episodes_end_where_they_ended_in_either_mode(tmp_path, mode, state):
    """NEXT_STEP resets in a step of its own, which is not a part of an episode."""
    path = tmp_path / "rollout.mcap"
    env = embodichain.make(
        "cart_pole", 2, ["task.max_episode_steps=3"], seed=0, autoreset_mode=mode
    )
    env.add_observer(McapRecorder(path, env, options=RecordOptions(state=state)))
    env.reset()
    for _ in range(7):
        env.step(torch.zeros(2, 1))
    env.close()
    with recording.open(path) as log:
        found = [(e.first_step, e.last_step, e.truncated) for e in log.episodes if e.env == 0]
        assert all(e.total_reward == e.steps for e in log.episodes)
        if mode == "NextStep" and state == "all":
            end = log.snapshot(env=0, step=3)
            assert (end.episode, end.elapsed) == (0, 3)
    expected = {
        "SameStep": [(0, 2, True), (3, 5, True), (6, 6, False)],
        "NextStep": [(0, 2, True), (4, 6, True)],
    }[mode]
    assert found == [end for end in expected if state == "all" or end[2]]
    assert [
        (e.first_step, e.last_step) for e in recording.inspect(path).episodes if e.env == 0
    ] == [end[:2] for end in expected if end[2]]


def test_other_libraries_read_it(played):
    path, told = played
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        messages = [m for *_, m in reader.iter_decoded_messages(topics=["/episode"])]
    assert sum(len(m.env_ids) for m in messages) == len(told)
    first = messages[0]
    assert list(first.env_ids) == sorted(first.env_ids)
    sums = np.array(first.reward_sums).reshape(len(first.env_ids), len(first.reward_term))
    expected = told[first.env_ids[0], first.episode_id[0]]["rewards"]
    assert dict(zip(first.reward_term, sums[0].tolist(), strict=True)) == expected


def step_of(reward, episodes, terminated):
    n = len(reward)
    flags = np.array(terminated), np.zeros(n, bool)
    return StepRecord(1, np.zeros((n, 1)), np.array(reward), *flags, {}, {}, np.array(episodes))


def test_an_explicit_reset_begins_a_new_sum():
    sums = EpisodeSums(2)
    for reward, episodes, terminated in (
        ([1.0, 1.0], [0, 0], [False, False]),
        ([2.0, 2.0], [1, 0], [True, True]),
    ):
        record = step_of(reward, episodes, terminated)
        sums.add(record.reward, record.episode_ids)
    data = encode_ends(1, Ends.of(record, {}, judged=True), sums, record.episode_ids)
    first, second = decode_ends(data)
    assert (first.total_reward, first.steps, first.episode) == (2.0, 1, 1)
    assert (second.total_reward, second.steps, second.episode) == (3.0, 2, 0)
    assert (second.success, second.reasons, second.rewards) == (None, (), {})


def test_damaged_messages_are_read_or_refused():
    record = step_of([1.0, 1.0], [0, 0], [True, True])
    sums = EpisodeSums(2)
    sums.add(record.reward, record.episode_ids)
    data = encode_ends(3, Ends.of(record, {"fell": [1, 0]}, judged=True), sums, record.episode_ids)
    assert [e.reasons for e in decode_ends(data)] == [("fell",), ()]
    for cut in range(1, len(data)):
        try:
            found = decode_ends(data[:cut])
        except DamageError:
            continue
        assert [e.total_reward for e in found] in ([], [1.0, 1.0])

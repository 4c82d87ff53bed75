"""Demonstrations in the replay buffers of off-policy algorithms."""

import numpy as np
import pytest
from stable_baselines3.common.vec_env import VecNormalize

from embodichain.config import resolve
from embodichain.learning import SB3VecEnv
from embodichain.learning.checkpoints.plain_state import read_tree
from embodichain.learning.cloning.demonstrations import Demonstrations, fill, learn_scales
from embodichain.learning.training.train import train
from embodichain.utils.errors import ConfigError
from tests.learning.counting import CountingEnv
from tests.learning.recorded import Recorded, record
from tests.learning.sb3.test_algorithms import algorithm

pytestmark = pytest.mark.slow

LENGTHS = (5, 3, 7, 2)
LOW, HIGH = np.float32([-3.0, 0.5]), np.float32([1.0, 20.0])


def episodes():
    """Episodes whose every number is another one; the second terminates."""
    draw = np.random.default_rng(0)
    return [
        Recorded(
            {
                "where/id": np.full((length + 1, 1), k, np.float32),
                "time": np.stack([np.full(length + 1, k), np.arange(length + 1)], 1),
                "other": np.zeros((length + 1, 2), np.float32),
            },
            draw.uniform(LOW, HIGH, (length, 2)).astype(np.float32),
            draw.normal(size=length).astype(np.float32),
            terminated=k == 1,
        )
        for k, length in enumerate(LENGTHS)
    ]


def expected():
    """Transitions as rows: observation, next one, action in [-1, 1], reward, terminal."""
    rows = []
    for one in episodes():
        seen = np.concatenate([one.observations["where/id"], one.observations["time"]], axis=1)
        action = 2 * (one.actions - LOW) / (HIGH - LOW) - 1
        for t in range(len(action)):
            terminal = one.terminated and t == len(action) - 1
            rows.append([*seen[t], *seen[t + 1], *action[t], one.rewards[t], terminal])
    return np.array(rows)


def transitions(buffer):
    """(n, ...) the transitions in a buffer as rows, as targets of one step use them."""
    n = buffer.pos
    dones = buffer.dones[:n] * (1 - buffer.timeouts[:n])
    parts = [buffer.observations, buffer.next_observations, buffer.actions]
    flat = [part[:n].reshape(n * buffer.n_envs, -1) for part in parts]
    return np.concatenate([*flat, buffer.rewards[:n].reshape(-1, 1), dones.reshape(-1, 1)], axis=1)


def by_row(rows):
    return rows[np.lexsort(np.round(rows, 4).T)]


@pytest.mark.parametrize("envs", [1, 3, 17, 20])
def test_every_transition_is_in_the_buffer(envs):
    vec_env = SB3VecEnv(CountingEnv([0] * envs, low=LOW, high=HIGH))
    model = algorithm("sac", buffer_size=400, n_steps=3, gamma=0.5).build(vec_env, seed=0)
    found = Demonstrations.of(episodes(), vec_env)
    added = fill(model.replay_buffer, found)
    assert added == -(-17 // envs) * envs and model.replay_buffer.pos * envs == added
    wanted, have = expected(), transitions(model.replay_buffer)
    if added == 17:
        np.testing.assert_allclose(by_row(have), by_row(wanted), atol=1e-5)
    for row in have:
        assert np.abs(wanted - row).max(axis=1).min() < 1e-5
    for row in wanted:
        assert np.abs(have - row).max(axis=1).min() < 1e-5


def test_returns_of_several_steps_end_where_an_episode_was_cut():
    """Each sampled return is the discounted sum of rewards of consecutive steps of one episode."""
    vec_env = SB3VecEnv(CountingEnv([0] * 3, low=LOW, high=HIGH))
    model = algorithm("sac", buffer_size=60, n_steps=3, gamma=0.5).build(vec_env, seed=0)
    fill(model.replay_buffer, Demonstrations.of(episodes(), vec_env))
    rewards = [one.rewards for one in episodes()]
    batch = model.replay_buffer.sample(500)
    parts = (batch.observations, batch.next_observations, batch.rewards)
    for seen, later, total in zip(*(part.numpy() for part in parts), strict=True):
        episode, start, stop = int(seen[1]), int(seen[2]), int(later[2])
        assert later[1] == episode and 1 <= stop - start <= 3
        wanted = sum(0.5**k * r for k, r in enumerate(rewards[episode][start:stop]))
        assert total[0] == pytest.approx(wanted, abs=1e-5)


def test_a_buffer_without_room_says_what_is_needed():
    vec_env = SB3VecEnv(CountingEnv([0] * 3, low=LOW, high=HIGH))
    model = algorithm("td3", buffer_size=12).build(vec_env, seed=0)
    with pytest.raises(ConfigError) as caught:
        fill(model.replay_buffer, Demonstrations.of(episodes(), vec_env))
    assert str(caught.value) == (
        "algo.buffer_size: has room for 12 transitions, the data set has 17"
    )


def test_scales_are_those_of_the_demonstrations():
    vec_env = SB3VecEnv(CountingEnv([0, 0], low=LOW, high=HIGH))
    normalizer = VecNormalize(vec_env, gamma=0.5)
    found = Demonstrations.of(episodes(), vec_env)
    learn_scales(normalizer, found, rewards=True)
    seen = np.concatenate([one.observations["time"] for one in episodes()])
    np.testing.assert_allclose(normalizer.obs_rms.mean[1:], seen.mean(axis=0), rtol=1e-3)
    np.testing.assert_allclose(normalizer.obs_rms.var[1:], seen.var(axis=0), rtol=1e-3)
    returns = []
    for one in episodes():
        running = 0.0
        for reward in one.rewards:
            running = 0.5 * running + reward
            returns.append(running)
    assert normalizer.ret_rms.var == pytest.approx(np.var(returns), rel=1e-3)


SAC = (
    *("task=reach", "task.max_episode_steps=6", "num_envs=4", "sim.num_threads=1", "seed=1"),
    *("algo=sac", "algo.buffer_size=400", "algo.learning_starts=8", "algo.normalize=both"),
    *(f"dataset={__file__}", "algo.policy_kwargs={net_arch: [8]}", "checkpoint.every_steps=16"),
)


def reached(env):
    return record(env, lambda obs: 0.1 * np.tile(obs["to_goal"], 2), 6)


def test_a_training_begins_with_them(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir(), second.mkdir()
    kept = "checkpoint.replay_buffer=true"
    summary = train(resolve([*SAC, kept, "total_timesteps=32"], "train"), first, episodes=reached)
    assert summary.demonstrations == 4
    arrays = read_tree(first / "checkpoints/final.replay.npz")["arrays"]
    assert arrays["rewards"].shape == (6 + 8 + 1, 4)  # recorded, played, the next one
    actions = arrays["actions"][:6].reshape(24, 6)
    np.testing.assert_allclose(actions[:, :3], actions[:, 3:], atol=1e-6)  # as `reached` acts
    assert np.abs(actions).max() < 0.05 < np.abs(arrays["actions"][6:8]).max()
    assert arrays["dones"][:6].sum() == arrays["timeouts"][:6].sum() == 4
    # Without the buffer in the checkpoint, a resumed training begins with them again.
    few = [*SAC, "total_timesteps=48", f"resume={first}"]
    train(resolve([*few, kept], "train"), second, episodes=reached)
    arrays = read_tree(second / "checkpoints/final.replay.npz")["arrays"]
    assert arrays["rewards"].shape == (6 + 12 + 1, 4)


@pytest.mark.parametrize("wrong", [[1.0, 2.0], [[1.0, 2.0, 3.0]]])
def test_actions_of_another_width(wrong):
    vec_env = SB3VecEnv(CountingEnv([0], low=LOW, high=HIGH))
    with pytest.raises(ValueError, match=r"instead of \(2,\)"):
        vec_env.recorded_actions(np.array(wrong))


def test_actions_are_scaled_back():
    vec_env = SB3VecEnv(CountingEnv([0], low=LOW, high=HIGH))
    given = np.float32([[-1, 1], [0.25, -0.5], [0, 0]])
    vec_env.reset()
    for row in given:
        vec_env.step(row[None])
    sent = np.concatenate([action.numpy() for action in vec_env.base.actions])
    np.testing.assert_allclose(vec_env.recorded_actions(sent), given, atol=1e-6)
    beyond = np.float32([[-9, 99]])
    np.testing.assert_array_equal(vec_env.recorded_actions(beyond), [[-1, 1]])


def test_entries_stay_apart_for_policies_that_take_a_dict():
    vec_env = SB3VecEnv(CountingEnv([0], low=LOW, high=HIGH), flatten=False)
    found = Demonstrations.of(episodes(), vec_env)
    assert set(found.observations) == {"where/id", "time"}
    rows = found.rows(found.before[[0, 5]])
    np.testing.assert_array_equal(rows["time"], [[0, 0], [1, 0]])
    assert found.steps == 17 and found.lengths.tolist() == list(LENGTHS)
    model = algorithm("sac", policy="MultiInputPolicy", buffer_size=60).build(vec_env, seed=0)
    assert fill(model.replay_buffer, found) == 17
    np.testing.assert_array_equal(model.replay_buffer.next_observations["time"][4, 0], [0, 5])


def test_other_demonstrations_have_another_checksum():
    vec_env = SB3VecEnv(CountingEnv([0], low=LOW, high=HIGH))
    sums = {Demonstrations.of(episodes()[:k], vec_env).checksum for k in range(1, 5)}
    assert len(sums) == 4
    assert Demonstrations.of(episodes(), vec_env).checksum in sums


def test_entries_that_do_not_fit_are_named():
    vec_env = SB3VecEnv(CountingEnv([0], low=LOW, high=HIGH))
    for change, message in (
        ({"time": np.zeros((6, 3), np.float32)}, r"observation 'time' is \(3,\) instead of \(2,\)"),
        ({"where/id": None}, "no observation 'where/id', there are: time, other"),
    ):
        one = episodes()[0]
        one.observations.update(change)
        one.observations = {k: v for k, v in one.observations.items() if v is not None}
        with pytest.raises(ConfigError, match=message):
            Demonstrations.of([one], vec_env)

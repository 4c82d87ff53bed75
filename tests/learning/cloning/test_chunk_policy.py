"""`ChunkPolicy` and `BehaviorCloning` by themselves, in an environment that counts."""

import zipfile

import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3.common.callbacks import BaseCallback

from embodichain.learning import SB3VecEnv
from embodichain.learning.cloning.behavior_cloning import BehaviorCloning
from embodichain.learning.cloning.chunk_policy import ChunkPolicy, MultiInputChunkPolicy
from embodichain.learning.cloning.chunks import blend
from embodichain.learning.cloning.demonstrations import Demonstrations
from tests.learning.counting import CountingEnv
from tests.learning.recorded import Recorded

BOX = spaces.Box(-np.inf, np.inf, (4,), np.float32)
ACTIONS = spaces.Box(-1.0, 1.0, (2,), np.float32)
OBS = np.random.default_rng(0).normal(size=(5, 4)).astype(np.float32)


def policy(space=BOX, kind=ChunkPolicy, **keys):
    torch.manual_seed(0)
    return kind(space, ACTIONS, lambda _: 1e-3, net_arch=[8], **keys)


def test_a_chunk_begins_with_the_action_of_this_step():
    made = policy(chunk_size=3)
    plan = made.plan(OBS)
    assert plan.shape == (5, 3, 2) and made.has_memory
    # Before they are clipped to what the environment takes.
    first = made._predict(torch.from_numpy(OBS)).detach().numpy()
    np.testing.assert_array_equal(first.clip(-1, 1), plan[:, 0])
    actions, memory = made.predict(OBS)
    np.testing.assert_array_equal(actions, plan[:, 0])
    assert [part.shape for part in memory] == [(5, 3, 2), (5, 3)]


def test_what_was_predicted_before_counts():
    made = policy(chunk_size=2, ensemble_decay=0.0)
    plan = made.plan(OBS)
    _, memory = made.predict(OBS)
    later = OBS[::-1].copy()
    actions, _ = made.predict(later, memory)
    np.testing.assert_allclose(actions, (plan[:, 1] + made.plan(later)[:, 0]) / 2, atol=1e-6)
    starts = np.array([True, False, False, False, True])
    again, _ = made.predict(later, memory, starts)
    np.testing.assert_array_equal(again[starts], made.plan(later)[starts, 0])
    np.testing.assert_array_equal(again[~starts], actions[~starts])


def test_one_action_needs_no_memory():
    made = policy(chunk_size=1)
    actions, memory = made.predict(OBS)
    assert memory is None and not made.has_memory
    np.testing.assert_array_equal(actions, made.plan(OBS)[:, 0])


def test_a_single_observation_gives_a_single_action():
    made = policy(chunk_size=3)
    action, memory = made.predict(OBS[2])
    assert action.shape == (2,) and memory[0].shape == (1, 3, 2)
    np.testing.assert_allclose(action, made.predict(OBS)[0][2], atol=1e-6)


def test_ignored_columns_change_nothing():
    made = policy(ignored=[1, 3])
    assert made.network[0].in_features == 2
    changed = OBS.copy()
    changed[:, [1, 3]] += 7
    np.testing.assert_array_equal(made.plan(changed), made.plan(OBS))
    changed[:, 2] += 7
    assert not np.array_equal(made.plan(changed), made.plan(OBS))


def test_ignored_entries_change_nothing():
    space = spaces.Dict({"far": BOX, "near": BOX, "last": BOX})
    made = policy(space, MultiInputChunkPolicy, ignored=["last"])
    assert made.network[0].in_features == 8
    seen = {"far": OBS, "near": 2 * OBS, "last": 3 * OBS}
    plan = made.plan(seen)
    np.testing.assert_array_equal(made.plan({**seen, "last": OBS}), plan)
    assert not np.array_equal(made.plan({**seen, "near": OBS}), plan)


def test_rows_do_not_depend_on_each_other():
    draw = np.random.default_rng(3)
    chunks = draw.normal(size=(4, 6, 3, 2)).astype(np.float32)
    together, apart = None, [None] * 6
    for step in range(4):
        found, together = blend(chunks[step], together, None, 0.2)
        for i in range(6):
            one, apart[i] = blend(chunks[step, i : i + 1], apart[i], None, 0.2)
            np.testing.assert_array_equal(one[0], found[i])


def test_blending_leaves_its_arguments_alone():
    chunks = np.ones((2, 3, 1), np.float32)
    _, memory = blend(chunks, None, None, 0.1)
    before = [part.copy() for part in memory]
    blend(2 * chunks, memory, np.array([True, False]), 0.1)
    for part, was in zip(memory, before, strict=True):
        np.testing.assert_array_equal(part, was)


def demonstrations(env):
    """Six episodes whose action tells the time: 0.1 a step, and -0.5."""
    episodes = [
        Recorded(
            {
                "where/id": np.full((length + 1, 1), k, np.float32),
                "time": np.stack([np.full(length + 1, k), np.arange(length + 1)], 1),
            },
            np.stack([0.1 * np.arange(length), np.full(length, -0.5)], 1).astype(np.float32),
            np.zeros(length, np.float32),
        )
        for k, length in enumerate((4, 6, 5, 4, 7, 6))
    ]
    return Demonstrations.of(episodes, env)


@pytest.fixture
def clone():
    vec_env = SB3VecEnv(CountingEnv([0, 3], limit=6))
    keys = {"net_arch": [16]}
    model = BehaviorCloning(
        "MlpPolicy", vec_env, 1e-2, 32, chunk_size=3, seed=1, device="cpu", policy_kwargs=keys
    )
    return model, demonstrations(vec_env)


class Watch(BaseCallback):
    """Notes what a callback is told."""

    def __init__(self):
        super().__init__()
        self.rollouts, self.ends = [], []

    def _on_rollout_start(self):
        self.rollouts.append(self.model.num_timesteps)

    def _on_step(self):
        infos, dones = self.locals["infos"], self.locals["dones"]
        self.ends += [(self.num_timesteps, infos[i]["episode"]["l"]) for i in np.flatnonzero(dones)]
        return True


def test_it_learns_what_comes_next(clone):
    model, found = clone
    model.set_demonstrations(found)
    model.learn(20_000)
    plan = model.policy.plan(np.float32([[2, 2, 1]]))  # of the third episode, after one step
    np.testing.assert_allclose(plan[0, :, 0], [0.1, 0.2, 0.3], atol=0.06)
    np.testing.assert_allclose(plan[0, :, 1], -0.5, atol=0.06)


def test_each_environment_plays_one_episode(clone):
    model, found = clone
    model.set_demonstrations(found)
    model.play_every = 160
    watch = Watch()
    model.learn(320, watch)
    # The second environment ends after three steps, and again later: that does not count.
    assert watch.ends == [(160, 3), (160, 6), (320, 3), (320, 6)]
    assert watch.rollouts == list(range(32, 321, 32))
    seeds = [seed for seed, _ in model.env.base.resets if seed is not None]
    assert len(set(seeds)) == 2  # that of the training, and one of all that is played


def test_held_out_episodes_are_not_learned_from(clone):
    model, found = clone
    model.validation_share = 0.5
    model.set_demonstrations(found)
    # How demonstrations are divided shows in nothing but the losses.
    learned, held = (set(found.episode[part._steps]) for part in (model._data, model._held_out))
    assert len(learned) == len(held) == 3 and not learned & held
    again = BehaviorCloning("MlpPolicy", model.env, validation_share=0.5, seed=1, device="cpu")
    again.set_demonstrations(found)
    # The same division, for the same seed.
    np.testing.assert_array_equal(again._data._steps, model._data._steps)


def test_a_chunk_ends_with_its_episode(clone):
    model, found = clone
    model.validation_share = 0.0
    model.set_demonstrations(found)
    # What is learned from: chunks, of which some reach beyond the end of their episode.
    seen, actions, inside = model._data.batch(np.array([2, 3, 4]), 3, torch.device("cpu"))
    np.testing.assert_array_equal(seen[:, 1:], [[0, 2], [0, 3], [1, 0]])
    np.testing.assert_array_equal(inside, [[1, 1, 0], [1, 0, 0], [1, 1, 1]])
    np.testing.assert_allclose(actions[0, :2, 0], [0.2, 0.3])
    np.testing.assert_allclose(actions[2, :, 0], [0.0, 0.1, 0.2])


def test_nothing_to_learn_from(clone):
    with pytest.raises(ValueError, match="call set_demonstrations first"):
        clone[0].learn(64)


def test_a_file_has_no_demonstrations_and_loads(clone, tmp_path):
    model, found = clone
    model.set_demonstrations(found)
    model.learn(64)
    model.save(tmp_path / "model.zip")
    with zipfile.ZipFile(tmp_path / "model.zip") as archive:
        assert b"_held_out" not in archive.read("data")
    again = BehaviorCloning.load(tmp_path / "model.zip", device="cpu")
    seen = np.float32([[0, 0, 1], [1, 1, 2]])
    np.testing.assert_array_equal(again.policy.plan(seen), model.policy.plan(seen))
    assert again.policy.ensemble_decay == model.policy.ensemble_decay

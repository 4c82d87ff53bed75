"""Keys of `algo` that follow the number of environments and the length of the training."""

import pytest

from embodichain.config import resolve, resolve_tree
from embodichain.config.keys.algorithms import ALGORITHMS
from embodichain.config.learning_scale import doubtful_scale, scale_learning
from embodichain.config.resolved import thaw

ON_POLICY = [name for name, (_, keys) in ALGORITHMS.items() if "gae_lambda" in keys.split()]
OFF_POLICY = [name for name, (_, keys) in ALGORITHMS.items() if "gradient_steps" in keys.split()]
TRAIN = ["task=hold_still", "seed=1", "num_envs=64", "total_timesteps=262144"]
"""A task that suggests no algorithm."""


@pytest.mark.parametrize("name", ON_POLICY)
@pytest.mark.parametrize("num_envs", [1, 3, 16, 64, 100, 256, 1024])
@pytest.mark.parametrize("total", [61_440, 262_144, 10_000_000])
def test_a_rollout_follows_environments_and_length(name, num_envs, total):
    chosen = scale_learning({"name": name}, num_envs, total).chosen
    rollout = num_envs * chosen["n_steps"]
    assert 0.9 * 2_048 <= rollout <= 16_384
    assert total // rollout >= 30
    if "batch_size" in ALGORITHMS[name][1].split():
        assert chosen["batch_size"] * 4 == rollout


@pytest.mark.parametrize(("num_envs", "total"), [(1, 5_000), (4, 30_000), (64, 20_000)])
def test_a_short_training_has_smaller_rollouts(num_envs, total):
    chosen = scale_learning({"name": "ppo"}, num_envs, total).chosen
    rollout = num_envs * chosen["n_steps"]
    assert rollout < 2_048
    assert total // rollout >= 30


@pytest.mark.parametrize("num_envs", [1, 2, 3, 4, 7])
def test_no_minibatch_is_a_single_step(num_envs):
    chosen = scale_learning({"name": "ppo"}, num_envs, 10).chosen
    rollout = num_envs * chosen["n_steps"]
    assert chosen["batch_size"] >= 2
    assert rollout % chosen["batch_size"] == 0


@pytest.mark.parametrize("name", OFF_POLICY)
def test_gradient_steps_follow_the_steps_between_updates(name):
    def steps(num_envs, **algo):
        return scale_learning({"name": name, **algo}, num_envs, 10_000).chosen.get("gradient_steps")

    assert [steps(1), steps(16), steps(256)] == [1, 16, 64]
    assert [steps(4, train_freq=8), steps(4, gradient_steps=-1)] == [32, None]


@pytest.mark.parametrize(
    ("name", "key"), [("rsl_rl_ppo", "num_steps_per_env"), ("skrl_ppo", "rollouts")]
)
def test_rollouts_of_tensor_algorithms(name, key):
    def steps(num_envs, total):
        return scale_learning({"name": name}, num_envs, total).chosen[key]

    # Isaac Lab's 24, unless that is a small rollout or leaves few updates.
    assert [steps(4096, 10_000_000), steps(16, 10_000_000), steps(4096, 1_000_000)] == [24, 128, 8]


def test_what_is_given_stays_and_the_rest_fits():
    only_steps = scale_learning({"name": "ppo", "n_steps": 10}, 64, 262_144).chosen
    only_batch = scale_learning({"name": "ppo", "batch_size": 384}, 64, 262_144).chosen
    assert only_steps == {"batch_size": 160}
    assert only_batch == {"n_steps": 30}  # 1,920 steps: five minibatches
    assert not scale_learning({"name": "ppo", "n_steps": 10, "batch_size": 64}, 64, 262_144).chosen


def test_a_training_freezes_and_says_what_was_chosen():
    resolved = resolve(TRAIN, "train")
    assert (resolved.tree["algo"]["n_steps"], resolved.tree["algo"]["batch_size"]) == (32, 512)
    (note,) = (note for note in resolved.notes if note.path == "algo")
    assert note.message == (
        "n_steps=32, batch_size=512 were chosen: 128 updates by rollouts of 2,048 steps "
        "(64 environments x 32)"
    )
    again = resolve_tree(thaw(resolved.tree), "config.yaml", "train", allow_import=True)
    assert again.tree["algo"] == resolved.tree["algo"]
    assert not [note for note in again.notes if note.path == "algo"]


def test_keys_that_the_task_suggests_stay():
    resolved = resolve(["task=reach", "num_envs=16", "total_timesteps=262144", "seed=1"], "train")
    algo = resolved.tree["algo"]
    assert (algo["n_steps"], algo["batch_size"]) == (64, 1024)


def test_a_resumed_training_keeps_what_it_began_with():
    tree = thaw(resolve(TRAIN, "train").tree)
    tree["algo"] |= {"n_steps": None, "batch_size": None}  # as an older version froze it
    kept = resolve_tree({**tree, "resume": "somewhere"}, "config.yaml", "train", allow_import=True)
    assert (kept.tree["algo"]["n_steps"], kept.tree["algo"]["batch_size"]) == (None, None)


def test_few_updates_and_uneven_minibatches_are_said_with_the_key_to_write():
    lines = [*TRAIN, "algo.n_steps=2048", "algo.batch_size=100"]
    notes = {note.path: note for note in resolve(lines, "train").notes}
    assert "2 updates in all" in notes["algo.n_steps"].message
    assert notes["algo.n_steps"].hint == "Write algo.n_steps=32"
    assert "the last minibatch of each epoch has 72" in notes["algo.batch_size"].message
    assert notes["algo.batch_size"].hint == "Write algo.batch_size=32768"
    assert not doubtful_scale({"name": "ppo", "n_steps": 32, "batch_size": 512}, 64, 262_144)
    assert not doubtful_scale({"name": "sac", "n_steps": 3, "gradient_steps": 1}, 64, 262_144)

"""Evaluations: which episodes count, what is said of them, that they are apart from training."""

import numpy as np
import pytest
import torch

from embodichain.learning.evaluation.evaluation import EVAL_SEED_OFFSET, evaluate, quotas
from embodichain.utils.errors import ConfigError

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("episodes", "num_envs", "expected"),
    [(10, 4, [3, 3, 2, 2]), (4, 4, [1, 1, 1, 1]), (2, 3, [1, 1, 0]), (7, 1, [7])],
)
def test_quotas_by_hand(episodes, num_envs, expected):
    assert quotas(episodes, num_envs).tolist() == expected


def test_short_episodes_count_no_more_than_long_ones(make_reach):
    # Odd environments fail in step 4 and 6, even ones end in step 6.
    env = make_reach(4)
    found = evaluate(env, "zero", 10)
    assert (found.episodes, found.complete, found.num_envs) == (10, True, 4)
    assert found.per_episode["env"] == [0, 0, 0, 1, 1, 1, 2, 2, 3, 3]
    assert found.per_episode["length"] == [6, 6, 6, 4, 4, 4, 6, 6, 6, 6]
    assert found.length.mean == pytest.approx(5.4)
    assert found.length.median == 6.0


def test_sums_of_terms_are_the_return(make_reach):
    found = evaluate(make_reach(2, early=False), "random", 5)
    assert sum(found.rewards.values()) == pytest.approx(found.returns.mean, rel=1e-5)
    assert found.success.trials == 5
    assert found.success.count == sum(found.per_episode["success"])
    assert found.returns.mean == pytest.approx(np.mean(found.per_episode["return"]))
    assert found.diverged == 0
    assert found.env_steps == 2 * 3 * 6  # the second environment goes on while the first plays


def test_environment_count_changes_no_episode(make_reach):
    """Environment i's first episodes are the same in any company, as the streams are."""
    few = evaluate(make_reach(2, early=False), "zero", 2).per_episode["return"]
    many = evaluate(make_reach(5, early=False), "zero", 5).per_episode["return"]
    assert many[:2] == few


def test_seed_chooses_episodes_and_is_apart_from_training(make_reach):
    env = make_reach(2, early=False)
    first, again = evaluate(env, "zero", 2, seed=3), evaluate(env, "zero", 2, seed=3)
    assert first.per_episode == again.per_episode
    assert evaluate(env, "zero", 2, seed=4).per_episode != first.per_episode
    assert EVAL_SEED_OFFSET > 2**32 - 1  # the largest of a training
    env.reset(seed=EVAL_SEED_OFFSET + 3)
    total = torch.zeros(2)
    for _ in range(6):
        total += env.step(torch.zeros(2, 6))[1]
    np.testing.assert_allclose(first.per_episode["return"], total.numpy(), rtol=1e-5)


def test_generators_of_the_caller_are_left_alone(make_reach):
    env = make_reach(2)
    torch.manual_seed(7)
    expected = torch.rand(3)
    torch.manual_seed(7)
    evaluate(env, "zero", 2)
    assert torch.equal(torch.rand(3), expected)


def test_stopped_evaluation_says_so(make_reach):
    found = evaluate(make_reach(2), "zero", 10, watch=lambda counted: counted.steps == 7)
    assert not found.complete
    assert found.episodes == 2
    nothing = evaluate(make_reach(2), "zero", 10, watch=lambda counted: True)
    assert (nothing.episodes, nothing.returns, nothing.rewards) == (0, None, {})
    assert nothing.success is None


def test_a_policy_is_told_of_new_episodes(make_reach):
    class Told:
        def __init__(self):
            self.resets = []

        def __call__(self, obs, env):
            return torch.zeros(env.num_envs, 6)

        def reset(self, env_ids):
            self.resets.append(env_ids if env_ids is None else env_ids.tolist())

    policy = Told()
    with pytest.raises(ConfigError):
        evaluate(make_reach(2), {"func": "tests:nothing"}, 2)
    env = make_reach(2)
    evaluate(env, lambda obs, env: policy(obs, env), 2)
    assert policy.resets == []  # a plain function is not told
    evaluate(env, policy, 2)
    assert policy.resets == [None, [1], [0]]


def test_wrong_calls_are_refused(make_reach):
    env = make_reach(2)
    with pytest.raises(ValueError, match="at least 1, got 0"):
        evaluate(env, "zero", 0)
    with pytest.raises(ValueError, match="from 0 to 4294967295, got -1"):
        evaluate(env, "zero", 1, seed=-1)
    with pytest.raises(ValueError, match="SAME_STEP"):
        evaluate(make_reach(2, "NEXT_STEP"), "zero", 1)
    with pytest.raises(ConfigError, match="no such file or folder: nowhere"):
        evaluate(env, "nowhere/final.zip", 1)

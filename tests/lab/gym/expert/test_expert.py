"""The policy `expert` solves tasks by the steps in their files, and says what fails."""

import numpy as np
import pytest

import embodichain
from embodichain.lab.gym.policies import PlannedPolicy, resolve_policy

pytestmark = pytest.mark.unmeasured


def perform(task, num_envs=16, overrides=(), steps=None, change=None):
    """Runs the expert for an episode; returns successes, the policy and all actions."""
    env = embodichain.make(task, num_envs=num_envs, overrides=["seed=3", *overrides])
    try:
        policy = resolve_policy("expert")
        assert isinstance(policy, PlannedPolicy)
        obs, _ = env.reset()
        if change is not None:
            change(env)
        space, actions, success = env.single_action_space, [], None
        for _ in range(steps or env.max_episode_steps - 1):
            action = policy(obs, env)
            actions.append(action.numpy().copy())
            obs, _, terminated, truncated, info = env.step(action)
            assert not (terminated | truncated).any()
            success = info["metrics"]["success"].numpy() > 0
            if policy.done.all() and success.all():
                break
        actions = np.stack(actions)
        assert (actions >= space.low).all() and (actions <= space.high).all()
        return success, policy, actions
    finally:
        env.close()


@pytest.mark.parametrize(("task", "longest"), [("pick_place", 130)])
def test_the_expert_of_a_task_solves_it(task, longest):
    success, policy, actions = perform(task)
    assert success.all(), policy.failures
    assert policy.failures == [None] * 16
    assert len(actions) <= longest

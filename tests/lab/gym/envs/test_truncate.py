"""`BaseEnv.truncate`: an episode that is ended from outside, as a time-out would end it."""

import numpy as np

from tests.lab.gym.conftest import home


def test_it_ends_episodes_with_the_next_step_and_once(make_env):
    env = make_env(max_episode_steps=5)
    env.reset(seed=1)
    env.step(home(env))
    env.truncate(np.array([1]))
    _, _, terminated, truncated, info = env.step(home(env))
    assert truncated.tolist() == [False, True, False]
    assert not terminated.any()
    assert info["_final_obs"].tolist() == [False, True, False]
    *_, truncated, info = env.step(home(env))
    assert not truncated.any()
    assert info["elapsed_steps"].tolist() == [3, 1, 3]


def test_asked_for_twice_or_of_several_it_is_one_end(make_env):
    env = make_env(max_episode_steps=2)
    env.reset(seed=1)
    env.truncate(np.array([0, 2]))
    env.truncate(np.array([2]))
    assert env.step(home(env))[3].tolist() == [True, False, True]
    assert env.step(home(env))[3].tolist() == [False, True, False]


def test_a_reset_ends_it_as_well(make_env):
    env = make_env(max_episode_steps=5)
    env.reset(seed=1)
    env.truncate(np.array([0, 1]))
    env.reset(options={"reset_ids": [1]})
    assert env.step(home(env))[3].tolist() == [True, False, False]


def test_it_is_part_of_the_state(make_env):
    env, other = make_env(max_episode_steps=5), make_env(max_episode_steps=5)
    for each in (env, other):
        each.reset(seed=1)
    env.truncate(np.array([1]))
    other.load_state_dict(env.state_dict())
    assert other.step(home(other))[3].tolist() == [False, True, False]

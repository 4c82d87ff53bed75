"""Delays and noise between an action and its term."""

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import ActionTermCfg, NoiseCfg
from embodichain.lab.gym.envs.managers import ActionTerm
from embodichain.utils.errors import ConfigError


class Probe(ActionTerm):
    """Remembers what it received; holds at 7."""

    def __init__(self, env, width: int = 1) -> None:
        self.low, self.high = np.full(width, -100.0), np.full(width, 100.0)
        self.got: list[np.ndarray] = []

    def apply(self, action) -> None:
        self.got.append(action.numpy().copy())

    def hold(self) -> np.ndarray:
        return np.full(len(self.low), 7.0)


def probe(make, num_envs: int = 3, **fields):
    env = make(num_envs=num_envs, actions={"a": ActionTermCfg(func=Probe, **fields)})
    env.reset()
    return env, env.action_manager.terms["a"].instance


def count(env, steps) -> None:
    for i in steps:
        env.step(torch.full((env.num_envs, env.action_manager.action_dim), float(i)))


def test_a_delay_of_two_steps(make) -> None:
    env, term = probe(make, delay=2)
    count(env, range(1, 5))
    assert [row[:, 0].tolist() for row in term.got] == [[7] * 3, [7] * 3, [1] * 3, [2] * 3]
    env.reset(options={"reset_ids": [1]})
    count(env, range(5, 8))
    assert [row[:, 0].tolist() for row in term.got[4:]] == [[3, 7, 3], [4, 7, 4], [5, 5, 5]]


def test_a_delay_drawn_by_episode(make) -> None:
    env, term = probe(make, num_envs=64, delay=[0, 3])
    count(env, range(1, 6))
    lags = 5 - term.got[-1][:, 0]
    assert set(lags.tolist()) == {0.0, 1.0, 2.0, 3.0}
    assert np.array_equal(4 - term.got[-2][:, 0], np.where(lags < 4, lags, 0))
    ids = np.arange(0, 64, 2)
    env.reset(options={"reset_ids": ids})
    count(env, range(11, 16))
    again = 15 - term.got[-1][:, 0]
    assert np.array_equal(again[1::2], lags[1::2])
    assert not np.array_equal(again[::2], lags[::2])


def test_environment_i_draws_the_same_for_any_number(make) -> None:
    noise = NoiseCfg(type="gaussian", std=[0.1, 2.0])
    received = []
    for num_envs in (2, 33):
        env, term = probe(make, num_envs, params={"width": 2}, delay=[0, 3], noise=noise)
        count(env, range(6))
        env.reset(options={"reset_ids": [1]})
        count(env, range(6))
        received.append(np.stack(term.got)[:, :2])
    assert received[0].tobytes() == received[1].tobytes()


def test_uniform_noise_is_added_in_units_of_the_action(make) -> None:
    noise = NoiseCfg(type="uniform", low=-0.5, high=1.5)
    env, term = probe(make, num_envs=400, noise=noise)
    count(env, [10.0] * 5)
    drawn = np.concatenate(term.got)[:, 0] - 10
    assert drawn.min() >= -0.5 and drawn.max() <= 1.5
    assert abs(drawn.mean() - 0.5) < 5 * (2 / np.sqrt(12)) / np.sqrt(drawn.size)
    assert len(np.unique(drawn)) > 1990


def test_noise_that_scales(make) -> None:
    env, term = probe(make, noise=NoiseCfg(type="constant", bias=0.5, operation="scale"))
    count(env, [10.0])
    assert term.got[0].tolist() == [[5.0]] * 3


def test_a_restored_environment_continues(make) -> None:
    noise = NoiseCfg(std=1.0)
    env, term = probe(make, delay=[1, 3], noise=noise)
    count(env, range(4))
    saved = env.state_dict()
    count(env, range(4, 8))
    first = np.stack(term.got[4:])
    env.load_state_dict(saved)
    count(env, range(4, 8))
    assert np.array_equal(np.stack(term.got[8:]), first)


def test_without_either_the_term_gets_the_callers_tensor(make) -> None:
    class Keeps(Probe):
        def apply(self, action) -> None:
            self.got.append(action)

    env = make(actions={"a": ActionTermCfg(func=Keeps)})
    env.reset()
    action = torch.ones(3, 1)
    env.step(action)
    assert env.action_manager.terms["a"].instance.got[0] is action


@pytest.mark.parametrize(
    ("fields", "path"),
    [
        ({"delay": [3, 1]}, "actions.a.delay"),
        ({"delay": -1}, "actions.a.delay"),
        ({"noise": NoiseCfg()}, "actions.a.noise.std"),
        ({"noise": NoiseCfg(type="uniform", low=1.0, high=0.0)}, "actions.a.noise"),
        ({"noise": NoiseCfg(std=[1.0, 2.0])}, "actions.a.noise.std"),
    ],
)
def test_wrong_fields(make, fields, path) -> None:
    with pytest.raises(ConfigError) as caught:
        probe(make, **fields)
    assert caught.value.problems[0].path == path

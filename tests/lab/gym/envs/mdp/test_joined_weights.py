"""Terms of a sum have weights; terms of products and of truth values say that they have none."""

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import MetricCfg, RewardCfg, TerminationCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.judging import put
from tests.helpers.ur10_task import HOME

CUBE = {"of": {"uid": "cube"}}
HEIGHT = {"func": "height", "params": CUBE}
ALONG = {"func": "position", "params": {**CUBE, "axes": "x"}}
PLACES = [(-0.7, 3, 9), (0.0, -2, 0.5), (1.5, 0, 4)]
BAD = [np.nan, np.inf]


def play(env):
    env.reset()
    put(env, "cube", PLACES)
    return env.step(torch.tensor([HOME]).repeat(3, 1))


def test_a_sum_has_weights(make) -> None:
    terms = {"far": {**ALONG, "weight": 2.0}, "high": {**HEIGHT, "weight": -0.5}, "none": HEIGHT}
    env = make(
        rewards={
            "sum": RewardCfg(func="sum_of", weight=3.0, params={"terms": terms}),
            "x": RewardCfg(**ALONG, weight=0.25),
            "z": RewardCfg(**HEIGHT, weight=0.25),
        },
        metrics={"sum": MetricCfg(func="sum_of", params={"terms": terms})},
        terminations={
            "sum": TerminationCfg(func="sum_of", shape={"above": 2.0}, params={"terms": terms})
        },
    )
    _, reward, terminated, _, info = play(env)
    x, z = info["rewards"]["x"], info["rewards"]["z"]
    wanted = 2.0 * x - 0.5 * z + z
    np.testing.assert_allclose(info["rewards"]["sum"], wanted, rtol=1e-5)
    np.testing.assert_allclose(info["metrics"]["sum"], wanted, rtol=1e-5)
    np.testing.assert_allclose(reward, 3 * wanted + 0.25 * (x + z), rtol=1e-5)
    assert terminated.tolist() == (wanted > 2.0).tolist() and terminated.any()
    assert not terminated.all()


def test_a_summand_of_weight_0_is_not_evaluated(make) -> None:
    rate = {"func": "action", "shape": [{"rate": "step"}, "l2"], "weight": 1.0}
    still = {"terms": {"rate": {**rate, "weight": 0.0}}}
    moving = {"terms": {"rate": rate}}
    env = make(rewards={"sum": RewardCfg(func="sum_of", params=moving)})
    home = torch.tensor([HOME]).repeat(3, 1)
    env.reset()
    env.step(home)
    env.reward_manager.set_params("sum", still)
    assert env.step(home + 3)[1].tolist() == [0.0] * 3
    env.reward_manager.set_params("sum", moving)
    assert env.step(home + 5)[1].tolist() == [0.0] * 3  # it begins anew: there is no gap
    np.testing.assert_allclose(env.step(home + 6)[1], 6.0, rtol=1e-5)


@pytest.mark.parametrize("func", ["product_of", "all_of", "any_of"])
def test_other_joins_say_that_their_terms_have_no_weight(make, func) -> None:
    terms = {"a": {**HEIGHT, "weight": 2.0}}
    with pytest.raises(ConfigError) as caught:
        make(metrics={"m": MetricCfg(func=func, params={"terms": terms})})
    said = str(caught.value)
    assert "metrics.m.params.terms.a.weight: a term within this one has no weight" in said
    assert "sum_of" in said and "joint_names" not in said


def test_held_for_says_so_too(make) -> None:
    params = {"steps": 2, "term": {**HEIGHT, "weight": 2.0}}
    with pytest.raises(
        ConfigError, match=r"params\.term\.weight: a term within this one has no weight"
    ):
        make(metrics={"m": MetricCfg(func="held_for", params=params)})


@pytest.mark.parametrize("func", ["product_of", "sum_of"])
def test_an_unknown_key_of_an_inner_term_names_the_keys_of_a_term(make, func) -> None:
    terms = {"a": {**HEIGHT, "weigth": 2.0}}
    with pytest.raises(ConfigError) as caught:
        make(metrics={"m": MetricCfg(func=func, params={"terms": terms})})
    said = str(caught.value)
    assert "metrics.m.params.terms.a.weigth: unknown key; allowed: func, params, shape" in said
    assert "joint_names" not in said
    assert ("Did you mean 'weight'" in said) == (func == "sum_of")


@pytest.mark.parametrize("weight", BAD)
def test_a_weight_that_is_not_finite_is_refused(make, weight) -> None:
    terms = {"a": {**HEIGHT, "weight": weight}}
    with pytest.raises(ConfigError, match=r"weight: must be a finite number"):
        make(metrics={"m": MetricCfg(func="sum_of", params={"terms": terms})})
    env = make(
        rewards={
            "m": RewardCfg(func="sum_of", params={"terms": {"a": {**HEIGHT, "weight": 1.0}}}),
        }
    )
    with pytest.raises(ConfigError, match=r"weight: must be a finite number"):
        env.reward_manager.set_params("m", {"terms": terms})
    assert env.reward_manager.params("m")["terms"]["a"]["weight"] == 1.0

"""A quantity may wrap another function, and may take its parameters by keyword only."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from embodichain.lab.gym.envs.cfg import MetricCfg
from embodichain.lab.gym.envs.managers.terms import registry


@pytest.fixture(autouse=True)
def terms_of_this_test(monkeypatch: pytest.MonkeyPatch) -> None:
    """Registered here, and unknown to other tests."""
    len(registry.TERMS["metric"])  # the terms of the package are registered when first read
    registered = {kind: dict(terms) for kind, terms in registry.TERMS.registered.items()}
    monkeypatch.setattr(registry.TERMS, "registered", registered)


def doubled(func: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(func)
    def double(env: Any, **params: Any) -> Any:
        return 2.0 * func(env, **params)

    return double


def test_parameters_reach_a_function_by_the_names_that_it_takes(make) -> None:
    @registry.quantity("metric")
    @doubled
    def wrapped_number(env: Any, first: float = 1.0, second: float = 10.0) -> Any:
        return np.full(env.num_envs, first + second)

    @registry.quantity("metric")
    def keyword_number(env: Any, first: float = 1.0, *, second: float = 10.0) -> Any:
        return np.full(env.num_envs, first + second)

    shaped = {
        "wrapped": MetricCfg(func="wrapped_number", params={"second": 20.0}),
        "keyword": MetricCfg(func="keyword_number", params={"second": 20.0}),
    }
    env = make(metrics=shaped)
    env.reset()
    metrics = env.step(env.robot.get_qpos(target=True))[4]["metrics"]
    assert metrics["wrapped"].tolist() == [42.0] * env.num_envs
    assert metrics["keyword"].tolist() == [21.0] * env.num_envs

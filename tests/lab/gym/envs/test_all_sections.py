"""Mistakes that show when terms are built: those of all sections at once."""

from typing import Any

import pytest

import embodichain
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.utils.errors import ConfigError, Problem


def wrong(section: str) -> Any:
    class Wrong(Term):
        def __init__(self, limit: float = 1.0) -> None:
            raise ConfigError([Problem(f"{section}.mine.params", f"wrong in {section}")])

        def __call__(self, env: Any, obs: Any, action: Any, info: Any) -> Any:
            raise NotImplementedError

    return Wrong


WrongReward, WrongMetric = wrong("rewards"), wrong("metrics")


def test_mistakes_of_two_sections_come_in_one_round():
    here = __name__
    lines = [
        f"+task.rewards.mine={{func: '{here}:WrongReward', weight: 1.0}}",
        f"+task.metrics.mine={{func: '{here}:WrongMetric'}}",
    ]
    with pytest.raises(ConfigError) as refused:
        embodichain.make("cart_pole", overrides=lines)
    said = str(refused.value)
    assert "wrong in rewards" in said and "wrong in metrics" in said

"""Keys whose values are of several kinds: a kind has its own keys, and a default."""

from typing import Any

import pytest

from embodichain.config.keys.check_types import check_types
from embodichain.lab.gym.envs.cfg import GaussianNoiseCfg, UniformNoiseCfg


def noise_of(values: dict[str, Any]) -> tuple[Any, list[str]]:
    """The noise of an observation in YAML, and the mistakes in it."""
    observation = {"func": "last_action", "noise": values}
    check = check_types({"task": {"observations": {"a": observation}}})
    mistakes = [
        str(problem).removeprefix("task.observations.a.noise") for problem in check.problems
    ]
    noise = None if check.root is None else check.root.task.observations["a"].noise
    return noise, mistakes


def test_noise_without_a_type_is_gaussian() -> None:
    assert noise_of({"std": 0.1}) == (GaussianNoiseCfg(std=0.1), [])
    assert noise_of({"type": "uniform", "low": 0, "high": [1, 2]}) == (
        UniformNoiseCfg(low=0.0, high=[1.0, 2.0]),
        [],
    )


@pytest.mark.parametrize(
    ("values", "mistake"),
    [
        (
            {"type": "uniform", "low": 0, "high": 1, "std": 1},
            ".std: unknown key; allowed: type, operation, low, high, n_min, n_max.",
        ),
        ({"std": 1, "bias": 1}, ".bias: unknown key; allowed: type, operation, mean, std."),
        (
            {"type": "constant", "bias": 1, "low": 0},
            ".low: unknown key; allowed: type, operation, bias.",
        ),
        (
            {"type": "triangle", "std": 1},
            ".type: unknown type 'triangle'; one of: gaussian, uniform, constant.",
        ),
        ({"std": "loud"}, ".std: expected a number or a list or a map, got 'loud'"),
    ],
)
def test_noise_with_a_key_of_another_kind_names_those_of_its_kind(
    values: dict[str, Any], mistake: str
) -> None:
    assert noise_of(values)[1] == [mistake]


def test_noise_with_all_keys_of_all_kinds_written_out_is_read() -> None:
    """Tasks that were valid before the kinds had classes stay valid."""
    nulls = dict.fromkeys(["mean", "low", "high", "n_min", "n_max", "bias"])
    assert noise_of({"type": "gaussian", "std": 0.1, **nulls}) == (GaussianNoiseCfg(std=0.1), [])

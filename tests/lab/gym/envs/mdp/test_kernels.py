"""Kernels against their published formulas, and the identities that define them."""

import math

import numpy as np
import pytest

from embodichain.lab.gym.envs.mdp.shapes import SIGMOIDS, Tolerance, gaussian_kernel, tanh_kernel
from embodichain.utils.errors import ConfigError

HALF = {  # value at x = 0.5 where 0.1 is wanted at x = 1, by the formulas of dm_control's paper
    "gaussian": 0.1**0.25,
    "linear": 0.55,
    "hyperbolic": 1 / math.cosh(0.5 * math.acosh(10)),
    "long_tail": 1 / (1 + 9 / 4),
    "cosine": 0.5 * (1 + math.cos(0.5 * math.acos(-0.8))),
    "tanh_squared": 1 - math.tanh(0.5 * math.atanh(math.sqrt(0.9))) ** 2,
    "quadratic": 1 - 0.9 / 4,
    "reciprocal": 1 / (1 + 9 / 2),
}


@pytest.mark.parametrize("sigmoid", sorted(SIGMOIDS))
def test_a_sigmoid_is_one_at_zero_and_the_value_at_the_margin(sigmoid) -> None:
    for value in (0.05, 0.1, 0.7):
        kernel = Tolerance([-1.0, 2.0], 0.5, sigmoid, value)
        at = kernel(np.array([-1.0, 0.3, 2.0, -1.5, 2.5]))
        assert at[:3].tolist() == [1.0, 1.0, 1.0]
        assert np.allclose(at[3:], value, atol=1e-12)


@pytest.mark.parametrize("sigmoid", sorted(SIGMOIDS))
def test_a_sigmoid_halfway_is_its_formula(sigmoid) -> None:
    kernel = Tolerance([0.0, 0.0], 2.0, sigmoid, 0.1)
    assert kernel(np.array([1.0, -1.0])) == pytest.approx([HALF[sigmoid]] * 2, abs=1e-12)


@pytest.mark.parametrize("sigmoid", sorted(SIGMOIDS))
def test_a_sigmoid_falls_and_stays_in_the_unit_interval(sigmoid) -> None:
    x = np.concatenate([np.linspace(0, 5, 400), [1e3, 1e6, math.inf]])
    found = Tolerance([0.0, 0.0], 1.0, sigmoid, 0.1)(x)
    assert (np.diff(found) <= 0).all()
    assert (found >= 0).all() and found[-1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("sigmoid", ["linear", "cosine", "quadratic"])
def test_some_sigmoids_end_at_the_margin(sigmoid) -> None:
    found = Tolerance([0.0, 0.0], 1.0, sigmoid, 0.0)(np.array([0.999, 1.0, 1.5]))
    assert found[0] > 0.0
    assert found[1:] == pytest.approx([0.0, 0.0], abs=1e-15)


def test_no_margin_is_a_step_and_bounds_may_be_infinite() -> None:
    step = Tolerance([1.0, math.inf], 0.0, "gaussian", 0.1)
    assert step(np.array([0.999, 1.0, 1e300])).tolist() == [0.0, 1.0, 1.0]


@pytest.mark.parametrize("sigmoid", sorted(SIGMOIDS))
@pytest.mark.parametrize("margin", [0.0, 1.0])
def test_what_is_no_number_stays_visible(sigmoid, margin) -> None:
    assert np.isnan(Tolerance([0.0, 1.0], margin, sigmoid, 0.1)(np.array([math.nan]))[0])


@pytest.mark.parametrize("sigmoid", sorted(SIGMOIDS))
def test_a_value_at_the_margin_must_suit_the_sigmoid(sigmoid) -> None:
    if sigmoid not in ("linear", "cosine", "quadratic"):
        with pytest.raises(ConfigError, match=r"value_at_margin: must be in \(0, 1\)"):
            Tolerance([0.0, 0.0], 1.0, sigmoid, 0.0)
    with pytest.raises(ConfigError, match="value_at_margin"):
        Tolerance([0.0, 0.0], 1.0, sigmoid, 1.0)


def test_isaac_labs_kernels() -> None:
    assert gaussian_kernel(np.array([0.0, 0.25]), 0.5) == pytest.approx([1.0, math.exp(-1)])
    assert tanh_kernel(np.array([0.0, 0.2]), 0.1) == pytest.approx([1.0, 1 - math.tanh(2)])


@pytest.mark.parametrize("sigmoid", sorted(SIGMOIDS))
def test_a_row_is_the_same_in_any_batch(sigmoid) -> None:
    x = np.linspace(-3, 3, 67)
    kernel = Tolerance([-0.1, 0.2], 0.7, sigmoid, 0.1)
    whole = kernel(x)
    for i in range(0, 67, 5):
        assert kernel(x[i : i + 1]).tobytes() == whole[i : i + 1].tobytes()

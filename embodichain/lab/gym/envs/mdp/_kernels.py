"""Kernels that turn an error into a reward in [0, 1]: `tolerance` and its sigmoids, `exp`, `tanh`.

Pure float64 arithmetic on rows; what is measured is the terms' business.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.api import F64

__all__ = ["SIGMOIDS", "Sigmoid", "Tolerance", "gaussian", "tanh_kernel"]

Sigmoid = Literal[
    "gaussian",
    "linear",
    "hyperbolic",
    "long_tail",
    "cosine",
    "tanh_squared",
    "quadratic",
    "reciprocal",
]

# Each takes x and the value wanted at x = 1. Formulas: dm_control's `rewards` module
# (Tassa et al., "dm_control: Software and tasks for continuous control", 2020, arXiv:2006.12983).


def _gaussian(x: F64, value: float) -> F64:
    scaled = x * math.sqrt(-2.0 * math.log(value))
    return np.exp(-0.5 * scaled * scaled)


def _linear(x: F64, value: float) -> F64:
    return np.maximum(1.0 - x * (1.0 - value), 0.0)


def _hyperbolic(x: F64, value: float) -> F64:
    # cosh overflows to infinity for large errors: the value is then 0, as it should be.
    with np.errstate(over="ignore"):
        return 1.0 / np.cosh(x * math.acosh(1.0 / value))


def _long_tail(x: F64, value: float) -> F64:
    scaled = x * math.sqrt(1.0 / value - 1.0)
    return 1.0 / (scaled * scaled + 1.0)


def _cosine(x: F64, value: float) -> F64:
    # NaN must stay visible, so the far side is cut before the cosine, not chosen after it.
    scaled = np.minimum(x * (math.acos(2.0 * value - 1.0) / math.pi), 1.0)
    return 0.5 * (1.0 + np.cos(math.pi * scaled))


def _tanh_squared(x: F64, value: float) -> F64:
    bent = np.tanh(x * math.atanh(math.sqrt(1.0 - value)))
    return 1.0 - bent * bent


def _quadratic(x: F64, value: float) -> F64:
    scaled = x * math.sqrt(1.0 - value)
    return np.maximum(1.0 - scaled * scaled, 0.0)


def _reciprocal(x: F64, value: float) -> F64:
    return 1.0 / (x * (1.0 / value - 1.0) + 1.0)


SIGMOIDS: dict[str, Callable[[F64, float], F64]] = {
    "gaussian": _gaussian,
    "linear": _linear,
    "hyperbolic": _hyperbolic,
    "long_tail": _long_tail,
    "cosine": _cosine,
    "tanh_squared": _tanh_squared,
    "quadratic": _quadratic,
    "reciprocal": _reciprocal,
}
"""Name -> f(x >= 0, value at 1); each is 1 at 0 and falls."""
_MAY_END = ("linear", "cosine", "quadratic")


class Tolerance:
    """1 within bounds; beyond them a sigmoid of the excess divided by the margin.

    dm_control's `rewards.tolerance`.

    Args:
        bounds: [low, high], in the unit of what is measured; either may be infinite.
        margin: How far outside the value has fallen to ``value_at_margin``; 0 gives 0 everywhere
            outside.
        sigmoid: The shape of the fall.
        value_at_margin: In (0, 1); 0 is allowed for linear, cosine and quadratic.

    Raises:
        ConfigError: If ``value_at_margin`` does not suit the sigmoid.
    """

    def __init__(
        self, bounds: Sequence[float], margin: float, sigmoid: Sigmoid, value_at_margin: float
    ) -> None:
        low = value_at_margin >= 0.0 if sigmoid in _MAY_END else value_at_margin > 0.0
        if not (low and value_at_margin < 1.0):
            allowed = "[0, 1)" if sigmoid in _MAY_END else "(0, 1)"
            message = f"must lie in {allowed} for sigmoid {sigmoid!r}, got {value_at_margin}"
            raise ConfigError([Problem("value_at_margin", message)])
        self._low, self._high = (float(bound) for bound in bounds)
        self._margin = float(margin)
        self._sigmoid, self._value = SIGMOIDS[sigmoid], float(value_at_margin)

    def __call__(self, x: F64) -> F64:
        """Values in [0, 1] of the shape of ``x``; NaN stays NaN."""
        # A bound at infinity is never exceeded: the difference is -inf, and the maximum 0.
        excess = np.maximum(np.maximum(self._low - x, x - self._high), 0.0)
        if self._margin > 0.0:
            return self._sigmoid(np.ascontiguousarray(excess / self._margin), self._value)
        inside: F64 = np.where(excess > 0.0, 0.0, 1.0)
        return np.where(np.isnan(excess), excess, inside)


def gaussian(squared: F64, std: float) -> F64:
    """exp(-e^2 / std^2) of squared errors, the kernel of Isaac Lab's tracking rewards."""
    found: F64 = np.exp(np.ascontiguousarray(squared) * (-1.0 / (std * std)))
    return found


def tanh_kernel(error: F64, std: float) -> F64:
    """1 - tanh(e / std) of errors >= 0, the kernel of Isaac Lab's reaching rewards."""
    found: F64 = 1.0 - np.tanh(np.ascontiguousarray(error) / std)
    return found

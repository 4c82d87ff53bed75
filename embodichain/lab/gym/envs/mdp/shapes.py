"""Shapes: functions of the rows of a quantity; those in `REDUCERS` make one number of several.

``{func: distance, shape: {tanh: 0.1}}``; the shapes of a list are applied in order. Each takes (N,)
or (N, K) float64 or bool. A number in a config instead of a map is the first parameter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import numpy as np
from pydantic import Field

from embodichain.lab.gym.envs.managers.param_types import (
    Bounds,
    BoundsOrBox,
    Finite,
    NonNegative,
    Positive,
)
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.managers.terms.registry import register_shape
from embodichain.lab.gym.envs.mdp._rows import mean, norm, squares, total
from embodichain.utils.arrays import contiguous, may_be_set
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.utils.array_types import Floats

    Mask = NDArray[np.bool_]

__all__ = [
    "SIGMOIDS",
    "Rate",
    "Sigmoid",
    "Tolerance",
    "above",
    "at_most",
    "below",
    "clip",
    "column",
    "excess",
    "gaussian",
    "gaussian_kernel",
    "l1",
    "l2",
    "negative",
    "norm_",
    "outside",
    "tanh",
    "tanh_kernel",
    "tolerance",
    "within",
]

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

# Each takes x and the value at x = 1. Formulas: dm_control's `rewards` module
# (Tassa et al., "dm_control: Software and tasks for continuous control", 2020, arXiv:2006.12983).


def _gaussian(x: Floats, value: float) -> Floats:
    scaled = x * math.sqrt(-2.0 * math.log(value))
    return np.exp(-0.5 * scaled * scaled)


def _linear(x: Floats, value: float) -> Floats:
    return np.maximum(1.0 - x * (1.0 - value), 0.0)


def _hyperbolic(x: Floats, value: float) -> Floats:
    # cosh overflows to infinity for large errors: the value is then 0, which is correct.
    with np.errstate(over="ignore"):
        return 1.0 / np.cosh(x * math.acosh(1.0 / value))


def _long_tail(x: Floats, value: float) -> Floats:
    scaled = x * math.sqrt(1.0 / value - 1.0)
    return 1.0 / (scaled * scaled + 1.0)


def _cosine(x: Floats, value: float) -> Floats:
    # x is clipped before the cosine, instead of replacing the result, so that NaN stays NaN.
    scaled = np.minimum(x * (math.acos(2.0 * value - 1.0) / math.pi), 1.0)
    return 0.5 * (1.0 + np.cos(math.pi * scaled))


def _tanh_squared(x: Floats, value: float) -> Floats:
    scaled = np.tanh(x * math.atanh(math.sqrt(1.0 - value)))
    return 1.0 - scaled * scaled


def _quadratic(x: Floats, value: float) -> Floats:
    scaled = x * math.sqrt(1.0 - value)
    return np.maximum(1.0 - scaled * scaled, 0.0)


def _reciprocal(x: Floats, value: float) -> Floats:
    return 1.0 / (x * (1.0 / value - 1.0) + 1.0)


SIGMOIDS: dict[str, Callable[[Floats, float], Floats]] = {
    "gaussian": _gaussian,
    "linear": _linear,
    "hyperbolic": _hyperbolic,
    "long_tail": _long_tail,
    "cosine": _cosine,
    "tanh_squared": _tanh_squared,
    "quadratic": _quadratic,
    "reciprocal": _reciprocal,
}
"""Name -> f(x >= 0, value at 1); each is 1 at 0 and decreases."""
_MAY_END = ("linear", "cosine", "quadratic")
"""Sigmoids that reach 0 at a finite x, which may be at the margin."""


class Tolerance:
    """1 within bounds; beyond them a sigmoid of the excess divided by the margin.

    dm_control's `rewards.tolerance`.

    Args:
        bounds: [low, high], in the unit of the quantity; either may be infinite.
        margin: Distance from the bounds at which the value is ``value_at_margin``; 0 gives 0
            everywhere outside.
        sigmoid: The function outside the bounds.
        value_at_margin: In (0, 1); 0 is allowed for linear, cosine and quadratic.

    Raises:
        ConfigError: If ``value_at_margin`` does not suit the sigmoid.
    """

    def __init__(
        self, bounds: Sequence[float], margin: float, sigmoid: Sigmoid, value_at_margin: float
    ) -> None:
        is_allowed = 0.0 < value_at_margin < 1.0
        allowed = "(0, 1)"
        if sigmoid in _MAY_END:
            is_allowed = 0.0 <= value_at_margin < 1.0
            allowed = "[0, 1)"
        if not is_allowed:
            message = f"must be in {allowed} for sigmoid {sigmoid!r}, got {value_at_margin}"
            raise ConfigError([Problem("value_at_margin", message)])
        self._low, self._high = (float(bound) for bound in bounds)
        self._margin = float(margin)
        self._sigmoid = SIGMOIDS[sigmoid]
        self._value_at_margin = float(value_at_margin)

    def __call__(self, x: Floats) -> Floats:
        """Values in [0, 1] of the shape of ``x``; NaN stays NaN."""
        # A bound at infinity is never exceeded: the difference is -inf, and the maximum 0.
        excess = np.maximum(np.maximum(self._low - x, x - self._high), 0.0)
        if self._margin > 0.0:
            return self._sigmoid(contiguous(excess / self._margin), self._value_at_margin)
        step: Floats = np.where(excess > 0.0, 0.0, 1.0)
        return np.where(np.isnan(excess), excess, step)


def gaussian_kernel(squared: Floats, std: float) -> Floats:
    """exp(-e^2 / std^2) of squared errors, the kernel of Isaac Lab's tracking rewards."""
    return np.exp(contiguous(squared) * (-1.0 / (std * std)))


def tanh_kernel(error: Floats, std: float) -> Floats:
    """1 - tanh(e / std) of errors >= 0, the kernel of Isaac Lab's reaching rewards."""
    return 1.0 - np.tanh(contiguous(error) / std)


AtMargin = Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)]
Values = Callable[["Floats"], "Floats"]
Truths = Callable[["Floats"], "Mask"]


def _columns(values: Floats) -> Floats:
    """(N, K) of (N,) or (N, K)."""
    return values[:, None] if values.ndim == 1 else values


def _any_column(mask: Mask) -> Mask:
    """Whether a row has a True, (N,) or (N, K) -> (N,)."""
    if mask.ndim == 1:
        return mask
    return cast("Mask", mask.any(axis=1))


def _every_column(mask: Mask) -> Mask:
    """Whether all columns of a row are True, (N,) or (N, K) -> (N,)."""
    if mask.ndim == 1:
        return mask
    return cast("Mask", mask.all(axis=1))


def _length(values: Floats) -> Floats:
    """(N,) absolute value, or Euclidean length of the rows."""
    return np.abs(values) if values.ndim == 1 else norm(values)


@register_shape
def l1(env: TermContext) -> Values:
    """Sum of absolute values.

    Example:
        ``{func: joint_velocity, shape: l1, weight: -0.01, params: {of: {uid: ur10}}}``
    """
    return lambda values: total(np.abs(_columns(values)))


@register_shape
def l2(env: TermContext) -> Values:
    """Sum of squares.

    Example:
        ``{func: joint_velocity, shape: l2, weight: -0.001, params: {of: {uid: ur10}}}``
    """
    return lambda values: squares(_columns(values))


@register_shape
def norm_(env: TermContext) -> Values:
    """Euclidean length, the root of `l2`.

    Example:
        ``{func: linear_velocity, shape: norm, weight: -0.1, params: {of: {uid: cube}}}``
    """
    return _length


@register_shape
def column(env: TermContext, which: Annotated[int, Field(ge=0)] | str) -> Values:
    """One column of several, with its sign.

    Args:
        which: Its number, from 0; or the joint's, the link's or the command's name of the column.

    Raises:
        ConfigError: If there is no such column.

    Example:
        ``{func: joint_velocity, shape: {column: Joint1}, weight: 0.1, params: {of:
        {uid: ur10}}}``
    """
    index = int(which)

    def pick_column(values: Floats) -> Floats:
        columns = _columns(values)
        if index >= columns.shape[1]:
            message = f"there are {columns.shape[1]} columns, numbered from 0; got {index}"
            raise ConfigError([Problem("column", message)])
        return contiguous(columns[:, index])

    return pick_column


@register_shape
def tanh(env: TermContext, std: Positive) -> Values:
    """One minus the hyperbolic tangent of e / std, e the absolute value or the row's length.

    The kernel of Isaac Lab's reaching rewards.

    Args:
        std: The error at which the value is 0.24, in the quantity's unit.

    Example:
        ``{func: distance, shape: {tanh: 0.1}, weight: 1.0, params: {from: {uid: ur10, link_names:
        [ee_link]}, to: {uid: cube}}}``
    """
    return lambda values: tanh_kernel(_length(values), std)


@register_shape
def gaussian(env: TermContext, std: Positive) -> Values:
    """exp(-e^2 / std^2) in [0, 1], e^2 the sum of squares of the row.

    The kernel of Isaac Lab's tracking rewards.

    Args:
        std: The error at which the value is 1/e, in the quantity's unit.

    Example:
        ``{func: linear_velocity_error, shape: {gaussian: 0.5}, weight: 1.0, params: {of: {uid:
        go}, command_name: velocity}}``
    """
    return lambda values: gaussian_kernel(squares(_columns(values)), std)


@register_shape
def tolerance(
    env: TermContext,
    bounds: Bounds = (0.0, 0.0),
    margin: NonNegative = 0.0,
    sigmoid: Sigmoid = "gaussian",
    value_at_margin: AtMargin = 0.1,
) -> Values:
    """1 within bounds, a sigmoid of the excess beyond them, in [0, 1]; the mean over columns.

    dm_control's ``rewards.tolerance``.

    Args:
        bounds: [low, high] where the value is 1, in the quantity's unit; either may be infinite.
        margin: Distance from the bounds at which the value is `value_at_margin`; 0 is a step.
        sigmoid: The function outside the bounds: gaussian, linear, hyperbolic, long_tail, cosine,
            tanh_squared, quadratic or reciprocal.
        value_at_margin: In (0, 1); linear, cosine and quadratic may take 0.

    Example:
        ``{func: height, shape: {tolerance: {bounds: [0.3, .inf], margin: 0.3, sigmoid: linear}},
        weight: 1.0, params: {of: {uid: cube}}}``
    """
    kernel = Tolerance(bounds, margin, sigmoid, value_at_margin)

    def apply_tolerance(values: Floats) -> Floats:
        value = kernel(values)
        return value if value.ndim == 1 else mean(value)

    return apply_tolerance


@register_shape
def above(env: TermContext, threshold: float, inclusive: bool = False) -> Truths:
    """True where a column is greater than a threshold.

    Args:
        threshold: In the quantity's unit.
        inclusive: Whether equality counts.

    Example:
        ``{func: height, shape: {above: 0.1}, weight: 15.0, params: {of: {uid: cube}}}``
    """
    compare = np.greater_equal if inclusive else np.greater
    limit = np.asarray(threshold)

    def is_above(values: Floats) -> Mask:
        mask = compare(values, limit)
        return mask if mask.ndim == 1 else _any_column(mask)

    return is_above


@register_shape
def below(env: TermContext, threshold: float, inclusive: bool = False) -> Truths:
    """True where every column is less than a threshold.

    Args:
        threshold: In the quantity's unit.
        inclusive: Whether equality counts.

    Example:
        ``{func: distance, shape: {below: 0.05}, params: {from: {uid: cube}, to: {uid: goal}}}``
    """
    compare = np.less_equal if inclusive else np.less
    limit = np.asarray(threshold)

    def is_below(values: Floats) -> Mask:
        mask = compare(values, limit)
        return mask if mask.ndim == 1 else _every_column(mask)

    return is_below


@register_shape
def within(env: TermContext, bounds: BoundsOrBox) -> Truths:
    """True where every column is within bounds, the bounds included.

    Args:
        bounds: [low, high] in the quantity's unit, or [[low of each column], [high of each]].

    Example:
        ``{func: joint_position, shape: {within: [-0.2, 0.2]}, params: {of: {uid: ur10,
        joint_names: [Joint1]}}}``
    """
    low, high = (np.asarray(bound, np.float64) for bound in bounds)

    def is_within(values: Floats) -> Mask:
        columns = _columns(values)
        return _every_column((columns >= low) & (columns <= high))

    return is_within


@register_shape
def outside(env: TermContext, bounds: BoundsOrBox) -> Truths:
    """True where a column is outside of bounds.

    Args:
        bounds: [low, high] in the quantity's unit, or [[low of each column], [high of each]].

    Example:
        ``{func: height, shape: {outside: [-0.1, 1]}, params: {of: {uid: cube}}}``
    """
    low, high = (np.asarray(bound, np.float64) for bound in bounds)

    def is_outside(values: Floats) -> Mask:
        columns = _columns(values)
        return _any_column((columns < low) | (columns > high))

    return is_outside


@register_shape
def excess(env: TermContext, threshold: Finite = 0.0) -> Values:
    """max(x - threshold, 0), column by column.

    Args:
        threshold: In the quantity's unit.

    Example:
        ``{func: contact_force, shape: [{excess: 100.0}, l1], weight: -0.001, params: {sensor:
        contacts, norm: true}}``
    """
    return lambda values: np.maximum(values - threshold, 0.0)


@register_shape
def clip(env: TermContext, bounds: Bounds) -> Values:
    """The value clipped to bounds, column by column.

    Args:
        bounds: [low, high] in the quantity's unit; either may be infinite.

    Example:
        ``{func: height, shape: {clip: [0, 0.2]}, weight: 5.0, params: {of: {uid: cube}}}``
    """
    low, high = bounds
    return lambda values: np.minimum(np.maximum(values, low), high)


@register_shape
def at_most(env: TermContext, limit: float | None) -> Values:
    """The smaller of the value and a limit, column by column.

    Args:
        limit: In the quantity's unit; None means no limit.

    Example:
        ``{func: height, shape: {at_most: 0.2}, weight: 5.0, params: {of: {uid: cube}}}``
    """
    upper_bound = np.inf if limit is None else limit
    return lambda values: np.minimum(values, upper_bound)


@register_shape
def negative(env: TermContext) -> Values:
    """Minus the value.

    Example:
        ``{func: distance, shape: negative, weight: 1.0, params: {from: {uid: cube}, to: {uid:
        goal}}}``
    """
    return np.negative


@register_shape
class Rate(Term):
    """Change since the last control step, column by column; 0 in the first step of an episode.

    Args:
        per: ``second`` divides by the control step's duration; ``step`` does not.
        order: 2 is the change of the change: x - 2 x' + x'', 0 in the first two steps.
        before: What there was before an episode: ``nothing``, so that there is no change yet, or
            ``zeros``, so that the first step changes from 0, as Isaac Lab and mjlab count actions.

    Example:
        ``{func: action, shape: [{rate: step}, l2], weight: -0.01}``
    """

    def __init__(
        self,
        env: TermContext,
        per: Literal["second", "step"] = "second",
        order: Literal[1, 2] = 1,
        before: Literal["nothing", "zeros"] = "nothing",
    ) -> None:
        self._from_zeros = before == "zeros"
        self._unit = env.step_dt**order if per == "second" else 1.0
        self._order = order
        # (N,) steps of the episode that have no rate yet, as there is too little to compare with.
        self._missing_steps: NDArray[np.int64] = env.arrays.full(env.num_envs, order, np.int64)
        # Whether it is 0 everywhere: true in most steps, which need not look at it.
        self._are_all_known = False
        # The last values, the newest first.
        self._past: list[Floats] = []

    def __call__(self, values: Floats) -> Floats:
        """Changes of the shape of ``values``."""
        now = values.astype(np.float64)
        past = self._past or [now] * self._order
        if self._from_zeros and not self._are_all_known:
            is_first_step = self._missing_steps == self._order
            if now.ndim > 1:
                is_first_step = is_first_step[:, None]
            past = [np.where(is_first_step, 0.0, value) for value in past]
        self._past = [now, *past[: self._order - 1]]
        change = now - past[0]
        if self._order == 2:
            change = now - 2.0 * past[0] + past[1]
        change /= self._unit
        if not self._are_all_known:
            if not self._from_zeros:
                change[self._missing_steps > 0] = 0.0
            self._missing_steps = np.maximum(self._missing_steps - 1, 0)
            self._are_all_known = not may_be_set(self._missing_steps)
        return change

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Clear the stored steps of these environments."""
        self._missing_steps[slice(None) if env_ids is None else env_ids] = self._order
        self._are_all_known = False

    def state_dict(self) -> dict[str, Any]:
        """The number of missing steps, and the values of the last ones (copies)."""
        return {
            "left": self._missing_steps.copy(),
            "past": [values.copy() for values in self._past],
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._missing_steps = state["left"].copy()
        self._are_all_known = not may_be_set(self._missing_steps)
        self._past = [values.copy() for values in state["past"]]

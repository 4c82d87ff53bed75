"""Axes of figures: where they begin and end, their ticks, and how numbers are written there."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "LARGEST",
    "Axis",
    "count_axis",
    "step_axis",
    "tick_labels",
    "tick_step",
    "ticks_between",
    "value_axis",
]

F64 = NDArray[np.float64]

LARGEST = 1e300
"""Values beyond are drawn as this: the length of an axis has to be a finite number."""
_SMALLEST = 1e-300
"""Values that are all smaller are drawn as 0."""
_CONSTANT = 0.01
"""Range below which values are a constant, as a share of the largest."""
_NEAR_ZERO = 0.35
"""An axis begins at 0 if the smallest value is below this share of the largest."""
_SMALLEST_RANGE = 0.05
"""Smallest range of an axis, as a share of its largest value, so that small changes look flat."""
_NICE = (1.0, 2.0, 2.5, 5.0, 10.0)
_UNITS = ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k"))
_LONGEST_PLAIN = 1e4
"""From here on numbers have a unit: 20k."""
_LARGEST_UNIT = 1e15
_SMALLEST_PLAIN = 1e-4


@dataclass(frozen=True, slots=True)
class Axis:
    """A linear axis.

    Attributes:
        low: Its first value.
        high: Its last value, larger.
        ticks: Values with a tick, ascending.
        is_share: Whether values are shares, which are written in percent.
    """

    low: float
    high: float
    ticks: tuple[float, ...]
    is_share: bool = False

    def place(self, values: ArrayLike) -> F64:
        """Return where values are: 0 at the beginning of the axis, 1 at its end."""
        numbers = np.clip(np.asarray(values, np.float64), -LARGEST, LARGEST)
        return (numbers - self.low) / (self.high - self.low)

    @property
    def labels(self) -> list[str]:
        """A text for each tick."""
        return tick_labels(self.ticks, is_share=self.is_share)


def value_axis(values: ArrayLike, *, is_share: bool = False, most_ticks: int = 5) -> Axis:
    """Return an axis for values, which begins and ends at a tick.

    A constant has an axis that begins at 0: one that is cut out around it would show changes that
    are none.

    Args:
        values: What is drawn; numbers that are not finite are left out.
        is_share: Whether they are shares, such as success rates: from 0 to 1.
        most_ticks: Ticks, at most.
    """
    if is_share:
        return Axis(0.0, 1.0, (0.0, 0.25, 0.5, 0.75, 1.0), is_share=True)
    numbers = np.asarray(values, np.float64)
    numbers = np.clip(numbers[np.isfinite(numbers)], -LARGEST, LARGEST)
    if not numbers.size:
        return _axis(0.0, 1.0, most_ticks)
    low = float(numbers.min())
    high = float(numbers.max())
    is_constant = high - low < _CONSTANT * max(abs(low), abs(high))
    if is_constant or 0 < low < _NEAR_ZERO * high:
        low = min(low, 0.0)
        high = max(high, 0.0)
    elif _NEAR_ZERO * low < high < 0:
        high = 0.0
    if low == high:
        high = 1.0
    largest = max(abs(low), abs(high))
    if largest < _SMALLEST:
        return _axis(0.0, 1.0, most_ticks)
    missing = _SMALLEST_RANGE * largest - (high - low)
    if missing > 0:
        low -= missing / 2
        high += missing / 2
    return _axis(low, high, most_ticks)


def step_axis(last: float, *, most_ticks: int = 5) -> Axis:
    """Return an axis from 0 to a number of steps, with ticks at whole numbers."""
    end = max(last, 1.0)
    return Axis(0.0, end, ticks_between(0.0, end, most_ticks, smallest_step=1.0))


def count_axis(largest: int, *, most_ticks: int = 4) -> Axis:
    """Return an axis from 0 to at least a number of things, with ticks at whole numbers."""
    step = max(math.ceil(tick_step(max(largest, 1), most_ticks)), 1)
    ticks = tuple(float(tick) for tick in range(0, largest + step, step))
    return Axis(0.0, max(ticks[-1], 1.0), ticks)


def _axis(low: float, high: float, most_ticks: int) -> Axis:
    """An axis from the last tick before `low` to the first one after `high`."""
    step = tick_step(high - low, most_ticks)
    first = math.floor(low / step + 1e-9)
    last = math.ceil(high / step - 1e-9)
    ticks = tuple(float(number * step) for number in range(first, last + 1))
    return Axis(ticks[0], ticks[-1], ticks)


def ticks_between(
    low: float, high: float, most_ticks: int = 5, *, smallest_step: float = 0.0
) -> tuple[float, ...]:
    """Return the ticks from one value to a larger one, both included if they are nice."""
    step = max(tick_step(high - low, most_ticks), smallest_step)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return tuple(float(number * step) for number in range(first, last + 1))


def tick_step(length: float, most_ticks: int) -> float:
    """Return the smallest nice distance of ticks with which a length has at most so many."""
    smallest = length / max(most_ticks - 1, 1)
    magnitude = 10.0 ** math.floor(math.log10(smallest))
    for nice in _NICE:
        if nice * magnitude >= smallest * (1 - 1e-9):
            return nice * magnitude
    return 10.0 * magnitude


def tick_labels(ticks: Sequence[float], *, is_share: bool = False) -> list[str]:
    """Return texts of equally spaced numbers, all with the same unit and number of decimals.

    Args:
        ticks: The numbers, ascending.
        is_share: Whether to write them in percent.
    """
    if is_share:
        return [f"{tick:.0%}" for tick in ticks]
    largest = max(map(abs, ticks), default=0.0)
    step = ticks[1] - ticks[0] if len(ticks) > 1 else largest
    if largest >= _LARGEST_UNIT or 0 < largest < _SMALLEST_PLAIN:
        return [_scientific(tick) for tick in ticks]
    divisor = 1.0
    unit = ""
    if largest >= _LONGEST_PLAIN:
        divisor, unit = next((d, u) for d, u in _UNITS if largest >= d)
    decimals = _decimals(step / divisor)
    labels = []
    for tick in ticks:
        text = f"{tick / divisor:.{decimals}f}"
        labels.append(text + unit if tick else "0")
    return _with_minus(labels)


def _decimals(step: float) -> int:
    """The digits after the point that a distance of ticks needs."""
    for decimals in range(12):
        if math.isclose(round(step, decimals), step, rel_tol=1e-6):
            return decimals
    return 12


def _scientific(value: float) -> str:
    """``2e-5``."""
    if not value:
        return "0"
    digits, exponent = f"{value:.3g}".partition("e")[::2]
    if not exponent:
        return _with_minus([digits])[0]
    return _with_minus([f"{digits}e{int(exponent)}"])[0]


def _with_minus(labels: Iterable[str]) -> list[str]:
    """Labels with the sign for minus, which is as wide as a digit, instead of the hyphen."""
    return [f"\N{MINUS SIGN}{label[1:]}" if label.startswith("-") else label for label in labels]

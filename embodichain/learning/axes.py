"""Axes of learning curves: from step 0, shares from 0 to 1, what is constant as a flat line."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

__all__ = ["set_axes"]

_MARGIN = 0.05
_LEAST = 0.05
"""Least height of an axis, as a share of the largest value on it: smaller changes look flat."""


def set_axes(axes: Any, last_step: float, values: Iterable[float], *, share: bool) -> None:
    """Set the limits and the numbers of an axes with a curve.

    Args:
        axes: Of matplotlib.
        last_step: The last environment step of any curve in it.
        values: All that is drawn.
        share: Whether they are shares, such as success rates.
    """
    from matplotlib.ticker import EngFormatter

    drawn = list(values)
    low, high = (0.0, 1.0) if share else (min(drawn), max(drawn))
    least = _LEAST * max(abs(low), abs(high)) or 1.0
    middle, half = (low + high) / 2, max(high - low, least) / 2
    axes.set_ylim(middle - half * (1 + 2 * _MARGIN), middle + half * (1 + 2 * _MARGIN))
    axes.set_xlim(0.0, max(last_step, 1.0) * (1 + _MARGIN))
    axes.set_xlabel("environment steps")
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))  # 200k, 1M: long numbers overlap
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.grid(alpha=0.3)

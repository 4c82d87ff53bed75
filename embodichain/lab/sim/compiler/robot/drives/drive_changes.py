"""`DriveChange`: values that events may draw for drives and links, and the extremes of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from embodichain.lab.sim.compiler.index import F64, Mask

__all__ = ["DriveChange", "DriveOperation", "drawn_joints", "extreme_values"]

Parts = Mapping[str, Sequence[int]]  # control part -> joint indices
DriveOperation = Literal["abs", "scale", "add"]


@dataclass(frozen=True)
class DriveChange:
    """Values that an event may draw for the drives or links of one articulation.

    Attributes:
        quantity: The drawn quantity; ``strength`` multiplies gains and limit, ``com`` moves the
            centre of mass.
        names: Regexes or control parts that pick joints (links for ``mass`` and ``com``); None
            picks all.
        ranges: (low, high) for all picked ones, or by regex; without a meaning for ``com``.
        operation: ``abs`` replaces the compiled value, ``scale`` and ``add`` change it.
    """

    quantity: Literal["stiffness", "damping", "max_effort", "strength", "armature", "mass", "com"]
    names: tuple[str, ...] | None
    ranges: tuple[float, float] | Mapping[str, tuple[float, float]]
    operation: DriveOperation = "abs"

    def bounds(
        self, quantity: str, names: Sequence[str], parts: Parts
    ) -> dict[int, tuple[float, float]]:
        """Picked index in `names` -> (low, high); empty for another quantity."""
        if quantity != self.quantity:
            return {}
        picked = self._pick(names, parts)
        if not isinstance(self.ranges, Mapping):
            return dict.fromkeys(picked, self.ranges)
        bounds_of: dict[int, tuple[float, float]] = {}
        for pattern, bounds in self.ranges.items():
            for i in picked:
                if re.fullmatch(pattern, names[i]):
                    bounds_of[i] = bounds
        return bounds_of

    def _pick(self, names: Sequence[str], parts: Parts) -> list[int]:
        """Return the indices of the names that `self.names` picks."""
        if self.names is None:
            return list(range(len(names)))
        picked: list[int] = []
        for pattern in self.names:
            if pattern in parts:
                picked += parts[pattern]
            else:
                picked += [i for i, name in enumerate(names) if re.fullmatch(pattern, name)]
        return picked

    def apply(self, default: float, value: float) -> float:
        """Return the result of drawing `value` for a compiled value."""
        if self.operation == "scale":
            return default * value
        if self.operation == "add":
            return default + value
        return value


def drawn_joints(
    quantity: str, names: Sequence[str], parts: Parts, changes: Sequence[DriveChange]
) -> Mask:
    """(D,) mask of joints for which events draw a quantity."""
    is_drawn = np.zeros(len(names), np.bool_)
    for change in changes:
        is_drawn[list(change.bounds(quantity, names, parts))] = True
    return is_drawn


def extreme_values(
    quantity: str,
    default: F64,
    changes: Sequence[DriveChange],
    *,
    names: Sequence[str],
    parts: Parts,
    choose: Callable[..., float],
) -> F64:
    """Return the largest or smallest of the values that events may draw and the default.

    Args:
        quantity: The quantity.
        default: (D,) compiled values.
        changes: What events draw.
        names: (D,) joints, or links.
        parts: Control part -> joint indices; empty for links.
        choose: `max` or `min`.
    """
    extremes = default.copy()
    for change in changes:
        for i, bounds in change.bounds(quantity, names, parts).items():
            values = [change.apply(float(default[i]), bound) for bound in bounds]
            extremes[i] = choose(float(extremes[i]), *values)
    return extremes

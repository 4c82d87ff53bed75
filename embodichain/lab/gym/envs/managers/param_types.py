"""Types of term parameters with their ranges, for annotations that `check.py` checks.

Pure declarations: no torch, no MuJoCo.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import AfterValidator, Field

__all__ = ["Box3", "NonNegative", "Positive", "Range", "Vec3"]

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Vec3 = Annotated[list[Finite], Field(min_length=3, max_length=3)]


def _ordered(value: Sequence[Sequence[float]]) -> Sequence[Sequence[float]]:
    for axis, (low, high) in enumerate(zip(value[0], value[1], strict=True)):
        if low > high:
            raise ValueError(f"low {low} exceeds high {high} in column {axis}")
    return value


def _ordered_pair(value: Sequence[float]) -> Sequence[float]:
    if value[0] > value[1]:
        raise ValueError(f"low {value[0]} exceeds high {value[1]}")
    return value


Range = Annotated[
    Sequence[Finite], Field(min_length=2, max_length=2), AfterValidator(_ordered_pair)
]
"""[low, high]."""
Box3 = Annotated[list[Vec3], Field(min_length=2, max_length=2), AfterValidator(_ordered)]
"""[[x, y, z] low, [x, y, z] high]."""

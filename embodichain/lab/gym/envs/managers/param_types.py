"""Types of term parameters with their ranges, for annotations that `check.py` checks.

Pure declarations: no torch, no MuJoCo.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag

__all__ = [
    "FORMS",
    "Angle",
    "Axes6",
    "Bounds",
    "BoundsOrBox",
    "Box",
    "Box1",
    "Box2",
    "Box3",
    "Fraction",
    "NamedEntity",
    "NonNegative",
    "Positive",
    "Range",
    "RangeOrBox",
    "Ranges",
    "ScaleRange",
    "UnitInterval",
    "Vec3",
]

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)]
"""(0, 1]."""
UnitInterval = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
"""[0, 1]."""
Angle = Annotated[float, Field(gt=0, le=math.pi, allow_inf_nan=False)]
"""Radians in (0, pi]."""
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Vec2 = Annotated[list[Finite], Field(min_length=2, max_length=2)]
Vec3 = Annotated[list[Finite], Field(min_length=3, max_length=3)]


def _ordered(value: Sequence[Sequence[float]]) -> Sequence[Sequence[float]]:
    if len(value[0]) != len(value[1]):
        raise ValueError(f"low has {len(value[0])} values, high {len(value[1])}")
    for axis, (low, high) in enumerate(zip(value[0], value[1], strict=True)):
        if low > high:
            raise ValueError(f"low {low} exceeds high {high} in column {axis}")
    return value


def _ordered_pair(value: Sequence[float]) -> Sequence[float]:
    if value[0] > value[1]:
        raise ValueError(f"low {value[0]} exceeds high {value[1]}")
    return value


def _bounds(value: Sequence[float]) -> Sequence[float]:
    if math.isnan(value[0]) or math.isnan(value[1]):
        raise ValueError("a bound is not a number")
    return _ordered_pair(value)


Range = Annotated[
    Sequence[Finite], Field(min_length=2, max_length=2), AfterValidator(_ordered_pair)
]
"""[low, high]."""
Bounds = Annotated[Sequence[float], Field(min_length=2, max_length=2), AfterValidator(_bounds)]
"""[low, high]; either may be infinite (``.inf`` in YAML)."""
Box = Annotated[
    list[Annotated[list[Finite], Field(min_length=1)]],
    Field(min_length=2, max_length=2),
    AfterValidator(_ordered),
]
"""[[low of each column], [high of each]]."""
Box1 = Annotated[
    list[Annotated[list[Finite], Field(min_length=1, max_length=1)]],
    Field(min_length=2, max_length=2),
    AfterValidator(_ordered),
]
"""[[low], [high]]."""
Box2 = Annotated[list[Vec2], Field(min_length=2, max_length=2), AfterValidator(_ordered)]
"""[[x, y] low, [x, y] high]."""
Box3 = Annotated[list[Vec3], Field(min_length=2, max_length=2), AfterValidator(_ordered)]
"""[[x, y, z] low, [x, y, z] high]."""
FORMS = ("for all", "for all axes", "by name", "by axis")
"""Tags of the forms that a range takes: they tell pydantic which form is meant, users nothing."""


def _named_form(value: Any) -> str:
    return "by name" if isinstance(value, Mapping) else "for all"


def _axis_form(value: Any) -> str:
    nested = isinstance(value, Sequence) and any(isinstance(v, Sequence) for v in value)
    return "by axis" if nested else "for all"


def _scale_form(value: Any) -> str:
    if _axis_form(value) == "for all":
        return "for all"
    alone = all(isinstance(v, Sequence) and len(v) == 1 for v in value)
    return "for all axes" if alone else "by axis"


Ranges = Annotated[
    Annotated[Range, Tag("for all")] | Annotated[dict[str, Range], Tag("by name")],
    Discriminator(_named_form),
]
"""[low, high] for all, or {name regex: [low, high]}."""
RangeOrBox = Annotated[
    Annotated[Range, Tag("for all")] | Annotated[Box3, Tag("by axis")],
    Discriminator(_axis_form),
]
"""[low, high], or [[x, y, z] low, [x, y, z] high]."""
BoundsOrBox = Annotated[
    Annotated[Bounds, Tag("for all")] | Annotated[Box, Tag("by axis")],
    Discriminator(_axis_form),
]
"""[low, high], either infinite, or [[low of each column], [high of each]]."""
ScaleRange = Annotated[
    Annotated[Range, Tag("for all")]
    | Annotated[Box1, Tag("for all axes")]
    | Annotated[Box3, Tag("by axis")],
    Discriminator(_scale_form),
]
"""[low, high], [[low], [high]], or [[x, y, z] low, [x, y, z] high]."""
Axes6 = dict[Literal["x", "y", "z", "roll", "pitch", "yaw"], Range]
"""{axis: [low, high]}: m and rad, or m/s and rad/s; an axis that is absent is 0."""


@dataclass
class NamedEntity:
    """Points at something of the scene that has no joints or links, such as a light."""

    __pydantic_config__ = {"extra": "forbid"}

    uid: str

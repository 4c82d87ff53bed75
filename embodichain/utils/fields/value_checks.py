"""`must`: conditions of values that a type alone does not say, for the annotations of fields.

They are part of the types of a config, so that they hold for YAML and for configs made in Python.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

from pydantic import AfterValidator

__all__ = ["are_finite", "must"]


def must(be: str, condition: Callable[[Any], bool]) -> AfterValidator:
    """Return metadata of an annotation: a value for which `condition` is false is a mistake.

    Args:
        be: What the value must be, for the message: ``be positive, metres``.
        condition: Receives a value of the annotated type.
    """

    def check(value: Any) -> Any:
        if not condition(value):
            raise ValueError(f"must {be}")
        return value

    return AfterValidator(check)


def are_finite(values: Iterable[float]) -> bool:
    """Whether no value is infinite or NaN."""
    return all(map(math.isfinite, values))

"""`require`: conditions on values that a type alone does not say, for the annotations of fields.

They are part of the types of a config, so that they hold for YAML and for configs made in Python.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from pydantic import AfterValidator
from pydantic_core import PydanticCustomError

__all__ = ["UNMET", "are_finite", "is_not_zero", "is_positive", "refuse", "require"]

UNMET = "requirement"
"""Type of pydantic's error for a value that does not meet a requirement."""


def require(message: str, condition: Callable[[Any], bool]) -> AfterValidator:
    """Return metadata of an annotation: a value for which a condition is false is a mistake.

    Args:
        message: The message; ``{}`` stands for the value: ``must be positive, metres, got {}``.
        condition: Receives a value of the annotated type.
    """
    return refuse(lambda value: None if condition(value) else message)


def refuse(find_mistake: Callable[[Any], str | None]) -> AfterValidator:
    """Return metadata of an annotation whose values are checked by a function.

    Args:
        find_mistake: Receives a value of the annotated type; returns the message, as of `require`,
            or None.
    """

    def check(value: Any) -> Any:
        message = find_mistake(value)
        if message is None:
            return value
        shown = [*value] if isinstance(value, list | tuple) else value
        text = message.replace("{}", str(shown))
        raise PydanticCustomError(UNMET, "{text}", {"text": text})

    return AfterValidator(check)


def are_finite(values: Iterable[float]) -> bool:
    """Whether no value is infinite or NaN."""
    return all(map(math.isfinite, values))


def is_positive(value: float) -> bool:
    """Whether a number is positive and finite."""
    return 0 < value < math.inf


def is_not_zero(vector: Sequence[float]) -> bool:
    """Whether a vector has a length: 1e-9 or more."""
    return math.hypot(*vector) > 1e-9

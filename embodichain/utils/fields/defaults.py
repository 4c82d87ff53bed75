"""Defaults that can be told from equal values that were given.

A friction of 0.5 that a user writes is not the same as no friction, although 0.5 is the default.
`is_given` tells them apart. The values are plain numbers to everyone else, and stay what they are
in copies of a config.
"""

from __future__ import annotations

from typing import Any

from pydantic import ValidatorFunctionWrapHandler, WrapValidator

__all__ = ["KEEP_DEFAULT", "DefaultFloat", "DefaultInt", "DefaultStr", "is_given"]


class _Default:
    """Marks a value that nobody gave."""


class DefaultFloat(_Default, float):
    """A number that was not given."""


class DefaultInt(_Default, int):
    """An integer that was not given."""


class DefaultStr(_Default, str):
    """A text that was not given."""


def is_given(value: Any) -> bool:
    """Whether a value of a config was given; False for one of the default types above."""
    return not isinstance(value, _Default)


def _kept(value: Any, validate: ValidatorFunctionWrapHandler) -> Any:
    return validate(value) if is_given(value) else value


KEEP_DEFAULT = WrapValidator(_kept)
"""For annotations of fields with such a default: it stays one when a config is read from a dict."""

"""Plain messages for pydantic's errors; configs from nested plain values (`from_dict`).

Callers supply key paths and allowed keys. `from_dict` is for Python; `embodichain.config` checks
YAML, with files and lines.
"""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import TypeAdapter, ValidationError

from embodichain.utils.env_text import hidden
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.fields.value_checks import UNMET
from embodichain.utils.suggest import did_you_mean

__all__ = [
    "ErrorDetails",
    "expected_kind",
    "from_dict",
    "member_from_dict",
    "said_twice",
    "show_value",
    "unknown_key",
    "what_is_wrong",
]

ErrorDetails = Mapping[str, Any]
"""One entry of `ValidationError.errors()`."""

_KINDS = {
    "int": "an integer",
    "float": "a number",
    "string": "text",
    "bool": "true or false",
    "dict": "a map",
    "dataclass": "a map",
    "list": "a list",
    "tuple": "a list",
}
_LIMITS = {
    "greater_than": ("gt", "greater than"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "less than"),
    "less_than_equal": ("le", "at most"),
}
_TEXT_ERRORS = {"string_type", "string_pattern_mismatch"}
_FLAG_ERRORS = {"bool_type", "bool_parsing"}
_NUMBER_ERRORS = {"int_type", "float_type", "int_parsing", "float_parsing", "int_from_float"}
_LONGEST = 60


def what_is_wrong(
    errors: Sequence[ErrorDetails], patterns: Mapping[str, str] | None = None
) -> tuple[str, str]:
    """Return the message and the hint for the errors of one value.

    Args:
        errors: At least one; each member of a union reports its own.
        patterns: Regular expression -> description of what it matches.

    Returns:
        ``must be at least 1, got 0``, ``expected a number or 'auto', got 'x'``; and
        ``Did you mean 'y'?`` or nothing.
    """
    error = errors[0]
    kind = error["type"]
    value = error["input"]
    if kind == UNMET:
        return str(error["msg"]), ""
    if kind == "missing":
        return "missing value: it must be set", ""
    if kind in _LIMITS:
        key, words = _LIMITS[kind]
        return f"must be {words} {error['ctx'][key]}, got {show_value(value)}", ""
    if kind in ("value_error", "assertion_error"):
        message = str(error["msg"]).partition("error, ")[2] or str(error["msg"])
        return f"{message[:1].lower()}{message[1:]}, got {show_value(value)}", ""
    if kind in ("too_short", "too_long"):
        length = error["ctx"].get("min_length", error["ctx"].get("max_length"))
        bound = "at least" if kind == "too_short" else "at most"
        items = "item" if length == 1 else "items"
        return f"expected {bound} {length} {items}, got {show_value(value)}", ""
    expected = [_expected(e, patterns or {}) for e in errors if e["type"] != "callable_type"]
    message = f"expected {' or '.join(dict.fromkeys(expected))}, got {show_value(value)}"
    if isinstance(value, str):
        choices = list(itertools.chain.from_iterable(map(_choices, errors)))
        hint = did_you_mean(value, choices).strip()
        if hint:
            return f"{message}.", hint
    return message, ""


def expected_kind(errors: Sequence[ErrorDetails]) -> str:
    """Return what was expected of one value, if it is a scalar of another kind.

    Args:
        errors: As for `what_is_wrong`.

    Returns:
        ``text`` in place of a number or a flag, ``flag`` or ``number`` in place of text, else an
        empty string (see `Problem`).
    """
    kinds = {error["type"] for error in errors}
    value = errors[0]["input"]
    takes_text = kinds & _TEXT_ERRORS or any(_choices(error) for error in errors)
    if takes_text and isinstance(value, bool | int | float):
        return "text"
    if not isinstance(value, str):
        return ""
    if kinds & _NUMBER_ERRORS:
        return "number"
    if kinds & _FLAG_ERRORS:
        return "flag"
    return ""


def unknown_key(name: str, allowed: Sequence[str]) -> tuple[str, str]:
    """Return the message and the hint for a key that is not allowed."""
    return f"unknown key; allowed: {', '.join(allowed)}.", did_you_mean(name, allowed).strip()


def said_twice(name: str) -> str:
    """Return the message for a key that is another name of a key that is given too."""
    return f"means the same as {name}: leave one out"


def show_value(value: Any) -> str:
    """Return a value as written in YAML, shortened to one line."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    text = hidden(repr(value))  # before it is cut: a part of a value would not be found
    if len(text) <= _LONGEST:
        return text
    return text[: _LONGEST - 3] + "..."


def _expected(error: ErrorDetails, patterns: Mapping[str, str]) -> str:
    if error["type"] == "literal_error":
        choices = [repr(choice) for choice in _choices(error)]
        if not choices:  # numbers
            return f"one of {error['ctx']['expected']}"
        if len(choices) == 1:
            return choices[0]
        return f"one of {', '.join(choices)}"
    if error["type"] == "string_pattern_mismatch":
        pattern = error["ctx"]["pattern"]
        return patterns.get(pattern, f"text like {pattern}")
    kind: str = error["type"].rsplit("_", 1)[0]
    return _KINDS.get(kind, str(error["msg"]).removeprefix("Input should be "))


def _choices(error: ErrorDetails) -> list[str]:
    return re.findall(r"'([^']*)'", error.get("ctx", {}).get("expected", ""))


def member_from_dict(members: Mapping[str, type[Any]], tag: str, init_dict: dict[str, Any]) -> Any:
    """Return the config of the class that ``init_dict[tag]`` names, as `from_dict` does.

    Raises:
        ConfigError: If no member has that name, or as `from_dict`.
    """
    kind = str(init_dict.get(tag, ""))
    if kind not in members:
        message = f"unknown {tag} {kind!r}; one of: {', '.join(members)}."
        raise ConfigError([Problem(tag, message, did_you_mean(kind, members).strip())])
    return from_dict(members[kind], init_dict)


def from_dict(cls: type[Any], init_dict: dict[str, Any]) -> Any:
    """Return ``cls`` built from nested plain values.

    Args:
        cls: A configclass.
        init_dict: Keys are its fields; nested configs are dicts.

    Raises:
        ConfigError: Lists every unknown key, wrong type and value out of range.
    """
    try:
        return TypeAdapter(cls).validate_python(init_dict)
    except ValidationError as error:
        raise ConfigError([_problem(cls, details) for details in error.errors()]) from error


def _problem(cls: type[Any], details: ErrorDetails) -> Problem:
    """Return what is wrong in the values of a config, at the key path of one error."""
    keys = [str(part) for part in details["loc"]]
    path = ".".join(keys)
    if details["type"] != "unexpected_keyword_argument":
        message, hint = what_is_wrong([details])
        return Problem(path, message, hint)
    if len(keys) > 1:
        return Problem(path, "unknown key")
    other_name = getattr(cls, "other_names", {}).get(keys[0])
    if other_name is not None:
        return Problem(path, said_twice(other_name))
    names = [field.name for field in dataclasses.fields(cls)]
    message, hint = unknown_key(keys[0], names)
    return Problem(path, message, hint)

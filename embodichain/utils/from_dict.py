"""Building a config from a plain dict: every mistake at once, unknown keys included.

YAML is checked by `embodichain.config`, which knows files and lines; this is the Python API's door.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from pydantic import TypeAdapter, ValidationError

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

__all__ = ["from_dict"]


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
        names = [f.name for f in dataclasses.fields(cls)]
        raise ConfigError([_problem(e, names) for e in error.errors()]) from error


def _problem(error: Any, names: list[str]) -> Problem:
    path = [str(part) for part in error["loc"]]
    hint = ""
    if error["type"] == "unexpected_keyword_argument":
        message = "unknown key"
        if len(path) == 1:
            message += f"; allowed: {', '.join(names)}"
            hint = did_you_mean(path[0], names).strip()
    else:
        message = f"{error['msg']}, got {error['input']!r}"
    return Problem(".".join(path), message, hint)

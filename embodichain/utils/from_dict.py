"""Building a config from a plain dict: every mistake at once, unknown keys included.

YAML is checked by `embodichain.config`, which knows files and lines; this is the Python API's door.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from pydantic import TypeAdapter, ValidationError

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.type_errors import unknown_key, what_is_wrong

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
        problems = []
        for found in error.errors():
            path = [str(part) for part in found["loc"]]
            if found["type"] != "unexpected_keyword_argument":
                message, hint = what_is_wrong([found])
            elif len(path) == 1:
                message, hint = unknown_key(path[0], names)
            else:
                message, hint = "unknown key", ""
            problems.append(Problem(".".join(path), message, hint))
        raise ConfigError(problems) from error

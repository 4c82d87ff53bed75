"""Building a config from a plain dict: every mistake at once, unknown keys included.

YAML is checked by `embodichain.config`, which knows files and lines; this is the Python API's door.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from pydantic import TypeAdapter, ValidationError

from embodichain.utils.errors import ConfigError
from embodichain.utils.pydantic_problems import problems_of

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
        raise ConfigError(problems_of(error, allowed=lambda loc: () if loc else names)) from error

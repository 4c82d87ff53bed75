"""Reads a gym config from YAML or JSON."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import yaml

from embodichain.utils.errors import ConfigError

__all__ = ["is_gym_config", "read_gym_config"]


class _Loader(yaml.SafeLoader):
    """A YAML loader for which ``1e5`` and ``1.0e5`` are numbers, as in JSON."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(?:[0-9][0-9_]*)(?:\.[0-9_]*)?[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)


def read_gym_config(path: str | Path) -> dict[str, Any]:
    """Return the content of a gym config.

    Args:
        path: A file with the suffix ``.json``, ``.yaml`` or ``.yml``.

    Raises:
        ConfigError: There is no such file, or it is malformed (gives the line) or not a map.
    """
    file = Path(path)
    if not file.is_file():
        raise ConfigError(f"no such file: {path}")
    try:
        text = file.read_text(encoding="utf-8")
        data: Any = json.loads(text) if file.suffix == ".json" else yaml.load(text, _Loader)
    except json.JSONDecodeError as error:
        raise ConfigError(f"{path}:{error.lineno}: malformed JSON: {error.msg}") from error
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}{_line_of(error)}: malformed YAML: {_reason(error)}") from error
    except RecursionError as error:
        raise ConfigError(f"{path}: nested too deeply, or an alias contains itself") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} cannot be read: {error}") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{path} is not a gym config: a map is expected at its top")
    return data


def is_gym_config(data: object) -> bool:
    """Whether a file's content is a gym config, by a section that tasks here do not have.

    This is the map ``env``, or in a composition of release 0.3 ``environment`` or ``embodiment``.
    """
    if not isinstance(data, dict) or "task" in data:
        return False
    return isinstance(data.get("env"), dict) or "environment" in data or "embodiment" in data


def _line_of(error: yaml.YAMLError) -> str:
    """The line of a mistake, as ``:7``; empty if it is unknown."""
    mark = getattr(error, "problem_mark", None)
    if mark is None:
        return ""
    return f":{mark.line + 1}"


def _reason(error: yaml.YAMLError) -> str:
    return str(getattr(error, "problem", None) or error).splitlines()[0]

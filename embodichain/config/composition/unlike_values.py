"""Maps and lists at one key: maps are merged, lists replaced, and one does not replace the other.

OmegaConf refuses both, without the key. Here the key, its places and what is there are named.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, ListConfig

from embodichain.config.composition.locate import COMMAND_LINE, ConfigFile, display_path
from embodichain.utils.errors import Problem
from embodichain.utils.fields.type_errors import show_value

__all__ = ["unlike_in_files", "why_not_applied"]

_COLLECTIONS = ("map", "list")


def unlike_in_files(files: Iterable[ConfigFile]) -> list[Problem]:
    """Return a problem for each key that is a list in one file and a map in a later one.

    Args:
        files: In the order of merging.
    """
    kinds: dict[str, str] = {}
    places: dict[str, str] = {}
    problems: list[Problem] = []
    for file in files:
        name = display_path(file.path)
        for path, key in file.keys.items():
            before = kinds.get(path)
            place = f"{name}:{key.line}"
            if key.kind != before and {key.kind, before} == set(_COLLECTIONS):
                message = f"expected a {before}, as {places[path]} has it, got a {key.kind}"
                hint = "Maps are merged and lists replaced: neither takes the place of the other."
                problems.append(Problem(path, message, hint, source=place))
            if key.kind != "map":  # it replaces what was below it
                prefix = f"{path}."
                for below in [other for other in kinds if other.startswith(prefix)]:
                    del kinds[below]
            kinds[path] = key.kind
            places[path] = place
    return problems


def why_not_applied(config: DictConfig, override: Override, error: Exception) -> Problem:
    """Return the problem of an override whose value could not be set.

    Args:
        config: What it was to change.
        override: The override.
        error: What was raised.
    """
    key = override.key_or_group
    node: Any = config
    parents: list[str] = []
    for part in key.replace("[", ".").replace("]", "").split("."):
        parent = ".".join(parents)
        if isinstance(node, ListConfig):
            if not part.isdecimal():
                message = f"{parent} is a list: expected the number of an item, got {part!r}"
                return _of_command_line(key, message, _replaced(override, parent))
            if int(part) >= len(node):
                message = f"there is no item {part}: {parent} has {len(node)}, from 0"
                return _of_command_line(key, message)
            node = node[int(part)]
        elif isinstance(node, DictConfig) and part in node:
            node = node[part]
        else:
            node = None
            break
        parents.append(part)
    value = override.value()
    if isinstance(node, DictConfig) and isinstance(value, list):
        message = f"the list {show_value(value)} cannot be merged with the map that is there"
        return _of_command_line(key, message, _replaced(override, key))
    if isinstance(node, ListConfig) and isinstance(value, dict):
        message = f"the map {show_value(value)} cannot be merged with the list that is there"
        return _of_command_line(key, message, _replaced(override, key))
    message = f"cannot apply {override.input_line}: {str(error).splitlines()[0]}"
    return _of_command_line(key, message)


def _replaced(override: Override, key: str) -> str:
    """How to write an override that replaces what there is at a key."""
    return f"To replace it, take it out first: '~{key}' '{override.input_line}'."


def _of_command_line(path: str, message: str, hint: str = "") -> Problem:
    return Problem(path, message, hint).at(COMMAND_LINE)

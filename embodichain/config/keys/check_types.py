"""The check of the keys, types, lengths and ranges of a whole config.

`ConfigTypes` does it, for the data classes of the root; this is what is particular to the root.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from embodichain.config.keys.algorithms import ALGO_INSTEAD, DEFAULT_ALGORITHM, PATTERNS
from embodichain.config.keys.schema import ROOT_INSTEAD, RootCfg
from embodichain.lab.sim.configs.config_types import ConfigTypes, Loc, key_names
from embodichain.lab.sim.configs.sensor_cfg import SENSORS
from embodichain.utils.errors import Problem
from embodichain.utils.fields.type_errors import unknown_key

__all__ = ["TypeCheck", "check_types", "key_names", "schema_at"]


@dataclass(frozen=True)
class TypeCheck:
    """The result of the check of types.

    Attributes:
        root: The config without its wrong keys; None if no task is left to check.
        tree: The same as plain values; whole floats are integers where an integer is needed.
        problems: One for each wrong key.
        pruned: Paths that were left out of `root`.
    """

    root: RootCfg | None
    tree: dict[str, Any]
    problems: list[Problem]
    pruned: tuple[str, ...]


def check_types(tree: Mapping[str, Any]) -> TypeCheck:
    """Check a composed tree against `RootCfg`.

    Args:
        tree: Plain dicts and lists. A whole number written as a float passes for an integer.
    """
    data = copy.deepcopy(dict(tree))
    problems: dict[str, Problem] = {}
    for name, instead in ROOT_INSTEAD.items():
        if isinstance(data.get("task"), dict) and name in data["task"]:
            del data["task"][name]
            problems[f"task.{name}"] = Problem(f"task.{name}", f"not a key of a task; {instead}")
    if isinstance(data.get("algo"), dict):
        data["algo"].setdefault("name", DEFAULT_ALGORITHM)
    checked = _root_types().check_tree(data, indispensable=[(), ("task",)])
    problems |= checked.problems
    return TypeCheck(checked.value, checked.tree, list(problems.values()), checked.pruned)


def schema_at(parts: Sequence[str | int], data: Any) -> Mapping[str, Any]:
    """Return the JSON schema of a key path; empty if none is declared.

    Args:
        parts: The path; keys of maps and indices of lists included.
        data: The tree that is checked; its values choose between the members of unions.
    """
    return _root_types().schema_at(parts, data)


def _root_types() -> ConfigTypes:
    return _root_types_of(SENSORS.revision)


@cache
def _root_types_of(revision: int) -> ConfigTypes:
    """The types of the whole config, for a state of the register of sensors."""
    return ConfigTypes(RootCfg, patterns=PATTERNS, explain_key=_explain_key)


def _explain_key(loc: Loc, allowed: Sequence[str]) -> Problem | None:
    """The problem of an unknown key of the root, of the task or of an algorithm, or None."""
    path = ".".join(map(str, loc))
    name = str(loc[-1])
    if loc[:-1] == ("algo",) and name in ALGO_INSTEAD:
        return Problem(path, f"not a key of an algorithm; {ALGO_INSTEAD[name]}")
    if loc[:-1] == ("task",):
        message, hint = unknown_key(name, [key for key in allowed if key not in ROOT_INSTEAD])
        return Problem(path, message, hint)
    if len(loc) == 1 and name in key_names(schema_at(["task"], {})):
        message, _ = unknown_key(name, allowed)
        return Problem(path, message, f"Did you mean 'task.{name}'?")
    return None

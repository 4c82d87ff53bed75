"""The check of keys, types, lengths and ranges, by pydantic over the data classes.

Pydantic finds all mistakes at once; each becomes a `Problem` and is removed from the tree for the
other checks. `schema_at` returns the JSON schema of a key path, for lists of allowed keys.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from pydantic import TypeAdapter, ValidationError

from embodichain.config.keys.algorithms import ALGO_INSTEAD, DEFAULT_ALGORITHM, PATTERNS, AnyAlgoCfg
from embodichain.config.keys.schema import ROOT_INSTEAD, RootCfg
from embodichain.lab.sim.configs.references import REFERENCE_WORDS
from embodichain.lab.sim.configs.sensor_cfg import SENSORS, AnySensorCfg
from embodichain.lab.sim.shapes import AnyShapeCfg
from embodichain.utils.errors import Problem
from embodichain.utils.fields.type_errors import (
    ErrorDetails,
    expected_kind,
    said_twice,
    show_value,
    unknown_key,
    what_is_wrong,
)
from embodichain.utils.suggest import did_you_mean

__all__ = ["TypeCheck", "check_types", "key_names", "schema_at"]

Loc = tuple[str | int, ...]
_TAGS: dict[str, Any] = {
    "shape_type": AnyShapeCfg,
    "sensor_type": AnySensorCfg,
    "name": AnyAlgoCfg,
}
"""Key that chooses between the members of a union -> the union."""


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
    pruned: set[str] = set()
    for name, instead in ROOT_INSTEAD.items():
        if isinstance(data.get("task"), dict) and name in data["task"]:
            del data["task"][name]
            problems[f"task.{name}"] = Problem(f"task.{name}", f"not a key of a task; {instead}")
    if isinstance(data.get("algo"), dict):
        data["algo"].setdefault("name", DEFAULT_ALGORITHM)
    while True:  # ends, because each iteration repairs or removes something
        try:
            root = _adapter().validate_json(json.dumps(data, default=str), strict=True)
            return TypeCheck(root, data, list(problems.values()), tuple(sorted(pruned)))
        except ValidationError as error:
            groups = _grouped(error.errors(include_url=False), data)
        for loc, errors in groups.items():
            if _repair(data, loc, errors):
                continue
            path = ".".join(map(str, loc))
            problems.setdefault(path, _problem(path, loc, errors, data))
            removed = _prune(data, loc, errors)
            pruned.add(".".join(map(str, removed)))
            if removed in ((), ("task",)):
                return TypeCheck(None, data, list(problems.values()), tuple(sorted(pruned)))


def _adapter() -> TypeAdapter[RootCfg]:
    return _adapter_of(SENSORS.revision)


@cache
def _adapter_of(revision: int) -> TypeAdapter[RootCfg]:
    """The check of the whole config, for a state of the register of sensors."""
    return TypeAdapter(RootCfg)


def _grouped(errors: Iterable[ErrorDetails], data: Any) -> dict[Loc, list[ErrorDetails]]:
    """Errors by key path; of the errors of a union's members, the deepest are kept."""
    groups: dict[Loc, list[ErrorDetails]] = {}
    for error in errors:
        groups.setdefault(_clean(error, data), []).append(error)
    ancestors = {loc[:depth] for loc in groups for depth in range(len(loc))}
    return {loc: group for loc, group in groups.items() if loc not in ancestors}


def _clean(error: ErrorDetails, data: Any) -> Loc:
    """A location without the tags of unions that pydantic puts between the keys."""
    loc = error["loc"]
    kind = error["type"]
    clean: list[str | int] = []
    for i, part in enumerate(loc):
        is_missing_key = kind == "missing" and i == len(loc) - 1
        if _has(data, part):
            data = data[part]
        elif not is_missing_key:
            continue  # a tag
        clean.append(part)
    if kind.startswith("union_tag"):
        clean.append(_tag_key(error))
    return tuple(clean)


def _has(data: Any, part: str | int) -> bool:
    """Whether a map has a key, or a list an index."""
    if isinstance(data, dict):
        return part in data
    return isinstance(data, list) and isinstance(part, int) and part < len(data)


def _repair(data: Any, loc: Loc, errors: Sequence[ErrorDetails]) -> bool:
    """Turn a whole float into an integer where one is needed (``total_timesteps=1e6``)."""
    value = errors[0]["input"]
    if {e["type"] for e in errors} != {"int_type"} or not isinstance(value, float):
        return False
    if not value.is_integer():
        return False
    for part in loc[:-1]:
        data = data[part]
    data[loc[-1]] = int(value)
    return True


def _prune(data: Any, loc: Loc, errors: Sequence[ErrorDetails]) -> Loc:
    """Remove a wrong key, the list that contains it, or the map that lacks a required key."""
    if errors[0]["type"] == "missing" or errors[0]["type"].startswith("union_tag"):
        loc = loc[:-1]
    while loc and isinstance(loc[-1], int):
        loc = loc[:-1]
    for part in loc[:-1]:
        data = data.get(part, {})
    if loc:
        data.pop(loc[-1], None)
    return loc


def _problem(path: str, loc: Loc, errors: Sequence[ErrorDetails], data: Any) -> Problem:
    """The message for the user."""
    error = errors[0]
    kind = error["type"]
    value = error["input"]
    if kind == "unexpected_keyword_argument":
        return _unknown_key(path, loc, value, data)
    if kind.startswith("union_tag"):
        return _wrong_tag(path, value, _tag_key(error))
    if kind in ("too_short", "too_long"):
        expected = _expected_length(schema_at(loc, data))
        return Problem(path, f"expected {expected}, got {len(value)}: {show_value(value)}")
    message, hint = what_is_wrong(errors, PATTERNS)
    if value is None and not hint and schema_at(loc, data).get("additionalProperties"):
        hint = "Null takes out single entries: NAME: null."
    return Problem(path, message, hint, expected=expected_kind(errors))


def _expected_length(schema: Mapping[str, Any]) -> str:
    """The length of a list, from its schema: ``at least 2 values``."""
    low = schema.get("minItems")
    high = schema.get("maxItems")
    values = "value" if 1 in (low, high) else "values"
    if low is None:
        return f"at most {high} {values}"
    if low == high:
        return f"{low} {values}"
    return f"at least {low} {values}"


def _unknown_key(path: str, loc: Loc, value: Any, data: Any) -> Problem:
    """The problem of a key that does not exist, with the key that was meant."""
    allowed = key_names(schema_at(loc[:-1], data))
    if len(loc) > 1 and loc[:-1] == ("task",):
        allowed = [name for name in allowed if name not in ROOT_INSTEAD]
    name = str(loc[-1])
    if REFERENCE_WORDS.get(name) in allowed:
        return Problem(path, said_twice(REFERENCE_WORDS[name]))
    if loc[:-1] == ("algo",) and name in ALGO_INSTEAD:
        return Problem(path, f"not a key of an algorithm; {ALGO_INSTEAD[name]}")
    message, hint = unknown_key(name, allowed)
    if len(loc) == 1 and name in key_names(schema_at(["task"], {})):
        hint = f"Did you mean 'task.{name}'?"
    return Problem(path, message, hint)


def _tag_key(error: ErrorDetails) -> str:
    """The key that should have chosen between the members of a union: ``shape_type``."""
    return str(error["ctx"]["discriminator"]).strip("'")


def _wrong_tag(path: str, value: Any, key: str) -> Problem:
    """The problem of a map whose key `key` names no member of a union."""
    tag = value.get(key) if isinstance(value, dict) else None
    names = _first_tags(key)
    what = "algorithm" if key == "name" else key.removesuffix("_type")
    if tag is None:
        return Problem(path, f"missing value; one of: {', '.join(names)}")
    message = f"unknown {what} {show_value(tag)}; one of: {', '.join(names)}."
    if key == "sensor_type":
        message += "".join(f" Besides, {reason}." for reason in SENSORS.broken)
    return Problem(path, message, did_you_mean(str(tag), names).strip())


@cache
def _first_tags(key: str) -> list[str]:
    """The names of the members of the union that a key chooses between."""
    schema = TypeAdapter(_TAGS[key]).json_schema()
    names = []
    for reference in schema["oneOf"]:
        member = schema["$defs"][reference["$ref"].rpartition("/")[2]]
        names.append(_tags(member, key)[0])
    return names


def _tags(member: Mapping[str, Any], key: str) -> list[str]:
    """The tags of a union's member: its name, then other names of it."""
    tag = member["properties"][key]
    if "enum" in tag:
        return list(tag["enum"])
    return [tag["const"]]


def schema_at(parts: Sequence[str | int], data: Any) -> Mapping[str, Any]:
    """Return the JSON schema of a key path; empty if none is declared.

    Args:
        parts: The path; keys of maps and indices of lists included.
        data: The tree that is checked; its values choose between the members of unions.
    """
    schema = _chosen(_schema(), data)
    for part in parts:
        data = data[part] if _has(data, part) else None
        keys = schema.get("properties", {})
        if part not in keys and REFERENCE_WORDS.get(str(part)) in keys:
            part = REFERENCE_WORDS[str(part)]
        if part in keys:
            child = keys[part]
        elif isinstance(part, int):
            child = schema.get("items")
        else:
            child = schema.get("additionalProperties")
        schema = _chosen(child or {}, data)
    return schema


def key_names(schema: Mapping[str, Any]) -> list[str]:
    """Return the keys that a schema declares; empty if it is not that of a config class."""
    return list(schema.get("properties", ()))


def _schema() -> dict[str, Any]:
    return _schema_of(SENSORS.revision)


@cache
def _schema_of(revision: int) -> dict[str, Any]:
    return _adapter_of(revision).json_schema()


def _chosen(schema: Any, value: Any) -> Mapping[str, Any]:
    """The member of a union that fits a value: by its tag, else by its type, else the first."""
    if not isinstance(schema, Mapping):  # additionalProperties: true
        return {}
    if "$ref" in schema:
        return _chosen(_schema()["$defs"][schema["$ref"].rpartition("/")[2]], value)
    members = schema.get("oneOf") or schema.get("anyOf")
    if not members:
        return schema
    tag = schema.get("discriminator", {"propertyName": ""})["propertyName"]
    schemas = [_chosen(member, value) for member in members]
    if isinstance(value, Mapping) and tag in value:
        schemas.sort(key=lambda member: value[tag] not in _tags(member, tag))
    kind = "array" if isinstance(value, list) else "object"
    return next((member for member in schemas if member.get("type") == kind), schemas[0])

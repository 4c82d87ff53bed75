"""`ConfigTypes`: keys, types, lengths and ranges of a config, checked by pydantic's data classes.

A plain tree, as YAML has it, and a config made in Python are checked against the same types: a
tree's mistakes are removed from it, so that other checks can go on; `check_config` raises those of
a config that a `BaseEnv` or a `SimulationManager` receives. Pydantic finds all mistakes at once;
each becomes a `Problem`.
"""

from __future__ import annotations

import copy
import dataclasses
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, cached_property
from pathlib import PurePath
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError
from pydantic_core import SchemaValidator

from embodichain.lab.sim.configs.references import REFERENCE_WORDS
from embodichain.lab.sim.configs.sensor_cfg import SENSORS
from embodichain.utils.configclass import MISSING, is_configclass
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.fields.type_errors import (
    ErrorDetails,
    expected_kind,
    said_twice,
    show_value,
    unknown_key,
    what_is_wrong,
)
from embodichain.utils.suggest import did_you_mean

__all__ = ["CheckedTree", "ConfigTypes", "Loc", "check_config", "config_types", "key_names"]

_PACKAGE = "embodichain."
_MOST_NUMBERS = 1_000_000
"""In an array that is checked as a list; no field of a config has more."""
Loc = tuple[str | int, ...]
Cfg = TypeVar("Cfg")


@dataclasses.dataclass(frozen=True)
class CheckedTree:
    """The result of checking a plain tree.

    Attributes:
        value: The config without its wrong keys; None if too little is left.
        tree: The same as plain values; whole floats are integers where an integer is needed.
        problems: Key path -> mistake.
        pruned: Paths that were left out of `value`.
    """

    value: Any
    tree: dict[str, Any]
    problems: dict[str, Problem]
    pruned: tuple[str, ...]


class ConfigTypes:
    """The types of a config and of all configs in it.

    Args:
        annotation: The config class, or a union of such.
        patterns: Regular expression of a type -> description of the texts that it matches.
        explain_key: Returns the problem of an unknown key (its location, and the keys that are
            allowed) where there is more to say than that it is unknown, else None.
    """

    def __init__(
        self,
        annotation: Any,
        *,
        patterns: Mapping[str, str] | None = None,
        explain_key: Callable[[Loc, Sequence[str]], Problem | None] | None = None,
    ) -> None:
        self._adapter = TypeAdapter(annotation)
        self._patterns = patterns or {}
        self._explain_key = explain_key

    # -- checking ------------------------------------------------------------------------------

    def check_tree(
        self, tree: Mapping[str, Any], indispensable: Iterable[Loc] = ((),)
    ) -> CheckedTree:
        """Check plain dicts and lists, as YAML has them, and build the config.

        Args:
            tree: The values; changed. A whole number written as a float passes for an integer.
            indispensable: Locations without which nothing is left to check.
        """
        data = dict(tree)
        problems: dict[str, Problem] = {}
        pruned: set[str] = set()
        while True:  # ends, because each iteration repairs or removes something
            try:
                text = json.dumps(data, default=str)
                value = self._adapter.validate_json(text, strict=True)
                return CheckedTree(value, data, problems, tuple(sorted(pruned)))
            except ValidationError as error:
                groups = self._by_location(error.errors(include_url=False), data)
            for loc, errors in groups.items():
                if _repair(data, loc, errors):
                    continue
                path = _path(loc)
                problems.setdefault(path, self._problem(loc, errors, data))
                removed = _prune(data, loc, errors)
                pruned.add(_path(removed))
                if removed in indispensable:
                    return CheckedTree(None, data, problems, tuple(sorted(pruned)))

    def check_instance(self, cfg: Any) -> list[Problem]:
        """Return every mistake in a config made in Python; it is not changed.

        Arrays, tensors and numpy's numbers are checked as the lists and numbers that they contain,
        paths of files as texts. A config may be of a subclass with further fields, which are not
        checked; one of this package's own classes has no attributes besides its fields.
        """
        problems = {problem.path: problem for problem in self._unknown_attributes(cfg, ())}
        values = _plain_values(cfg)
        while True:  # ends, because each iteration repairs something
            try:
                self._instances.validate_python(values, strict=True)
                return list(problems.values())
            except ValidationError as error:
                groups = self._by_location(error.errors(include_url=False), values)
            # All of them: a value may be repaired and another one beside it be wrong.
            repaired = [_repair(values, loc, errors) for loc, errors in groups.items()]
            if not any(repaired):
                break
        for loc, errors in groups.items():
            problems.setdefault(_path(loc), self._problem(loc, errors, values))
        return list(problems.values())

    @cached_property
    def _instances(self) -> SchemaValidator:
        """The same types for configs that exist; pydantic alone would not look into these."""
        return SchemaValidator(_looking_inside(self._adapter.core_schema))

    def _unknown_attributes(self, node: Any, loc: Loc) -> Iterator[Problem]:
        """Yield the attributes of the configs in a config that are not fields of their class."""
        for key, value in _entries(node):
            yield from self._unknown_attributes(value, (*loc, key))
        # A subclass of a user may have attributes that its methods set.
        if not _is_config(node) or not type(node).__module__.startswith(_PACKAGE):
            return
        allowed = [field.name for field in dataclasses.fields(node)]
        for name in vars(node):
            is_declared = name in allowed or hasattr(type(node), name)
            if not is_declared and not name.startswith("_"):
                yield self._unknown_key((*loc, name), allowed)

    # -- places of errors ----------------------------------------------------------------------

    def _by_location(
        self, errors: Iterable[ErrorDetails], data: Any
    ) -> dict[Loc, list[ErrorDetails]]:
        """Errors by key path; of the errors of a union's members, the deepest are kept."""
        groups: dict[Loc, list[ErrorDetails]] = {}
        for error in errors:
            groups.setdefault(self._location(error, data), []).append(error)
        ancestors = {loc[:depth] for loc in groups for depth in range(len(loc))}
        return {loc: group for loc, group in groups.items() if loc not in ancestors}

    def _location(self, error: ErrorDetails, data: Any) -> Loc:
        """The keys of an error, without the tags of unions that pydantic puts between them."""
        parts = error["loc"]
        declared: Any = self._schema
        keys: list[str | int] = []
        tag_is_next = self._tagged_union(declared) is not None
        for i, part in enumerate(parts):
            is_missing_key = error["type"] == "missing" and i == len(parts) - 1
            if tag_is_next or not (_has(data, part) or is_missing_key):
                tag_is_next = False  # there may be a key that is called like the tag
                continue
            keys.append(part)
            declared = self._declared_in(declared, part, data)
            data = _child(data, part) if _has(data, part) else None
            tag_is_next = self._tagged_union(declared) is not None
        if error["type"].startswith("union_tag"):
            keys.append(_tag_key(error))
        return tuple(keys)

    # -- messages ------------------------------------------------------------------------------

    def _problem(self, loc: Loc, errors: Sequence[ErrorDetails], data: Any) -> Problem:
        """The message for the user."""
        error = errors[0]
        kind = error["type"]
        value = error["input"]
        path = _path(loc)
        if kind == "unexpected_keyword_argument":
            return self._unknown_key(loc, key_names(self.schema_at(loc[:-1], data)))
        if kind.startswith("union_tag"):
            return self._wrong_tag(loc, value, _tag_key(error), data)
        if value is MISSING:
            return Problem(path, "missing value: it must be set")
        if kind in ("too_short", "too_long"):
            expected = _expected_length(self.schema_at(loc, data))
            return Problem(path, f"expected {expected}, got {len(value)}: {show_value(value)}")
        if all(error["type"] == "dataclass_exact_type" for error in errors):
            return Problem(path, _expected_class(errors, value))
        message, hint = what_is_wrong(errors, self._patterns)
        if value is None and not hint and self.schema_at(loc, data).get("additionalProperties"):
            hint = "Null takes out single entries: NAME: null."
        return Problem(path, message, hint, expected=expected_kind(errors))

    def _unknown_key(self, loc: Loc, allowed: Sequence[str]) -> Problem:
        """The problem of a key that does not exist, with the key that was meant."""
        path = _path(loc)
        name = str(loc[-1])
        if REFERENCE_WORDS.get(name) in allowed:
            return Problem(path, said_twice(REFERENCE_WORDS[name]))
        if self._explain_key is not None:
            problem = self._explain_key(loc, allowed)
            if problem is not None:
                return problem
        message, hint = unknown_key(name, allowed)
        return Problem(path, message, hint)

    def _wrong_tag(self, loc: Loc, value: Any, key: str, data: Any) -> Problem:
        """The problem of a map whose key `key` names no member of a union."""
        tag = _child(value, key) if _has(value, key) else None
        names = self._tags_at(loc[:-1], data)
        what = "algorithm" if key == "name" else key.removesuffix("_type")
        if tag is None:
            return Problem(_path(loc), f"missing value; one of: {', '.join(names)}")
        message = f"unknown {what} {show_value(tag)}; one of: {', '.join(names)}."
        if key == "sensor_type":
            message += "".join(f" Besides, {reason}." for reason in SENSORS.broken)
        return Problem(_path(loc), message, did_you_mean(str(tag), names).strip())

    # -- schema --------------------------------------------------------------------------------

    def schema_at(self, parts: Sequence[str | int], data: Any) -> Mapping[str, Any]:
        """Return the JSON schema of a key path; empty if none is declared.

        Args:
            parts: The path; keys of maps and indices of lists included.
            data: What is checked; its values choose between the members of unions.
        """
        declared, data = self._declared_at(parts, data)
        return self._chosen(declared, data)

    def _declared_at(self, parts: Sequence[str | int], data: Any) -> tuple[Any, Any]:
        """The schema of a key path as it is declared, a union too, and the value there."""
        declared: Any = self._schema
        for part in parts:
            declared = self._declared_in(declared, part, data)
            data = _child(data, part) if _has(data, part) else None
        return declared, data

    def _declared_in(self, declared: Any, part: str | int, data: Any) -> Any:
        """The schema of a key or an index below a declared one; `data` is the value above it."""
        schema = self._chosen(declared, data)
        keys = schema.get("properties", {})
        if part not in keys and REFERENCE_WORDS.get(str(part)) in keys:
            part = REFERENCE_WORDS[str(part)]
        if part in keys:
            return keys[part]
        if isinstance(part, int):
            return schema.get("items") or {}
        return schema.get("additionalProperties") or {}

    @cached_property
    def _schema(self) -> dict[str, Any]:
        return self._adapter.json_schema()

    def _chosen(self, schema: Any, value: Any) -> Mapping[str, Any]:
        """The member of a union that fits a value: by its tag, else by its type, else the first."""
        schema = self._followed(schema)
        members = _members(schema)
        if not members:
            return schema
        tag = schema.get("discriminator", {"propertyName": ""})["propertyName"]
        schemas = [self._chosen(member, value) for member in members]
        if tag and _has(value, tag):
            schemas.sort(key=lambda member: _child(value, tag) not in _tags(member, tag))
        kind = "array" if isinstance(value, list) else "object"
        return next((member for member in schemas if member.get("type") == kind), schemas[0])

    def _followed(self, schema: Any) -> Mapping[str, Any]:
        """A schema, or the one that it refers to."""
        if not isinstance(schema, Mapping):  # additionalProperties: true
            return {}
        if "$ref" in schema:
            return self._followed(self._schema["$defs"][schema["$ref"].rpartition("/")[2]])
        return schema

    def _tagged_union(self, declared: Any) -> Mapping[str, Any] | None:
        """The union with tags that a declared schema is, or that it allows besides others."""
        schema = self._followed(declared)
        for candidate in (schema, *map(self._followed, _members(schema))):
            if "discriminator" in candidate:
                return candidate
        return None

    def _tags_at(self, parts: Sequence[str | int], data: Any) -> list[str]:
        """The first name of each member of the union at a key path."""
        declared, _ = self._declared_at(parts, data)
        union = self._tagged_union(declared) or {}
        key = str(union["discriminator"]["propertyName"])
        return [_tags(self._followed(member), key)[0] for member in _members(union)]


def key_names(schema: Mapping[str, Any]) -> list[str]:
    """Return the keys that a schema declares; empty if it is not that of a config class."""
    return list(schema.get("properties", ()))


# -- doors ---------------------------------------------------------------------------------------


def config_types(annotation: Any) -> ConfigTypes:
    """Return the types of a config class; those of sensors are the ones registered now."""
    return _config_types(annotation, SENSORS.revision)


@cache
def _config_types(annotation: Any, revision: int) -> ConfigTypes:
    return ConfigTypes(annotation)


def check_config(cfg: Any, annotation: Any, path: str = "") -> None:
    """Check a config made in Python against the types of its class.

    Args:
        cfg: The config.
        annotation: The class that is needed, or a union of such.
        path: The key path of the config.

    Raises:
        ConfigError: Lists every mistake.
    """
    problems = config_types(annotation).check_instance(cfg)
    if problems:
        raise ConfigError(problem.below(path) if path else problem for problem in problems)


# -- values --------------------------------------------------------------------------------------


def _is_config(value: Any) -> bool:
    return is_configclass(value) and not isinstance(value, type)


def _entries(node: Any) -> Iterable[tuple[Any, Any]]:
    """The fields of a config, or the entries of a map or a list; nothing of any other value."""
    if _is_config(node):
        return [(field.name, getattr(node, field.name)) for field in dataclasses.fields(node)]
    if isinstance(node, Mapping):
        return node.items()
    if isinstance(node, list | tuple):
        return enumerate(node)
    return ()


def _has(data: Any, part: Any) -> bool:
    """Whether a config has a field, a map a key, or a list an index."""
    if _is_config(data):
        return any(field.name == part for field in dataclasses.fields(data))
    if isinstance(data, dict):
        return part in data
    return isinstance(data, list | tuple) and isinstance(part, int) and part < len(data)


def _child(data: Any, part: Any) -> Any:
    """The value of a field, a key or an index that exists."""
    return getattr(data, part) if _is_config(data) else data[part]


def _plain_values(value: Any) -> Any:
    """A copy in which configs stay configs, and other values are those that YAML has.

    Values that YAML does not have, such as functions, stay.
    """
    if _is_config(value):
        cfg = copy.copy(value)
        for name, item in _entries(value):
            vars(cfg)[name] = _plain_values(item)
        return cfg
    if isinstance(value, Mapping):
        return {key: _plain_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain_values(item) for item in value]
    # An array, a tensor, or a number of numpy's. Larger ones are data of a term, not values.
    if hasattr(value, "tolist") and math.prod(value.shape) <= _MOST_NUMBERS:
        return value.tolist()
    if isinstance(value, PurePath):
        return str(value)
    return value


def _looking_inside(schema: Any) -> Any:
    """A copy of a schema of pydantic's whose data classes check instances, too, field by field."""
    if isinstance(schema, list | tuple):
        return type(schema)(_looking_inside(item) for item in schema)
    if not isinstance(schema, dict):
        return schema
    inside = {key: _looking_inside(item) for key, item in schema.items()}
    if schema.get("type") == "dataclass":
        inside["revalidate_instances"] = "always"
    return inside


# -- errors --------------------------------------------------------------------------------------


def _path(loc: Loc) -> str:
    return ".".join(map(str, loc))


def _tag_key(error: ErrorDetails) -> str:
    """The key that should have chosen between the members of a union: ``shape_type``."""
    return str(error["ctx"]["discriminator"]).strip("'")


def _repair(data: Any, loc: Loc, errors: Sequence[ErrorDetails]) -> bool:
    """Change a value in place that means one of the right type; return whether there is one.

    That is an integer for a whole float (``total_timesteps=1e6``), and a tuple for a list.
    """
    value = errors[0]["input"]
    kinds = {error["type"] for error in errors}
    repaired: Any
    if kinds == {"int_type"} and isinstance(value, float) and value.is_integer():
        repaired = int(value)
    elif "tuple_type" in kinds and isinstance(value, list):
        repaired = tuple(value)
    else:
        return False
    for part in loc[:-1]:
        data = _child(data, part)
    if _is_config(data):
        vars(data)[str(loc[-1])] = repaired
    elif isinstance(data, dict | list):
        data[loc[-1]] = repaired  # type: ignore[index]
    else:
        return False
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


def _expected_length(schema: Mapping[str, Any]) -> str:
    """The length of a list or a map, from its schema: ``at least 2 values``."""
    low = schema.get("minItems", schema.get("minProperties"))
    high = schema.get("maxItems", schema.get("maxProperties"))
    values = "value" if 1 in (low, high) else "values"
    if low is None:
        return f"at most {high} {values}"
    if low == high:
        return f"{low} {values}"
    return f"at least {low} {values}"


def _expected_class(errors: Sequence[ErrorDetails], value: Any) -> str:
    """The message for a value in the place of a config."""
    names = list(dict.fromkeys(str(error["ctx"]["class_name"]) for error in errors))
    article = "an" if names[0][0] in "AEIOU" else "a"
    message = f"must be {article} {' or '.join(names)}, got {type(value).__name__}"
    if isinstance(value, Mapping):
        message += f"; {names[0]}.from_dict makes one"
    return message


def _members(schema: Mapping[str, Any]) -> Sequence[Any]:
    return schema.get("oneOf") or schema.get("anyOf") or ()


def _tags(member: Mapping[str, Any], key: str) -> list[str]:
    """The tags of a union's member: its name, then other names of it."""
    tag = member["properties"][key]
    if "enum" in tag:
        return list(tag["enum"])
    return [tag["const"]]

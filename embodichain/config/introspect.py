"""What the data classes allow at a key path: for lists of allowed keys in messages.

Reads type annotations only; checking values is pydantic's (`check_types`).
"""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Annotated, Any, Union

from embodichain.config.algorithms import AnyAlgoCfg
from embodichain.lab.sim.sensors.cfg import AnySensorCfg
from embodichain.lab.sim.shapes import AnyShapeCfg

__all__ = ["TAGS", "field_names", "is_named_map", "length_at", "tag_values", "type_at"]

TAGS: dict[str, Any] = {
    "shape_type": AnyShapeCfg,
    "sensor_type": AnySensorCfg,
    "name": AnyAlgoCfg,
}
"""Keys that choose between the members of a union, and the union."""


def type_at(root: type, parts: Sequence[str | int], data: Any) -> Any:
    """Return the annotation of a key path, or None where nothing is declared.

    Args:
        root: A config class.
        parts: The path; keys of maps and indices of lists included.
        data: The tree that is checked: its values choose between the members of unions.
    """
    current: Any = root
    for part in parts:
        data = _child(data, part)
        current = _step(current, part, data)
        if current is None:
            return None
    return _select(current, data)


def field_names(annotation: Any) -> list[str]:
    """Return the keys of a config class; empty for anything else."""
    return [f.name for f in dataclasses.fields(annotation)] if _is_config(annotation) else []


def is_named_map(annotation: Any) -> bool:
    """Whether it is a map of config classes keyed by name: entities, terms."""
    arguments = typing.get_args(annotation)
    return typing.get_origin(annotation) is dict and _is_config(arguments[1])


def length_at(root: type, parts: Sequence[str | int], data: Any) -> str:
    """Return how many items a list at a path may have, as text: ``3``, ``at least 1``."""
    parent = type_at(root, parts[:-1], data)
    limits = _limits(_hints(parent).get(str(parts[-1]))) if _is_config(parent) else {}
    low, high = limits.get("min_length"), limits.get("max_length")
    if low is not None and low == high:
        return str(low)
    return f"at least {low}" if low is not None else f"at most {high}"


def tag_values(tag: str) -> list[str]:
    """Return the names that a key of `TAGS` may have."""
    return [str(_default(member, tag)) for member in _members(TAGS[tag])]


def _limits(annotation: Any) -> dict[str, int]:
    """The length limits in the `Annotated` metadata of an annotation, or of a union's members."""
    limits: dict[str, int] = {}
    if typing.get_origin(annotation) is Annotated:
        for field in typing.get_args(annotation)[1:]:
            for limit in getattr(field, "metadata", ()):
                names = [k for k in ("min_length", "max_length") if hasattr(limit, k)]
                limits |= {name: getattr(limit, name) for name in names}
    elif typing.get_origin(annotation) in (Union, types.UnionType):
        for member in typing.get_args(annotation):
            limits |= _limits(member)
    return limits


def _step(annotation: Any, part: str | int, child: Any) -> Any:
    """The annotation one key further down."""
    for member in _members(annotation):
        origin, arguments = typing.get_origin(member), typing.get_args(member)
        if _is_config(member) and part in _hints(member):
            return _select(_hints(member)[str(part)], child)
        if origin is dict and isinstance(part, str):
            return _select(arguments[1], child)
        if origin is list and isinstance(part, int):
            return _select(arguments[0], child)
    return None


def _select(annotation: Any, value: Any) -> Any:
    """The member of a union that a value is meant for: by its tag, else the first class."""
    members = [m for m in _members(annotation) if m is not type(None)]
    if len(members) > 1 and isinstance(value, Mapping):
        for member in members:
            if _is_config(member) and _is_tagged(member, value):
                return member
        maps = [m for m in members if _is_config(m) or typing.get_origin(m) is dict]
        return maps[0] if maps else members[0]
    return members[0] if len(members) == 1 else annotation


def _members(annotation: Any) -> list[Any]:
    if typing.get_origin(annotation) is Annotated:
        return _members(typing.get_args(annotation)[0])
    if typing.get_origin(annotation) in (Union, types.UnionType):
        return [m for a in typing.get_args(annotation) for m in _members(a)]
    return [annotation]


def _is_tagged(config: Any, value: Mapping[str, Any]) -> bool:
    """Whether a map names this member of a union."""
    return any(tag in value and _default(config, tag) == value[tag] for tag in TAGS)


def _default(config: Any, name: str) -> Any:
    return next((f.default for f in dataclasses.fields(config) if f.name == name), None)


def _child(data: Any, part: str | int) -> Any:
    if isinstance(data, Mapping):
        return data.get(part)
    if isinstance(data, list) and isinstance(part, int) and part < len(data):
        return data[part]
    return None


def _is_config(annotation: Any) -> bool:
    return isinstance(annotation, type) and dataclasses.is_dataclass(annotation)


@cache
def _hints(config: type) -> dict[str, Any]:
    return typing.get_type_hints(config, include_extras=True)

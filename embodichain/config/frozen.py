"""Deep immutable copies of config trees, and their text: one tree always gives the same bytes."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import yaml

__all__ = ["dump_yaml", "freeze", "thaw"]


def freeze(value: Any) -> Any:
    """Return a deep copy that cannot change: mappings read-only, lists as tuples."""
    if isinstance(value, Mapping):
        return MappingProxyType({key: freeze(item) for key, item in value.items()})
    if isinstance(value, (list, tuple)):
        return tuple(freeze(item) for item in value)
    return value


def thaw(value: Any) -> Any:
    """Return a deep, mutable copy of what `freeze` made: dicts and lists."""
    if isinstance(value, Mapping):
        return {key: thaw(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [thaw(item) for item in value]
    return value


def dump_yaml(value: Any) -> str:
    """Return a tree as YAML: keys in their order, no aliases, lists of values on one line."""
    text: str = yaml.dump(
        thaw(value),
        Dumper=_Dumper,
        sort_keys=False,
        allow_unicode=True,
        width=100,
        default_flow_style=None,
    )
    return text


class _Dumper(yaml.SafeDumper):
    """Writes shared parts out twice: anchors would change with how a tree was built."""

    def ignore_aliases(self, data: Any) -> bool:
        """Never write an alias."""
        return True

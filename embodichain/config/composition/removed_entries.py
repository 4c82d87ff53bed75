"""`null` in a map keyed by name removes the inherited entry: terms, entities, sensors, parts.

Elsewhere null is a value. Which maps are keyed by name follows from the types: their values may be
anything but null.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from embodichain.config.keys.check_types import schema_at
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean

__all__ = ["remove_null_entries"]

_ARRANGED = ("params", "objects")
"""The objects of the event `arrange_objects`."""
Parts = tuple[str, ...]
_NESTED_TERMS = ("params", "terms")
"""The terms within `all_of`, `sum_of` and the like; parameters have no schema of keys."""


def remove_null_entries(
    tree: Mapping[str, Any], inherited: Callable[[str], bool]
) -> tuple[dict[str, Any], list[Problem]]:
    """Return a copy of a config without the entries that are null.

    Args:
        tree: Plain dicts and lists.
        inherited: Whether something before the null set a key path to a value.

    Returns:
        The copy, and a problem for each null that removes nothing.
    """
    remaining = copy.deepcopy(dict(tree))
    problems: list[Problem] = []
    for parts in list(_null_entries(remaining.get("task"), ("task",))):
        *parents, name = parts
        entries: Any = remaining
        for part in parents:
            entries = entries[part]
        if not _is_keyed_by_name(parents, remaining):
            continue
        del entries[name]
        path = ".".join(parts)
        if not inherited(path):
            message = (
                f"null removes an inherited entry, and there is no {name!r} in "
                f"{'.'.join(parents)}; there are: {', '.join(entries) or 'none'}"
            )
            hint = did_you_mean(name, entries).strip()
            problems.append(Problem(path, message, hint))
    return remaining, problems


def _null_entries(node: Any, parts: Parts) -> Iterator[Parts]:
    """The paths of all nulls that are entries of a map below a section of the task."""
    if not isinstance(node, dict):
        return
    for key, value in node.items():
        if value is None and len(parts) > 1:
            yield (*parts, key)
        yield from _null_entries(value, (*parts, key))


def _is_keyed_by_name(parts: list[str], tree: dict[str, Any]) -> bool:
    """Whether a map has free names, and values of a type that null is not of."""
    if tuple(parts[-2:]) == _NESTED_TERMS:
        return True
    if tuple(parts[-2:]) == _ARRANGED:
        event: Any = tree
        for part in parts[:-2]:
            event = event[part]
        return bool(event.get("func") == "arrange_objects")
    values = schema_at(parts, tree).get("additionalProperties")
    return isinstance(values, Mapping) and bool(values) and not _allows_null(values)


def _allows_null(schema: Mapping[str, Any]) -> bool:
    """Whether null is a value of a schema."""
    members = [*schema.get("anyOf", ()), *schema.get("oneOf", ())]
    return schema.get("type") == "null" or any(_allows_null(member) for member in members)

"""`short_repr`: what runtime objects say of themselves, one line with name, size and content."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

__all__ = ["short_repr"]

_MOST_NAMES = 12


def short_repr(instance: object, *names: object, **facts: Any) -> str:
    """Return the `repr` of an object: its class, its name, and facts.

    Args:
        instance: The object.
        *names: What it is called.
        **facts: Such as ``num_envs=4``. Empty ones and None are left out; of long lists, the first
            names are shown.
    """
    parts = [repr(name) for name in names]
    for key, value in facts.items():
        is_empty = value is None or (isinstance(value, Collection) and not value)
        if not is_empty:
            parts.append(f"{key}={_short(value)}")
    return f"{type(instance).__name__}({', '.join(parts)})"


def _short(value: Any) -> str:
    if isinstance(value, str) or not isinstance(value, Collection):
        return repr(value)
    if isinstance(value, Mapping):
        entries = [f"{key}: {_short(entry)}" for key, entry in value.items()]
        return f"{{{', '.join(_first(entries))}}}"
    if isinstance(value, tuple):
        return repr(value)
    return f"[{', '.join(_first([str(entry) for entry in value]))}]"


def _first(entries: list[str]) -> list[str]:
    """Entries, or the first of many and how many follow."""
    if len(entries) <= _MOST_NAMES:
        return entries
    return [*entries[:_MOST_NAMES], f"and {len(entries) - _MOST_NAMES} more"]

"""Values inside nested parameters, and values between two of them: for curricula."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

__all__ = ["between", "get_at", "progress", "with_value"]

_STAGES = 100
"""A value that changes gradually does so in this many stages: each builds its term anew."""


def get_at(tree: Any, path: Sequence[str]) -> Any:
    """Return what stands at a path of keys and indices.

    Raises:
        ConfigError: If nothing does; lists what is there.
    """
    for depth, part in enumerate(path):
        keys = _keys(tree)
        if part not in keys:
            where = ".".join(path[:depth]) or "the parameters"
            known = ", ".join(keys) or "nothing"
            raise ConfigError(
                f"there is no {part!r} in {where}; there is: {known}.{did_you_mean(part, keys)}"
            )
        tree = tree[part] if isinstance(tree, dict) else tree[int(part)]
    return tree


def _keys(tree: Any) -> list[str]:
    if isinstance(tree, dict):
        return [str(key) for key in tree]
    return [str(i) for i in range(len(tree))] if isinstance(tree, (list, tuple)) else []


def with_value(tree: Any, path: Sequence[str], value: Any) -> Any:
    """Return a copy of nested lists and maps with another value at a path that exists."""
    if not path:
        return value
    part, rest = path[0], path[1:]
    if isinstance(tree, dict):
        return {**tree, part: with_value(tree.get(part), rest, value)}
    return [with_value(v, rest, value) if str(i) == part else v for i, v in enumerate(tree)]


def between(start: Any, end: Any, fraction: float) -> Any:
    """Return the value at a fraction of the way, number by number in lists and maps.

    Raises:
        ConfigError: If the two are not numbers, or lists or maps of the same form.
    """
    if isinstance(start, dict) and isinstance(end, dict) and start.keys() == end.keys():
        return {key: between(start[key], end[key], fraction) for key in start}
    lists = isinstance(start, (list, tuple)) and isinstance(end, (list, tuple))
    if lists and len(start) == len(end):
        return [between(a, b, fraction) for a, b in zip(start, end, strict=True)]
    if any(isinstance(v, bool) or not isinstance(v, (int, float)) for v in (start, end)):
        raise ConfigError(f"cannot go gradually from {start!r} to {end!r}")
    # Exact at both ends.
    return start if fraction == 0.0 else (1.0 - fraction) * start + fraction * end


def progress(step: int, start: int, end: int, gradual: bool) -> float:
    """Return how much of a change is done at a control step: 0 to 1, in `_STAGES` stages.

    Args:
        step: Now.
        start: When it begins, if it is gradual.
        end: When it is complete.
        gradual: Otherwise it is all or nothing.
    """
    if step >= end:
        return 1.0
    if not gradual or step <= start:
        return 0.0
    return (step - start) * _STAGES // (end - start) / _STAGES

"""Parameters with one value a joint: `PerJoint`, `JointClip`, and functions that spread them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import PlainValidator

from embodichain.lab.sim.compiler.names import match
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.api import F64

__all__ = ["JointClip", "PerJoint", "joint_clip", "per_joint"]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _numbers(value: Any) -> Any:
    parts = (
        value.values()
        if isinstance(value, Mapping)
        else value
        if isinstance(value, (list, tuple))
        else [value]
    )
    if not parts or not all(map(_is_number, parts)):
        raise ValueError("must be a finite number, a list of one a joint, or {joint regex: number}")
    return value


def _interval(value: Any) -> tuple[float, float]:
    """[low, high], or a number c for [-c, c]."""
    if _is_number(value):
        value = (-value, value)
    if not (isinstance(value, (list, tuple)) and len(value) == 2 and all(map(_is_number, value))):
        raise ValueError(
            "must be [low, high] or one number for both sides, a list of such pairs (one a joint), "
            "or {joint regex: [low, high]}"
        )
    low, high = map(float, value)
    if low >= high:
        relation = "equals" if low == high else "exceeds"
        raise ValueError(f"low {low} {relation} high {high}")
    return low, high


def _intervals(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {pattern: _interval(one) for pattern, one in value.items()}
    if isinstance(value, (list, tuple)) and any(isinstance(v, (list, tuple)) for v in value):
        return [_interval(one) for one in value]
    return _interval(value)


PerJoint = Annotated[float | list[float] | dict[str, float], PlainValidator(_numbers)]
"""A number for all joints, a list of one a joint, or {joint regex: number}."""
JointClip = Annotated[
    float | list[float] | list[list[float]] | dict[str, list[float]], PlainValidator(_intervals)
]
"""[low, high] (or c for [-c, c]) for all joints, a list of such pairs, or {joint regex: pair}."""


def per_joint(
    value: Any,
    names: Sequence[str],
    path: str,
    default: float | None = None,
    what: str = "joint",
) -> F64:
    """Spread a `PerJoint` over joints, or other named things.

    Args:
        value: As declared.
        names: The A joints.
        path: Key path of the parameter, for messages.
        default: Value of joints that no regex of a map matches; None requires that all match.
        what: The kind of the names, for messages.

    Returns:
        (A,) float64.

    Raises:
        ConfigError: If a list does not have one value per joint; if a regex matches no joint, or
            one that another regex matches; or if a joint has no value. Lists the joints.
    """
    fallback = () if default is None else (default,)
    return _spread(value, names, path, fallback, False, what)[:, 0]


def joint_clip(value: Any, names: Sequence[str], path: str, what: str = "joint") -> tuple[F64, F64]:
    """Low and high, (A,) each, of a `JointClip`; raises like `per_joint` without a default."""
    low, high = _spread(_intervals(value), names, path, (), True, what).T.copy()
    return low, high


def _spread(
    value: Any, names: Sequence[str], path: str, default: Any, paired: bool, what: str
) -> F64:
    """(A, width) one row per joint."""
    count, width = len(names), 2 if paired else 1
    if isinstance(value, Mapping):
        rows = _matched(value, names, path, what)
        missing = [name for name in names if name not in rows]
        if missing and not default:
            problem = Problem(path, f"says nothing about {what}s: {', '.join(missing)}")
            raise ConfigError([problem])
        value = [rows.get(name, default[0] if default else None) for name in names]
    elif not isinstance(value, (list, tuple)) or (paired and isinstance(value, tuple)):
        value = [value] * count
    if len(value) != count:
        message = f"needs one value or {count}, one a {what}; got {len(value)}"
        raise ConfigError([Problem(path, message)])
    found: F64 = np.asarray(value, np.float64).reshape(count, width)
    return found


def _matched(
    value: Mapping[str, Any], names: Sequence[str], path: str, what: str
) -> dict[str, Any]:
    """Name -> value of the one regex that matches it in full."""
    found: dict[str, Any] = {}
    source: dict[str, str] = {}
    for pattern, one in value.items():
        where = f"{path}.{pattern}"
        hits, problems = match(pattern, names, f"{what} of this term", where)
        if problems:
            raise ConfigError(problems)
        for name in (names[i] for i in hits):
            if name in source:
                message = f"{what} {name!r} is matched by {source[name]!r} as well"
                raise ConfigError([Problem(where, message)])
            source[name], found[name] = pattern, one
    return found

"""Parameters with one value for each joint, link or other name: lists and maps.

Columns of a term are in the entity's order, whatever the order of the names that a reference
writes. `in_columns` gives each value of a list to the name that it was written for; `per_joint` and
`joint_clip` spread numbers, lists and maps over columns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import PlainValidator

from embodichain.lab.sim.compiler.names import exact_pattern, match, match_every
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.names import NamedBy
    from embodichain.utils.array_types import Floats

__all__ = [
    "JointClip",
    "PerJoint",
    "in_columns",
    "joint_clip",
    "map_to_write",
    "per_joint",
    "ranges_in_columns",
]

_DEFAULT = ".*"
"""The key of a map whose value names have that no other key matches."""


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _numbers(value: Any) -> Any:
    if isinstance(value, Mapping):
        parts = list(value.values())
    elif isinstance(value, (list, tuple)):
        parts = list(value)
    else:
        parts = [value]
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
    """An interval for all, a list of them, or a map from regexes."""
    if isinstance(value, Mapping):
        return {pattern: _interval(bounds) for pattern, bounds in value.items()}
    if isinstance(value, (list, tuple)) and any(isinstance(part, (list, tuple)) for part in value):
        return [_interval(bounds) for bounds in value]
    return _interval(value)


PerJoint = Annotated[float | list[float] | dict[str, float], PlainValidator(_numbers)]
"""A number for all joints, a list of one a joint, or {joint regex: number}, ``.*`` the default."""
JointClip = Annotated[
    float | list[float] | list[list[float]] | dict[str, list[float]], PlainValidator(_intervals)
]
"""[low, high] (or c for [-c, c]) for all joints, a list of such pairs, or {joint regex: pair}."""


def in_columns(
    values: Sequence[Any],
    names: Sequence[str],
    named_by: Sequence[NamedBy],
    path: str,
    what: str = "joint",
) -> list[Any]:
    """Put a list in the order of the columns: each value goes with the name it was written for.

    Without names the list is in the order of the columns, which is the entity's. So it is with
    control parts, if the parts have that order too.

    Args:
        values: The list.
        names: The names of the columns.
        named_by: The entries of the reference that name them, as written.
        path: Key path of the list, for messages.
        what: The kind of the names, for messages.

    Raises:
        ConfigError: If there is not one value a name, a regex matches several names, or a name has
            no column. Shows the map to write instead.
    """
    problem = _check_list(values, names, named_by, path=path, what=what)
    if problem is not None:
        raise ConfigError([problem])
    if not named_by or any(entry.is_part for entry in named_by):
        return list(values)
    by_name = {entry.names[0]: value for entry, value in zip(named_by, values, strict=True)}
    return [by_name[name] for name in names]


def _check_list(
    values: Sequence[Any],
    names: Sequence[str],
    named_by: Sequence[NamedBy],
    *,
    path: str,
    what: str,
) -> Problem | None:
    """Return what is wrong with a list beside a reference, or None."""
    hint = f"Write {map_to_write(path, names, values)}"
    for entry in named_by:
        if len(entry.names) != 1 and not entry.is_part:
            message = (
                f"a list has one number for each plain name in {entry.key}, but "
                f"{entry.text!r} matches several: {', '.join(entry.names)}"
            )
            return Problem(path, message, hint)
    written = [name for entry in named_by for name in entry.names]
    if any(entry.is_part for entry in named_by):
        if [name for name in written if name in names] != list(names):
            parts = ", ".join(entry.text for entry in named_by)
            message = (
                f"the order of a list is not clear: {parts} name the {what}s as "
                f"{', '.join(written)}; the columns are {', '.join(names)}"
            )
            return Problem(path, message, hint)
        # Names of a part that this term does not use have no value.
        written = list(names)
    expected = written or list(names)
    if len(values) != len(expected):
        message = (
            f"needs one value or {len(expected)}, one a {what}: {', '.join(expected)}; "
            f"got {len(values)}"
        )
        return Problem(path, message, hint)
    repeated = sorted({name for name in written if written.count(name) > 1})
    if repeated:
        key = named_by[0].key
        message = f"has several numbers for {', '.join(repeated)}, which {key} names twice"
        return Problem(path, message, hint)
    unused = [name for name in written if name not in names]
    if unused:
        message = (
            f"has numbers for {', '.join(unused)}, which this term does not use; its {what}s "
            f"are {', '.join(names)}"
        )
        return Problem(path, message, hint)
    return None


def map_to_write(path: str, names: Sequence[str], values: Sequence[Any]) -> str:
    """Return a map as YAML: of the values in the order of the names if each has one, else of dots.

    Args:
        path: Key path of the parameter.
        names: The names, in the order of the columns.
        values: The values.
    """
    names = list(dict.fromkeys(names))
    shown = ["..."] * len(names)
    if len(values) == len(names):
        shown = [_in_yaml(value) for value in values]
    entries = [f"{exact_pattern(name)}: {value}" for name, value in zip(names, shown, strict=True)]
    key = path.rpartition(".")[2]
    return f"{key}: {{{', '.join(entries)}}}"


def _in_yaml(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_in_yaml, value))}]"
    return f"{value:g}"


def per_joint(
    value: Any,
    names: Sequence[str],
    path: str,
    what: str = "joint",
    named_by: Sequence[NamedBy] = (),
) -> Floats:
    """Spread a `PerJoint` over joints, or other named things.

    Args:
        value: As declared.
        names: The A joints, in the order of the columns.
        path: Key path of the parameter, for messages.
        what: The kind of the names, for messages.
        named_by: The entries of the reference that name the joints; see `in_columns`.

    Returns:
        (A,) float64.

    Raises:
        ConfigError: If a list is wrong (see `in_columns`); if a regex of a map matches no joint, or
            one that another regex matches; or if a joint has no value. Lists the joints.
    """
    if isinstance(value, Mapping):
        rows = _matched(value, names, path=path, what=what, matching=match_every)
        _require_all(rows, names, path, what)
        value = [rows[name] for name in names]
    elif isinstance(value, (list, tuple)):
        value = in_columns(value, names, named_by, path=path, what=what)
    else:
        value = [value] * len(names)
    return np.asarray(value, np.float64)


def joint_clip(
    value: Any,
    names: Sequence[str],
    path: str,
    what: str = "joint",
    named_by: Sequence[NamedBy] = (),
    rest: tuple[Floats, Floats] | None = None,
) -> tuple[Floats, Floats]:
    """Low and high, (A,) each, of a `JointClip`; arguments and errors as of `per_joint`.

    Args:
        value: As declared.
        names: The A joints, in the order of the columns.
        path: Key path of the parameter, for messages.
        what: The kind of the names, for messages.
        named_by: The entries of the reference that name the joints.
        rest: Low and high of joints that a map does not name; None requires that it names all.
    """
    value = _intervals(value)
    if isinstance(value, Mapping):
        rows = _matched(value, names, path=path, what=what, matching=match)
        if rest is None:
            _require_all(rows, names, path, what)
        else:
            low_rest, high_rest = rest
            of_rest = zip(names, low_rest, high_rest, strict=True)
            rows = {name: (low, high) for name, low, high in of_rest} | rows
        value = [rows[name] for name in names]
    elif isinstance(value, list):
        value = in_columns(value, names, named_by, path=path, what=what)
    else:
        value = [value] * len(names)
    low, high = np.asarray(value, np.float64).reshape(len(names), 2).T.copy()
    return low, high


def ranges_in_columns(
    value: Any,
    names: Sequence[str],
    path: str,
    named_by: Sequence[NamedBy] = (),
    what: str = "joint",
) -> tuple[Floats, Floats]:
    """Low and high, (A,) each, of [low, high], of two rows, or of {regex: [low, high]}.

    Args:
        value: As declared.
        names: The A names, in the order of the columns.
        path: Key path of the parameter, for messages.
        named_by: The entries of the reference that name them; see `in_columns`.
        what: The kind of the names, for messages.

    Raises:
        ConfigError: As of `per_joint`.
    """
    count = len(names)
    if isinstance(value, Mapping):
        rows = _matched(value, names, path=path, what=what, matching=match_every)
        _require_all(rows, names, path, what)
        pairs = [rows[name] for name in names]
    elif isinstance(value[0], (list, tuple)):
        pairs = in_columns(list(zip(*value, strict=True)), names, named_by, path, what)
    else:
        pairs = [value] * count
    low, high = np.asarray(pairs, np.float64).reshape(count, 2).T.copy()
    return low, high


def _require_all(rows: Mapping[str, Any], names: Sequence[str], path: str, what: str) -> None:
    """Refuse a map that leaves names out."""
    missing = [name for name in names if name not in rows]
    if missing:
        message = f"says nothing about {what}s: {', '.join(missing)}"
        key = path.rpartition(".")[2]
        hint = f'Name them, or give a default: {key}: {{..., "{_DEFAULT}": VALUE}}'
        raise ConfigError([Problem(path, message, hint)])


def _matched(
    value: Mapping[str, Any],
    names: Sequence[str],
    path: str,
    what: str,
    matching: Callable[..., tuple[tuple[int, ...], list[Problem]]],
) -> dict[str, Any]:
    """Return name -> value of the one regex that matches it in full, else of the default."""
    values: dict[str, Any] = {}
    pattern_of: dict[str, str] = {}
    for pattern, pattern_value in value.items():
        if pattern == _DEFAULT:
            continue
        where = f"{path}.{pattern}"
        hits, problems = matching(pattern, names, f"{what} of this term", where)
        if problems:
            raise ConfigError(problems)
        for i in hits:
            name = names[i]
            if pattern_of.get(name, pattern) != pattern:
                message = f"{what} {name!r} is matched by {pattern_of[name]!r} as well"
                raise ConfigError([Problem(where, message)])
            pattern_of[name] = pattern
            values[name] = pattern_value
    if _DEFAULT in value:
        values = dict.fromkeys(names, value[_DEFAULT]) | values
    return values

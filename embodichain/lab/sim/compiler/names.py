"""Names in configs: regexes against the names in models, and uids."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["check_uid", "exact_pattern", "match"]


def match(
    pattern: str, names: Sequence[str], what: str, path: str
) -> tuple[tuple[int, ...], list[Problem]]:
    """Return the indices of the names that a regex matches in full, or the problem with it.

    Args:
        pattern: The regex.
        names: What there is.
        what: What the names are, for messages: "joint".
        path: Key path of the pattern.
    """
    try:
        found = tuple(i for i, name in enumerate(names) if re.fullmatch(pattern, name))
    except re.error as error:
        return (), [Problem(path, f"malformed regex {pattern!r}: {error}")]
    if found:
        return found, []
    message = f"no {what} matches {pattern!r}; there are: {listing(names, pattern)}"
    return (), [Problem(path, message, did_you_mean(pattern, names).strip())]


def exact_pattern(name: str) -> str:
    """Return a name as a regex that matches it."""
    try:
        plain = re.fullmatch(name, name) is not None
    except re.error:
        plain = False
    return name if plain else re.escape(name)


def check_uid(uid: str, path: str, taken: Mapping[str, str]) -> list[Problem]:
    """Return what is wrong with an entity's name.

    Args:
        uid: The name.
        path: Where it stands.
        taken: Names in use already, each with where.
    """
    if not uid.strip():
        return [Problem(path, "an entity needs a name (uid)")]
    if "/" in uid:
        return [
            Problem(path, f"uid {uid!r} must not contain '/', which separates it from its parts")
        ]
    if uid in taken:
        return [Problem(path, f"uid {uid!r} is taken by {taken[uid]}; every entity needs its own")]
    return []

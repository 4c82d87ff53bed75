"""Pydantic's errors as problems: a key path, what is wrong, what was found, the closest key."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from typing import Any

from pydantic import ValidationError

from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean

__all__ = ["problems_of"]

Loc = tuple[str | int, ...]


def problems_of(
    error: ValidationError,
    path: str = "",
    allowed: Callable[[Loc], Iterable[str]] = lambda loc: (),
    tags: Collection[str] = (),
) -> list[Problem]:
    """Translate every error.

    Args:
        error: What pydantic raised.
        path: Key path of what was checked; empty if it is the root.
        allowed: Returns the keys that a map at a location may have, for messages about unknown
            ones; nothing where that is not known.
        tags: Parts of locations that name members of unions, which are left out.
    """
    return [_problem(details, path, allowed, tags) for details in error.errors(include_url=False)]


def _problem(
    details: Any, path: str, allowed: Callable[[Loc], Iterable[str]], tags: Collection[str]
) -> Problem:
    loc: Loc = tuple(part for part in details["loc"] if part not in tags)
    where = ".".join(map(str, (path, *loc) if path else loc))
    kind = details["type"]
    if kind in ("unexpected_keyword_argument", "extra_forbidden"):
        names = list(allowed(loc[:-1]))
        known = f"; allowed: {', '.join(names)}" if names else ""
        return Problem(where, f"unknown key{known}", did_you_mean(str(loc[-1]), names).strip())
    message = details["msg"].removeprefix("Value error, ")
    message = message[:1].lower() + message[1:]
    return Problem(where, message if kind == "missing" else f"{message}, got {details['input']!r}")

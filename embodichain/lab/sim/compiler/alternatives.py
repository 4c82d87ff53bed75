"""Alternatives of a ``|`` in a regex that match none of some names: usually spelling mistakes."""

from __future__ import annotations

import re
from collections.abc import Sequence

__all__ = ["unmatched_alternatives"]

_OPENING = re.compile(r"\((?:\?(?:P<\w+>|P=|[aiLmsux-]*:|=|!|<=|<!|>|#|\())?")
"""The beginning of a group, with what follows its bracket."""
_LEFT_ALONE = ("(?!", "(?<!", "(?P=", "(?#", "(?(")
"""Groups that are not looked into: negative ones, references, comments, conditions."""


def unmatched_alternatives(pattern: str, names: Sequence[str]) -> list[str]:
    """Return the alternatives of a regex that match none of the names, at any depth.

    Each is tried alone, in place of its group: ``(l|r)_hip`` as ``(l)_hip`` and ``(r)_hip``.

    Args:
        pattern: A regex that is well-formed.
        names: The names; they are matched in full.
    """
    return _unmatched("", pattern, "", names)


def _unmatched(before: str, group: str, after: str, names: Sequence[str]) -> list[str]:
    """The unmatched alternatives of a group, and of groups within it.

    Args:
        before: The regex before the group, its opening bracket included.
        group: The inside of the group.
        after: The regex after it.
        names: The names.
    """
    alternatives, inner = _parts(group)
    unmatched: list[str] = []
    for alternative, groups in zip(alternatives, inner, strict=True):
        if len(alternatives) > 1 and not _matches(before + alternative + after, names):
            unmatched.append(alternative)
            continue
        for start, stop in groups:
            left = before + alternative[:start]
            right = alternative[stop:] + after
            unmatched += _unmatched(left, alternative[start:stop], right, names)
    return unmatched


def _matches(pattern: str, names: Sequence[str]) -> bool:
    try:
        return any(re.fullmatch(pattern, name) for name in names)
    except re.error:  # it refers to a group that is in another alternative
        return True


def _parts(group: str) -> tuple[list[str], list[list[tuple[int, int]]]]:
    """The alternatives of a group, and where the groups directly within each begin and end."""
    bars: list[int] = []
    inner: list[list[tuple[int, int]]] = [[]]
    opened: list[tuple[int, bool]] = []  # where the inside begins, whether it is looked into
    at = 0
    first = 0  # where the present alternative begins
    while at < len(group):
        character = group[at]
        if character == "\\":
            at += 1
        elif character == "[":
            at = _end_of_set(group, at)
        elif character == "(":
            opening = _OPENING.match(group, at)
            text = "(" if opening is None else opening[0]
            opened.append((at + len(text), text not in _LEFT_ALONE))
            at += len(text) - 1
        elif character == ")" and opened:
            start, is_looked_into = opened.pop()
            if is_looked_into and not opened:
                inner[-1].append((start - first, at - first))
        elif character == "|" and not opened:
            bars.append(at)
            inner.append([])
            first = at + 1
        at += 1
    begins = [0, *(bar + 1 for bar in bars)]
    ends = [*bars, len(group)]
    return [group[begin:end] for begin, end in zip(begins, ends, strict=True)], inner


def _end_of_set(pattern: str, at: int) -> int:
    """Where a set of characters, which begins at a ``[``, ends."""
    at += 1
    if pattern[at : at + 1] == "^":
        at += 1
    if pattern[at : at + 1] == "]":  # the first one is a character
        at += 1
    while at < len(pattern) and pattern[at] != "]":
        at += 2 if pattern[at] == "\\" else 1
    return at

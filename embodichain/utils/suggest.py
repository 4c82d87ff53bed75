"""Names in messages: closest matches of a misspelt name, and lists of known names."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher

__all__ = ["closest", "did_you_mean", "listing"]

_MOST_LISTED = 20
"""Maximum number of names that a message lists in full."""
_FEW = 3


def closest(word: str, candidates: Iterable[str], n: int = 1, cutoff: float = 0.6) -> list[str]:
    """Return the candidates most similar to `word`, best first, ignoring case.

    Args:
        word: The misspelt name.
        candidates: Known names. Duplicates count once.
        n: Maximum number to return.
        cutoff: Minimum similarity in [0, 1]; 1 is equality ignoring case.

    Returns:
        At most `n` candidates, spelt as given. Ties keep the order of `candidates`.

    Raises:
        ValueError: If `n` is not positive or `cutoff` is outside [0, 1].
    """
    if n < 1:
        raise ValueError(f"n must be at least 1, got {n}")
    if not 0.0 <= cutoff <= 1.0:
        raise ValueError(f"cutoff must lie in [0, 1], got {cutoff}")
    matcher = SequenceMatcher(autojunk=False)
    matcher.set_seq2(word.casefold())  # the matcher caches its analysis of seq2
    scored: list[tuple[float, str]] = []
    for candidate in dict.fromkeys(candidates):
        matcher.set_seq1(candidate.casefold())
        if matcher.real_quick_ratio() >= cutoff and matcher.quick_ratio() >= cutoff:
            ratio = matcher.ratio()
            if ratio >= cutoff:
                scored.append((ratio, candidate))
    scored.sort(key=lambda item: -item[0])  # stable: ties keep their order
    return [candidate for _, candidate in scored[:n]]


def listing(names: Iterable[str], word: str = "", shown_by: str = "") -> str:
    """Return known names for a message: all of up to 20, else those closest to a word.

    Args:
        names: The known names.
        word: The misspelt name; if empty, the first names are listed.
        shown_by: The command that lists all of them.

    Returns:
        ``a, b``; ``none``; or ``a, b, c, ... (66 in all: `embodichain list terms`)``.
    """
    unique = list(dict.fromkeys(names))
    if len(unique) <= _MOST_LISTED:
        return ", ".join(unique) or "none"
    few = closest(word, unique, _FEW, cutoff=0.0) if word else unique[:_FEW]
    command = f": `{shown_by}`" if shown_by else ""
    return f"{', '.join(few)}, ... ({len(unique)} in all{command})"


def did_you_mean(word: str, candidates: Iterable[str]) -> str:
    """Return ``" Did you mean 'x'?"`` to append to a message, or ``""`` when nothing is close."""
    matches = closest(word, candidates)
    if not matches:
        return ""
    return f" Did you mean '{matches[0]}'?"

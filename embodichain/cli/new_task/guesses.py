"""`Guess`: a value of a new file that was guessed, and from what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

__all__ = ["Guess", "some_of"]


@dataclass(frozen=True)
class Guess:
    """A value that was guessed, or that could not be.

    Attributes:
        key: Its key in the file, or what it is.
        value: Its value as YAML; empty if there is nothing to guess it from.
        why: What it was guessed from, or what to write.
    """

    key: str
    value: str
    why: str

    def __str__(self) -> str:
        """Return it as one line for people."""
        return f"{self.key}: {self.value or '?'} ({self.why})"


def some_of(names: Sequence[str]) -> str:
    """A few names, and how many there are besides."""
    shown = ", ".join(names[:3])
    if len(names) <= 3:
        return shown
    return f"{shown} and {len(names) - 3} more"

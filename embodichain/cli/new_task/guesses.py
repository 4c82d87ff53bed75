"""`Guess`: a value of a new file that was guessed, and from what."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Guess"]


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

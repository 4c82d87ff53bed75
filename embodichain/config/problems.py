"""A configuration mistake together with the place it was written at."""

from __future__ import annotations

from dataclasses import dataclass

from embodichain.utils.errors import Problem

__all__ = ["COMMAND_LINE", "LocatedProblem"]

COMMAND_LINE = "command line"
"""The source of what no file says."""


@dataclass(frozen=True, slots=True)
class LocatedProblem(Problem):
    """A mistake whose place is known.

    Attributes:
        source: ``FILE:LINE``, ``FILE``, or ``command line``; empty where nobody wrote it.
    """

    source: str = ""

    @classmethod
    def of(cls, problem: Problem, source: str) -> LocatedProblem:
        """Give a problem its place; a hint begins a sentence of its own."""
        message = problem.message.rstrip()
        if problem.hint and not message.endswith((".", "?", "!")):
            message += "."
        return cls(problem.path, message, problem.hint.strip(), source)

    def as_dict(self) -> dict[str, str]:
        """Return the four texts by name, for JSON."""
        return {
            "path": self.path,
            "message": self.message,
            "hint": self.hint,
            "source": self.source,
        }

    def __str__(self) -> str:
        """Return ``source: path: message hint``."""
        text = Problem.__str__(self)
        return f"{self.source}: {text}" if self.source else text

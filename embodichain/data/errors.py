"""The error that a missing file raises. How the search is done is not here."""

from __future__ import annotations

from collections.abc import Sequence

from embodichain.utils.errors import EmbodichainError

__all__ = ["DataNotFoundError"]


class DataNotFoundError(EmbodichainError, FileNotFoundError):
    """A robot or object file is in none of the places that were searched.

    Args:
        name: What was asked for.
        searched: Every path that was tried, in order, each with the place it stands for.
        closest: Names that exist and look most alike, best first.
        command: What to type, or do, to have the file.
    """

    def __init__(
        self,
        name: str,
        searched: Sequence[tuple[str, str]],
        closest: Sequence[str] = (),
        command: str = "",
    ) -> None:
        self.name = name
        self.searched = tuple(searched)
        self.closest = tuple(closest)
        self.command = command
        lines = [f"no file or folder for {name!r}. Searched, in this order:"]
        lines += [f"  {path}  ({place})" for place, path in self.searched]
        if self.closest:
            lines.append("Did you mean " + " or ".join(repr(match) for match in self.closest) + "?")
        if command:
            lines.append(command)
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[object, ...]:
        """Rebuild from the four arguments; an exception's default passes the message alone."""
        return type(self), (self.name, self.searched, self.closest, self.command)

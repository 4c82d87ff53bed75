"""Exceptions for users, and the `Problem` records that configuration checks collect.

`ConfigError.__str__` lists its problems, each in one line.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from embodichain.utils.env_text import hidden

__all__ = [
    "ConfigError",
    "DataNotFoundError",
    "DeviceError",
    "EmbodichainError",
    "OutsideError",
    "Problem",
    "RenderError",
    "merged",
]


_LINE = re.compile(r":\d+$")


@dataclass(frozen=True, slots=True)
class Problem:
    """One mistake in a configuration.

    Attributes:
        path: Dotted key path from the root of the checked config, e.g. ``robot.init_qpos``.
        message: One line: what was found and what is allowed.
        hint: The closest match as a sentence (``Did you mean 'x'?``), or empty.
        source: Its origin: ``FILE:LINE``, ``FILE``, ``command line``; or empty.
        expected: ``text`` if a number or a flag was found where text is allowed, ``number``
            or ``flag`` if text was found where only numbers or flags are; else empty.

    Message and hint show ``<env NAME>`` for the value of a variable of the environment.
    """

    path: str
    message: str
    hint: str = ""
    source: str = ""
    expected: str = ""

    def __post_init__(self) -> None:
        """Hide values of variables of the environment."""
        object.__setattr__(self, "message", hidden(self.message))
        object.__setattr__(self, "hint", hidden(self.hint))

    def at(self, source: str, path: str | None = None) -> Problem:
        """Return a copy with this source, and this key path if given."""
        message = self.message.rstrip()
        if self.hint and not message.endswith((".", "?", "!")):
            message += "."  # the hint is a separate sentence
        path = self.path if path is None else path
        return replace(self, path=path, message=message, hint=self.hint.strip(), source=source)

    def below(self, path: str) -> Problem:
        """Return a copy with `path` put before the key path."""
        return replace(self, path=".".join(filter(None, (path, self.path))))

    def moved(self, places: Mapping[str, str]) -> Problem:
        """Return a copy with the first part of its key path replaced, if `places` has it."""
        first, dot, rest = self.path.partition(".")
        return replace(self, path=f"{places.get(first, first)}{dot}{rest}")

    def __str__(self) -> str:
        """Return ``source: path: message hint``."""
        parts = (part for part in (self.source, self.path, self.message) if part)
        return f"{': '.join(parts)} {self.hint}".rstrip()


def merged(problems: Iterable[Problem]) -> list[Problem]:
    """Return problems with one for each place of a file: keys share a line through an anchor.

    Args:
        problems: Located problems; those of the same line with the same text become one, which
            names the other keys.
    """
    firsts: dict[object, Problem] = {}
    further_paths: dict[object, list[str]] = {}
    for number, problem in enumerate(problems):
        has_line = _LINE.search(problem.source) is not None
        # Keys that share an anchor end alike; of two that are missing on a line, each is a mistake.
        name = problem.path.rpartition(".")[2]
        text = (problem.message, problem.hint)
        place: object = (problem.source, name, text) if has_line else number
        if place not in firsts:
            firsts[place] = problem
        elif problem.path not in (firsts[place].path, *further_paths.get(place, ())):
            further_paths.setdefault(place, []).append(problem.path)
    result: list[Problem] = []
    for place, problem in firsts.items():
        if place in further_paths:
            paths = further_paths[place]
            verb = "reads" if len(paths) == 1 else "read"
            others = f"({', '.join(paths)} {verb} the same line)"
            problem = replace(problem, hint=f"{problem.hint} {others}".strip())
        result.append(problem)
    return result


class EmbodichainError(Exception):
    """Base of all errors that this package raises deliberately."""


class ConfigError(EmbodichainError, ValueError):
    """The user's configuration is wrong; lists all mistakes found.

    Args:
        problems: The mistakes, or one line that describes a single one.
    """

    def __init__(self, problems: Iterable[Problem] | str) -> None:
        if isinstance(problems, str):
            problems = (Problem("", problems),)
        self.problems: tuple[Problem, ...] = tuple(problems)
        super().__init__("\n".join(str(p) for p in merged(self.problems)))


class DataNotFoundError(EmbodichainError, FileNotFoundError):
    """A robot or object file was not found in any place.

    Args:
        name: The requested name.
        searched: Every path that was tried, in order, each with its place.
        closest: The most similar existing names, best first.
        command: How to get the file.
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
        super().__init__(hidden("\n".join(lines)))

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle with all four arguments, not only the message as by default."""
        return type(self), (self.name, self.searched, self.closest, self.command)


class OutsideError(ConfigError):
    """A file names another one outside of the folder that its files are in."""


class DeviceError(ConfigError):
    """The requested device is unknown or not available."""


class RenderError(EmbodichainError, RuntimeError):
    """No picture can be rendered on this machine; the message names the missing package."""

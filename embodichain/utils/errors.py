"""The exceptions users see, and the `Problem` records that configuration checks collect.

`ConfigError.__str__` lists its problems; the command line adds files and lines.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["ConfigError", "DeviceError", "EmbodichainError", "Problem", "RenderError"]


@dataclass(frozen=True, slots=True)
class Problem:
    """One mistake in a configuration.

    Attributes:
        path: Dotted key path from the root of what was checked, e.g. ``robot.init_qpos``.
        message: One line: what was found and what is allowed.
        hint: The closest match as a sentence (``Did you mean 'x'?``), or empty.
    """

    path: str
    message: str
    hint: str = ""

    def __str__(self) -> str:
        """Return ``path: message hint``."""
        text = f"{self.path}: {self.message}" if self.path else self.message
        return f"{text} {self.hint}".rstrip()


class EmbodichainError(Exception):
    """Base of all errors this package raises on purpose."""


class ConfigError(EmbodichainError, ValueError):
    """The user's configuration is wrong; lists every mistake found, not only the first.

    Args:
        problems: The mistakes, or one line that describes a single one.
    """

    def __init__(self, problems: Iterable[Problem] | str) -> None:
        if isinstance(problems, str):
            problems = (Problem("", problems),)
        self.problems: tuple[Problem, ...] = tuple(problems)
        super().__init__("\n".join(str(p) for p in self.problems))


class DeviceError(ConfigError):
    """The requested device is unknown or not available."""


class RenderError(EmbodichainError, RuntimeError):
    """No picture can be rendered on this machine; the message names the missing package."""

"""A command in a terminal of its own: a pseudo terminal, whose keys a test presses."""

from __future__ import annotations

import os
import pty
import select
import time
from pathlib import Path
from typing import Self

from tests.helpers.commands import Commands

__all__ = ["Terminal"]

_ROOT = Path(__file__).parents[2]


class Terminal:
    """`embodichain ARGUMENTS` in a terminal.

    Args:
        commands: Starts it.
        arguments: As they are typed.
        cwd: The working directory.

    Attributes:
        text: What was printed so far.
    """

    def __init__(self, commands: Commands, *arguments: str, cwd: Path) -> None:
        self.text = ""
        environment = {**os.environ, "PYTHONPATH": str(_ROOT), "TERM": "dumb", "COLUMNS": "200"}
        self._terminal, other_end = pty.openpty()
        self._process = commands.start_in_terminal(
            *arguments, terminal=other_end, cwd=cwd, env=environment
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._terminal)

    def until(self, text: str, seconds: float = 60.0) -> None:
        """Read until a text was printed; fail if it is not in time."""
        end = time.monotonic() + seconds
        while text not in self.text:
            assert time.monotonic() < end, f"{text!r} was not printed:\n{self.text}"
            assert self._read(0.1) or text in self.text, f"ended without {text!r}:\n{self.text}"

    def stands(self, seconds: float) -> bool:
        """Whether the command prints nothing and does not end for some time."""
        before = len(self.text)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if not self._read(0.1) or len(self.text) > before:
                return False
        return True

    def press(self, key: str) -> None:
        """Press a key."""
        os.write(self._terminal, key.encode())

    def wait(self, seconds: float = 60.0) -> int:
        """Read until the command ends; return its exit code."""
        end = time.monotonic() + seconds
        while self._read(0.1):
            assert time.monotonic() < end, f"it does not end:\n{self.text}"
        return self._process.wait()

    def _read(self, seconds: float) -> bool:
        """Read what comes in some time; return whether the command still runs."""
        readable, _, _ = select.select([self._terminal], [], [], seconds)
        if not readable:
            return True
        try:
            data = os.read(self._terminal, 65536)
        except OSError:  # Linux: all of the other end's owners are gone
            return False
        self.text += data.decode(errors="replace").replace("\r\n", "\n")
        return bool(data)

"""`LogWriteError`: a log could not be written; `Loss`: what is known of that, and who was told.

What the process that writes says of it is read here.
"""

from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import Any

__all__ = ["LogWriteError", "Loss"]


class LogWriteError(OSError):
    """The log could not be written; the text says why, and where it ends."""


class Loss:
    """What went wrong with a log: nothing, as long as `cause` is None.

    Attributes:
        cause: What went wrong first.
        told: Whether somebody was told.
    """

    def __init__(self, path: Path) -> None:
        self.cause: BaseException | None = None
        self.told = False
        self._path = path
        self._where = ""  # the log ends

    def found(self, cause: BaseException) -> None:
        """Something went wrong on this side."""
        self.cause = self.cause or cause

    def reported(self, report: bytes) -> None:
        """The other process says what went wrong, and where the log ends."""
        said: dict[str, Any] = json.loads(report)
        if said["errno"] is not None:
            self.cause = OSError(said["errno"], said["why"])
        else:
            self.cause = RuntimeError(said["traceback"])
        self._where = said["where"]

    def unexplained(self, end: str) -> None:
        """The other process has ended without a word."""
        why = f"the process that writes it has ended ({end})"
        self.found(ChildProcessError(errno.EPIPE, why))

    def forked(self) -> None:
        """This process was forked: the log goes on in the other, and nobody here has to be told."""
        self.found(ChildProcessError(errno.EPERM, "the process this one was forked from writes it"))
        self.told = True

    def check(self) -> None:
        """Raise if something went wrong.

        Raises:
            LogWriteError: If so.
        """
        if self.cause is not None:
            raise self.error()

    def error(self) -> LogWriteError:
        """The error to raise; whoever asks for it is told."""
        self.told = True
        cause, why = self.cause, str(self.cause)
        if isinstance(cause, OSError) and cause.strerror:
            why = cause.strerror + (f": {cause.filename}" if cause.filename else "")
        end = f"; {self._where}" if self._where else ""
        error = LogWriteError(f"the log {self._path} could not be written: {why}{end}")
        error.__cause__ = cause
        return error

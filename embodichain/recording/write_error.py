"""`LogWriteError`: a log could not be written, and what the process that writes said of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

__all__ = ["LogWriteError", "cause_of", "write_error"]


class LogWriteError(OSError):
    """The log could not be written; the text says why, and where it ends."""


def cause_of(report: bytes) -> tuple[BaseException, str]:
    """What went wrong, and where the log ends, as the other process reports it."""
    found: dict[str, Any] = json.loads(report)
    if found["errno"] is not None:
        return OSError(found["errno"], found["why"]), found["where"]
    return RuntimeError(found["traceback"]), found["where"]


def write_error(path: Path, cause: BaseException | None, where: str) -> LogWriteError:
    """The error to raise.

    Args:
        path: The log.
        cause: What went wrong.
        where: Where the log ends, in words; empty if that is not known.
    """
    why = str(cause)
    if isinstance(cause, OSError) and cause.strerror:
        why = cause.strerror + (f": {cause.filename}" if cause.filename else "")
    end = f"; {where}" if where else ""
    error = LogWriteError(f"the log {path} could not be written: {why}{end}")
    error.__cause__ = cause
    return error

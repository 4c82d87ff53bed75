"""Notes: warnings that are the same for every job of a command, which a screen shows once."""

from __future__ import annotations

import hashlib
import logging
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["forget_shown", "is_new", "shared_by_jobs", "warn_once"]

_KEY = "note_key"
_FOLDER = "_EMBODICHAIN_SHOWN_NOTES"
"""Variable of the environment: a folder with a file for each note that a job has shown."""
_shown: set[str] = set()
"""Keys of the notes that this process has shown for the present command."""


def warn_once(log: logging.Logger, text: str, key: str = "") -> None:
    """Log a warning that a command shows once, however often it comes; log files have each.

    Args:
        log: The logger.
        text: The warning.
        key: What is the same in warnings of which one is shown; empty is the text.
    """
    log.warning("%s", text, extra={_KEY: key or text})


def is_new(record: logging.LogRecord) -> bool:
    """Whether a record is to be shown: it is not a note, or a note that comes the first time."""
    key: str | None = getattr(record, _KEY, None)
    if key is None:
        return True
    if key in _shown:
        return False
    _shown.add(key)
    return _is_first_of_jobs(key)


def forget_shown() -> None:
    """Let notes be shown again: a command begins."""
    _shown.clear()


@contextmanager
def shared_by_jobs() -> Iterator[None]:
    """Show each note once over all processes that are started inside the context, on this machine.

    Workers inherit the environment.
    """
    if _FOLDER in os.environ:
        yield
        return
    with tempfile.TemporaryDirectory(prefix="embodichain-notes-") as folder:
        os.environ[_FOLDER] = folder
        try:
            yield
        finally:
            del os.environ[_FOLDER]


def _is_first_of_jobs(key: str) -> bool:
    """Whether no other process of the same command has shown a note; marks it as shown."""
    folder = os.environ.get(_FOLDER)
    if folder is None:
        return True
    name = hashlib.sha256(key.encode()).hexdigest()
    try:
        Path(folder, name).touch(exist_ok=False)
    except FileExistsError:
        return False
    except OSError:  # another machine, which has no such folder
        return True
    return True

"""The log file of a run, warnings on stderr, and labels for the lines of jobs that run at once."""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO

__all__ = ["label_lines", "log_to", "warnings_on_stderr"]

_FORMAT = "%(asctime)s %(levelname)-7s %(name)s: %(message)s"


@contextmanager
def log_to(path: Path) -> Iterator[logging.Logger]:
    """Write Python's logging and warnings to a file; show our warnings on stderr.

    An exception that leaves the context is written with its traceback, and goes on.

    Args:
        path: A new file, or one to append to.
    """
    root = logging.getLogger()
    level = root.level
    file = _File(path, encoding="utf-8")
    file.setFormatter(logging.Formatter(_FORMAT))
    show = warnings.showwarning
    logging.captureWarnings(True)
    root.addHandler(file)
    root.setLevel(logging.INFO)
    log = logging.getLogger("embodichain.run")
    try:
        with warnings_on_stderr():
            yield log
    except BaseException as error:
        # To the file only: the report on the terminal is one line and comes later.
        record = log.makeRecord(
            log.name, logging.ERROR, __file__, 0, "ended by %s", (type(error).__name__,), None
        )
        record.exc_info = (type(error), error, error.__traceback__)
        file.emit(record)
        raise
    finally:
        logging.captureWarnings(False)
        warnings.showwarning = show
        root.setLevel(level)
        root.removeHandler(file)
        file.close()


@contextmanager
def warnings_on_stderr() -> Iterator[None]:
    """Show warnings of our own loggers on stderr, a line each."""
    screen = logging.StreamHandler()
    screen.setLevel(logging.WARNING)
    screen.addFilter(_is_ours)
    screen.setFormatter(_OneLine())
    logging.getLogger().addHandler(screen)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(screen)


class _File(logging.FileHandler):
    """A log file that cannot be written says so once; the run does not end for it."""

    _failed = False

    def handleError(self, record: logging.LogRecord) -> None:
        """Say what happened, the first time."""
        if not self._failed:
            self._failed = True
            sys.stderr.write(
                f"warning: {self.baseFilename} cannot be written: {sys.exc_info()[1]}\n"
            )

    def close(self) -> None:
        """Close the file; what it could not take is lost."""
        with suppress(OSError):
            super().close()


def _is_ours(record: logging.LogRecord) -> bool:
    """Whether people should see it: from us or from the user's own code, not from packages."""
    if record.name == "py.warnings":
        return "site-packages" not in record.getMessage().split(": ", 1)[0]
    return record.name.startswith("embodichain")


class _OneLine(logging.Formatter):
    """``warning: MESSAGE``, without the source line that Python adds to its warnings."""

    def format(self, record: logging.LogRecord) -> str:
        """Return one line, two for an exception."""
        text = record.getMessage()
        if record.name == "py.warnings":  # FILE:LINE: CATEGORY: MESSAGE, then the source line
            text = text.split("Warning: ", 1)[-1].splitlines()[0]
        return f"{record.levelname.lower()}: {text}"


@contextmanager
def label_lines(label: str, *, json: bool) -> Iterator[None]:
    """Begin each line that is printed within with a label: ``[3 seed=1]``.

    Args:
        label: The label and a blank.
        json: Whether stdout is for programs: its lines then stay as they are.
    """
    before = sys.stdout, sys.stderr
    sys.stderr = _Labelled(sys.stderr, label)
    if not json:
        sys.stdout = _Labelled(sys.stdout, label)
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        sys.stdout, sys.stderr = before


class _Labelled:
    """A text stream whose lines begin with a label; each is written as a whole.

    It is no terminal, whatever is below: bars of several jobs would overwrite each other.
    """

    def __init__(self, stream: TextIO, label: str) -> None:
        self._stream, self._label, self._rest = stream, label, ""

    def write(self, text: str) -> int:
        """Write the lines that are complete."""
        *lines, self._rest = (self._rest + text).split("\n")
        if lines:
            self._stream.write(
                "".join(f"{self._label}{line}\n" if line else "\n" for line in lines)
            )
            self._stream.flush()
        return len(text)

    def flush(self) -> None:
        """Write what is left, as a line."""
        if self._rest:
            self.write("\n")

    def isatty(self) -> bool:
        """Return False."""
        return False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

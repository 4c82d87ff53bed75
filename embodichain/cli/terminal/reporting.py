"""Output of a job while it runs: progress and warnings on stderr, and a log file.

stdout is for results only.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Self
from urllib.parse import urlsplit

from embodichain.cli.terminal.output import console
from embodichain.utils.env_text import hidden
from embodichain.utils.notes import is_new

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.live import Live

__all__ = [
    "ProgressDisplay",
    "episodes_of",
    "log_to",
    "progress_row",
    "warn_if_public",
    "warnings_on_stderr",
]

_log = logging.getLogger(__name__)
_LINE_PERIOD = 10.0
_FORMAT = "%(asctime)s %(levelname)-7s %(name)s: %(message)s"


class ProgressDisplay:
    """Shows progress: a live bar on a terminal, a line every ten seconds elsewhere.

    Args:
        label: Name of the job.
        total: Total number of units, None if unknown.
        unit: Name of the unit.
        quiet: Show nothing; so it is in a job among several at once.
        period: Seconds between two drawings on a terminal.
    """

    def __init__(
        self, label: str, total: int | None, unit: str, *, quiet: bool = False, period: float = 0.2
    ) -> None:
        self.label = label
        self.total = total
        self.unit = unit
        # Of jobs that run at once, the sweep shows the progress in one table.
        self._quiet = quiet or getattr(sys.stderr, "is_of_sweep", False)
        self._live: Live | None = None
        self._period = _LINE_PERIOD
        self._due = time.perf_counter() + _LINE_PERIOD
        if not quiet and sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
            from rich.live import Live

            # Drawn only when `show` is called: no thread competes with the simulation.
            self._live = Live(console=console(stderr=True), auto_refresh=False)
            self._period = period
            self._due = 0.0  # at once

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._live is not None:
            self._live.stop()

    @property
    def is_live(self) -> bool:
        """Whether it is drawn on a terminal."""
        return self._live is not None

    @property
    def due(self) -> bool:
        """Whether it is time to `show` again; cheap enough for every step."""
        return not self._quiet and time.perf_counter() >= self._due

    def show(
        self,
        done: int,
        facts: dict[str, str],
        picture: Callable[[], RenderableType] | None = None,
    ) -> None:
        """Show that `done` of `total` units are done, with a few named values.

        Args:
            done: Number of units.
            facts: Name -> value, shown beside the bar or in the line.
            picture: Returns what to draw on a terminal instead of the bar.
        """
        if self._quiet:
            return
        text = "  ".join(f"{name} {value}" for name, value in facts.items())
        count = f"{done:,} {self.unit}"
        if self.total is not None:
            count = f"{done:,}/{self.total:,} {self.unit}"
        if self._live is None:
            sys.stderr.write(f"{self.label}: {count}  {text}".rstrip() + "\n")
            sys.stderr.flush()
        elif picture is not None:
            self._live.update(picture(), refresh=True)
        else:
            row = progress_row(self.label, done, self.total, count, text)
            self._live.update(row, refresh=True)
        self._due = time.perf_counter() + self._period


def episodes_of(num_envs: int, what: str = "episodes") -> str:
    """Return the unit of a progress line: episodes, and of how many environments."""
    return f"{what} of {num_envs:,} environment{'s' * (num_envs != 1)}"


def progress_row(label: str, done: int, total: int | None, *texts: str) -> RenderableType:
    """Return a bar between a label and texts, which fills the remaining width."""
    from rich.progress_bar import ProgressBar
    from rich.table import Table

    row = Table.grid(padding=(0, 1), expand=True)
    row.add_column(no_wrap=True)
    row.add_column(ratio=1)
    for _ in texts:
        row.add_column(no_wrap=True)
    row.add_row(label, ProgressBar(total or None, min(done, total or done)), *texts)
    return row


@contextmanager
def log_to(path: Path) -> Iterator[logging.Logger]:
    """Write Python's logging and warnings to a file; show this package's warnings on stderr.

    An exception that leaves the context is logged with its traceback, and raised again.

    Args:
        path: A new file, or one to append to.
    """
    root = logging.getLogger()
    level = root.level
    file = _File(path, encoding="utf-8")
    file.setFormatter(_WithoutEnv(_FORMAT))
    show = warnings.showwarning
    logging.captureWarnings(True)
    root.addHandler(file)
    root.setLevel(logging.INFO)
    try:
        with warnings_on_stderr(), _threads_report():
            yield logging.getLogger("embodichain.run")
    except BaseException as error:
        # Without the handler for the terminal: that gets a report of one line, later.
        logging.getLogger("run").error("ended by %s", type(error).__name__, exc_info=error)
        raise
    finally:
        logging.captureWarnings(False)
        warnings.showwarning = show
        root.setLevel(level)
        root.removeHandler(file)
        file.close()


@contextmanager
def _threads_report() -> Iterator[None]:
    """Report an exception that ends a thread in one line, its traceback in the log file.

    Libraries write files in threads of their own (TensorBoard's), and raise what failed there
    again where they are called next.
    """
    before = threading.excepthook

    def report(ended: threading.ExceptHookArgs) -> None:
        if issubclass(ended.exc_type, SystemExit) or ended.exc_value is None:
            return
        name = "a thread" if ended.thread is None else f"thread {ended.thread.name}"
        _log.warning("%s ended: %s: %s", name, ended.exc_type.__name__, ended.exc_value)
        logging.getLogger("run").error("ended in %s", name, exc_info=ended.exc_value)

    threading.excepthook = report
    try:
        yield
    finally:
        threading.excepthook = before


@contextmanager
def warnings_on_stderr() -> Iterator[None]:
    """Show warnings of this package's loggers on stderr, a line each; notes once a command."""
    screen = logging.StreamHandler()
    screen.setLevel(logging.WARNING)
    screen.addFilter(_is_ours)
    screen.addFilter(is_new)  # of what is ours: notes of others are not counted
    screen.setFormatter(_OneLine())
    logging.getLogger().addHandler(screen)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(screen)


def warn_if_public(host: str, url: str, *, controls: bool) -> None:
    """Warn on stderr if other machines can reach a viewer.

    Args:
        host: The address it listens on.
        url: Its URL, with the port, and the token if it asks for one.
        controls: Whether a viewer can control the run.
    """
    from embodichain.utils.system.addresses import is_loopback

    if not is_loopback(host):
        abilities = "watch the run and use its controls" if controls else "watch the run"
        sys.stderr.write(
            f"warning: other machines reach the viewer at {host}:{urlsplit(url).port}; who has "
            f"its token can {abilities}. Nothing is encrypted; HTTPS needs a proxy\n"
        )


class _File(logging.FileHandler):
    """A log file; a failure to write is reported once, and the run continues."""

    _failed = False

    def handleError(self, record: logging.LogRecord) -> None:
        """Report the first failure."""
        self._report(sys.exc_info()[1])

    def close(self) -> None:
        """Close the file; data that could not be written are lost."""
        try:
            super().close()
        except OSError as error:
            self._report(error)

    def _report(self, error: BaseException | None) -> None:
        if not self._failed:
            self._failed = True
            sys.stderr.write(f"warning: {self.baseFilename} cannot be written: {error}\n")


def _is_ours(record: logging.LogRecord) -> bool:
    """Whether a record comes from this package or the user's code, not an installed package."""
    if record.name == "py.warnings":
        return "site-packages" not in record.getMessage().split(": ", 1)[0]
    return record.name.startswith("embodichain")


class _WithoutEnv(logging.Formatter):
    """Hides values of variables of the environment."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the lines of a record."""
        return hidden(super().format(record))


class _OneLine(logging.Formatter):
    """``warning: MESSAGE``, without the source line that Python adds to its warnings."""

    def format(self, record: logging.LogRecord) -> str:
        """Return one line."""
        text = record.getMessage()
        if record.name == "py.warnings":  # FILE:LINE: CATEGORY: MESSAGE, then the source line
            text = text.split("Warning: ", 1)[-1].splitlines()[0]
        return hidden(f"{record.levelname.lower()}: {text}")

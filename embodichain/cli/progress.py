"""What people see while something runs: a live bar on a terminal, a line now and then elsewhere.

Written to stderr, so that stdout holds results only.
"""

from __future__ import annotations

import os
import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING

from embodichain.cli.output import console

if TYPE_CHECKING:
    from rich.progress import Progress

__all__ = ["ProgressDisplay"]

_LIVE_PERIOD = 0.2
_LINE_PERIOD = 10.0


class ProgressDisplay:
    """Shows how far something is; a context manager.

    Args:
        label: What runs.
        total: How much there is to do, None when nobody knows.
        unit: Of what.
        quiet: Show nothing.
    """

    def __init__(self, label: str, total: int | None, unit: str, *, quiet: bool = False) -> None:
        self.label, self.total, self.unit = label, total, unit
        self._bar: Progress | None = None
        self._quiet = quiet
        self._live = not quiet and sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
        self._due = time.perf_counter() + (0.0 if self._live else _LINE_PERIOD)

    def __enter__(self) -> ProgressDisplay:
        if self._live:
            self._bar = _bar()
            self._task = self._bar.add_task(self.label, total=self.total, facts="", count="")
            self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.refresh()
            self._bar.stop()

    @property
    def due(self) -> bool:
        """Whether it is time to `show` again; cheap enough to ask in every step."""
        return not self._quiet and time.perf_counter() >= self._due

    def show(self, done: int, facts: dict[str, str]) -> None:
        """Show that `done` of `total` are done, and a few facts by name."""
        if self._quiet:
            return
        text = "  ".join(f"{name} {value}" for name, value in facts.items())
        of = f"{done:,}/{self.total:,}" if self.total is not None else f"{done:,}"
        count = f"{of} {self.unit}"
        if self._bar is not None:
            self._bar.update(self._task, completed=done, facts=text, count=count)
            self._bar.refresh()
            self._due = time.perf_counter() + _LIVE_PERIOD
            return
        sys.stderr.write(f"{self.label}: {count}  {text}".rstrip() + "\n")
        sys.stderr.flush()
        self._due = time.perf_counter() + _LINE_PERIOD


def _bar() -> Progress:
    """A bar that is drawn only when asked to: no thread competes with the simulation."""
    from rich.progress import BarColumn, Progress, TextColumn
    from rich.table import Column

    whole = Column(no_wrap=True)
    return Progress(
        TextColumn("{task.description}", table_column=whole),
        BarColumn(bar_width=None),  # takes what the facts leave
        TextColumn("{task.fields[count]}", table_column=whole),
        TextColumn("{task.fields[facts]}", table_column=whole),
        console=console(stderr=True),
        auto_refresh=False,
        expand=True,
    )

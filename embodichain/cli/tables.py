"""Tables on the terminal. Knows nothing of what is in them."""

from __future__ import annotations

import os
import shutil
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Column, Table

__all__ = ["console", "number", "print_facts", "print_table", "width"]

_TEXT = 20
"""Columns that folded text gets at least."""
_PIPE_WIDTH = 100
"""Columns of a line where there is no terminal: in files of logs, which people read too."""


def width() -> int:
    """How many columns a line on stdout may have: the terminal's, or `COLUMNS`, where there is any.

    Elsewhere lines have 100, and more where a word needs it: nothing that is looked for is cut.
    """
    if sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdigit():
        return shutil.get_terminal_size().columns
    return _PIPE_WIDTH


def console(*, stderr: bool = False) -> Console:
    """A rich console on stdout or stderr."""
    from rich.console import Console

    stream = sys.stderr if stderr else sys.stdout
    columns = None if stream.isatty() else width()
    return Console(file=stream, width=columns, highlight=False, markup=False)


def print_table(title: str, rows: Sequence[Mapping[str, Any]], detail: str | None = None) -> None:
    """Print one line a row under the keys of the first; says so when there is none.

    Args:
        title: Stands above.
        rows: What each row holds; a key that is absent is a dash.
        detail: A key whose long texts go below their rows where the table is wider than the screen,
            and then those of columns from the right, until it fits.
    """
    if not rows:
        sys.stdout.write(f"{title}: none\n\n")
        return
    names = list(rows[0])
    whole = _table(title, names, rows)
    if detail not in names or _fits(whole):
        _print(whole)
        return
    names.remove(detail)
    below: list[str] = []
    while len(names) > 1 and not _fits(_table(title, names, rows)):
        below.insert(0, names.pop())
    lines = _lines(_table(title, names, rows))
    first = 1 + next(i for i, line in enumerate(lines) if line.strip().startswith("─"))
    body = [line for line in lines[first:] if line.strip()]
    if len(body) != len(rows):  # a row needs several lines: nothing can go between
        _print(whole)
        return
    sys.stdout.write("\n".join(lines[:first]) + "\n")
    for line, row in zip(body, rows, strict=True):
        extra = [f"{name}: {number(row[name])}" for name in below if row.get(name) is not None]
        details = (_indented(text) for text in (*extra, str(row.get(detail, ""))))
        sys.stdout.write(f"{line}\n{''.join(details)}")
    sys.stdout.write("\n")


def _table(title: str, names: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for name in names:
        cells = [number(row.get(name)) for row in rows]
        words = not sys.stdout.isatty() and not any(" " in cell for cell in cells)
        table.add_column(name, overflow="fold", no_wrap=words)
    for row in rows:
        table.add_row(*(number(row.get(name)) for name in names))
    return table


def _fits(table: Table) -> bool:
    screen = console()
    return screen.measure(table, options=screen.options.update(width=10_000)).maximum <= width()


def _indented(text: str) -> str:
    """Text on lines of its own below a row; nothing for nothing."""
    fold = textwrap.TextWrapper(
        width(), initial_indent="     ", subsequent_indent="       ", break_on_hyphens=False
    )
    return "".join(f"{line}\n" for line in fold.wrap(text))


def print_facts(title: str, facts: Iterable[tuple[str, Any]]) -> None:
    """Print names and values side by side."""
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, show_header=False)
    rows = [(name, number(value)) for name, value in facts]
    words = [len(word) for _, value in rows for word in value.split()]
    table.add_column()
    table.add_column(
        overflow="fold", min_width=max(words, default=None) if not sys.stdout.isatty() else None
    )
    for row in rows:
        table.add_row(*row)
    _print(table)


def _print(table: Table) -> None:
    sys.stdout.write("\n".join(_lines(table)) + "\n")


def _lines(table: Table) -> list[str]:
    """A table's lines without the blanks that fill them up to the right edge."""
    screen = console()
    if not sys.stdout.isatty():
        screen.width = max(screen.width, sum(_least(column) + 3 for column in table.columns))
    with screen.capture() as capture:
        screen.print(table)
    return [line.rstrip() for line in capture.get().splitlines()]


def _least(column: Column) -> int:
    """Columns of the screen that a column of a table needs where nothing looked for may be cut."""
    if column.no_wrap:
        return max((len(str(cell)) for cell in [column.header, *column.cells]), default=0)
    return column.min_width or _TEXT


def number(value: Any) -> str:
    """A value as a cell: floats with four digits or more, sequences with commas, None as a dash."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:,.0f}" if 1e3 <= abs(value) < 1e12 else f"{value:.4g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(number(v) for v in value)
    return str(value)

"""What verbs print: tables, names and values, JSON."""

from __future__ import annotations

import json
import os
import shutil
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Column, Table

__all__ = [
    "console",
    "number",
    "print_facts",
    "print_json",
    "print_table",
    "say_warnings",
    "to_json",
    "width",
    "wrapped",
]

_TEXT = 16
"""Columns that folded text gets at least."""
_SHORT = 24
"""Columns of cells that are not folded where there is room: names, numbers with intervals."""
_PIPE_WIDTH = 100
"""Columns of a line where there is no terminal: in log files, which people read too."""


def print_json(value: Mapping[str, Any]) -> None:
    """Write one JSON object to stdout, on one line: the jobs of a sweep give JSON lines."""
    sys.stdout.write(to_json(value) + "\n")
    sys.stdout.flush()


def to_json(value: Mapping[str, Any], indent: int | None = None) -> str:
    """Return JSON; nan and inf become null, arrays lists, anything else that it lacks text."""
    return json.dumps(_finite(value), indent=indent, default=_plain, allow_nan=False)


def _plain(value: Any) -> Any:
    return _finite(value.tolist()) if hasattr(value, "tolist") else str(value)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    if isinstance(value, float) and (value != value or value in (float("inf"), float("-inf"))):
        return None
    return value


def say_warnings(path: object, warnings: Iterable[object]) -> None:
    """Write warnings about a file to stderr."""
    for warning in warnings:
        sys.stderr.write(f"warning: {path}: {warning}\n")


def width() -> int:
    """Return the columns of a line on stdout: the terminal's, or `COLUMNS`, else 100."""
    return shutil.get_terminal_size().columns if _is_bounded() else _PIPE_WIDTH


def _is_bounded() -> bool:
    """Whether somebody says how wide lines may be; elsewhere a table may be wider than 100."""
    return sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdigit()


def wrapped(text: str, first: str = "", rest: str = "  ") -> str:
    """Fold text to the width of a line; words stay whole.

    Args:
        text: Lines that fit stay as they are.
        first: Indents a line.
        rest: Indents what is folded.
    """
    fold = textwrap.TextWrapper(
        width(),
        initial_indent=first,
        subsequent_indent=rest,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return "\n".join("\n".join(fold.wrap(line)) for line in text.splitlines())


def console(*, stderr: bool = False) -> Console:
    """Return a rich console on stdout or stderr."""
    from rich.console import Console

    stream = sys.stderr if stderr else sys.stdout
    columns = None if stream.isatty() else width()
    return Console(file=stream, width=columns, highlight=False, markup=False)


def print_table(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print one line a row under the keys of the first; says so when there is none.

    Args:
        title: Stands above.
        rows: A key that is absent is a dash.
    """
    if not rows:
        sys.stdout.write(f"{title}: none\n\n")
        return
    table = _table(title)
    columns = {name: [name, *(number(row.get(name)) for row in rows)] for name in rows[0]}
    words = {
        name: max(map(len, cells))
        for name, cells in columns.items()
        if all(len(cell) <= _SHORT or " " not in cell for cell in cells)
    }
    folded = len(columns) - len(words)
    least = sum(words.values()) + 3 * len(columns) + _TEXT * bool(folded)
    whole = not _is_bounded() or least <= width()
    for name in columns:
        table.add_column(name, overflow="fold", no_wrap=whole and name in words)
    for row in rows:
        table.add_row(*(number(row.get(name)) for name in rows[0]))
    _print(table)


def print_facts(title: str, facts: Iterable[tuple[str, Any]]) -> None:
    """Print names and values side by side."""
    table = _table(title, show_header=False)
    rows = [(name, number(value)) for name, value in facts]
    words = [len(word) for _, value in rows for word in value.split()]
    table.add_column()
    table.add_column(overflow="fold", min_width=0 if _is_bounded() else max(words, default=0))
    for row in rows:
        table.add_row(*row)
    _print(table)


def _table(title: str, **how: Any) -> Table:
    from rich import box
    from rich.table import Table

    return Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, **how)


def _print(table: Table) -> None:
    """Write a table without trailing blanks; outside of a terminal as wide as it has to be."""
    screen = console()
    if not _is_bounded():
        screen.width = max(screen.width, sum(_least(column) + 3 for column in table.columns))
    with screen.capture() as capture:
        screen.print(table)
    lines = (line.rstrip() for line in capture.get().splitlines())
    sys.stdout.write("\n".join(lines) + "\n\n")


def _least(column: Column) -> int:
    """Columns of the screen that a column of a table needs outside of a terminal."""
    if column.no_wrap:
        return max((len(str(cell)) for cell in [column.header, *column.cells]), default=0)
    return column.min_width or _TEXT


def number(value: Any) -> str:
    """Return a cell: floats with four digits or more, sequences with commas, None as a dash."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:,.0f}" if 1e3 <= abs(value) < 1e12 else f"{value:.4g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(number(v) for v in value)
    return str(value)

"""Output of verbs on stdout: tables, names and values, JSON."""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

__all__ = [
    "console",
    "number",
    "print_facts",
    "print_json",
    "print_table",
    "say_warnings",
    "to_json",
    "wrapped",
]

_FOLDED_WIDTH = 16
"""Smallest width of a column of folded text."""
_LONGEST_UNFOLDED = 24
"""Cells up to this width are not folded if there is room: names, numbers with intervals."""
_PIPE_WIDTH = 100
"""Width of a line without a terminal."""
_COLUMN_GAP = 3
"""Blanks that rich puts between two columns of this style of table."""


def print_json(value: Mapping[str, Any]) -> None:
    """Write one JSON object to stdout, on one line, so that jobs of a sweep give JSON lines."""
    sys.stdout.write(to_json(value) + "\n")
    sys.stdout.flush()


def to_json(value: Mapping[str, Any], indent: int | None = None) -> str:
    """Return JSON; nan and inf become null, arrays become lists, other objects strings."""
    return json.dumps(_finite(value), indent=indent, default=_plain, allow_nan=False)


def _plain(value: Any) -> Any:
    """What JSON has for an object that it does not know: a list for an array, else text."""
    if hasattr(value, "tolist"):
        return _finite(value.tolist())
    return str(value)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def say_warnings(path: object, warnings: Iterable[object]) -> None:
    """Write warnings about a file to stderr."""
    for warning in warnings:
        sys.stderr.write(f"warning: {path}: {warning}\n")


def _is_bounded() -> bool:
    """Whether the width of lines is known, from a terminal or from `COLUMNS`."""
    return sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdigit()


def _width() -> int:
    """Width of a line on stdout; without a terminal a table may be wider."""
    if _is_bounded():
        return shutil.get_terminal_size().columns
    return _PIPE_WIDTH


def wrapped(text: str, first: str = "", rest: str = "  ") -> str:
    """Fold text to the width of a line, between words.

    Args:
        text: The text; lines that fit are not changed.
        first: Indentation of a line.
        rest: Indentation of the continuation of a folded line.
    """
    fold = partial(
        textwrap.fill,
        width=_width(),
        initial_indent=first,
        subsequent_indent=rest,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return "\n".join(map(fold, text.splitlines()))


def console(*, stderr: bool = False) -> Console:
    """Return a rich console on stdout or stderr."""
    from rich.console import Console

    stream = sys.stderr if stderr else sys.stdout
    columns = None if stream.isatty() else _width()
    return Console(file=stream, width=columns, highlight=False, markup=False)


def print_table(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print one line per row, with the keys of the first row as header.

    Args:
        title: Printed above the table.
        rows: Key -> cell; a missing key is printed as a dash.
    """
    if not rows:
        sys.stdout.write(f"{title}: none\n\n")
        return
    names = list(rows[0])
    _print(title, names, [[number(row.get(name)) for name in names] for row in rows])


def print_facts(title: str, facts: Iterable[tuple[str, Any]]) -> None:
    """Print names and values in two columns; without a terminal no word is cut."""
    rows = [[name, number(value)] for name, value in facts]
    words = " ".join(value for _, value in rows).split()
    longest_word = max(map(len, words), default=0)
    _print(title, ["", ""], rows, folded_width=longest_word)


def _print(
    title: str,
    names: Sequence[str],
    rows: Sequence[Sequence[str]],
    folded_width: int = _FOLDED_WIDTH,
) -> None:
    """Print a table without trailing blanks; without a terminal as wide as necessary.

    Columns whose cells are short or one word are not folded if the width allows it; others are at
    least `folded_width` wide.
    """
    from rich import box
    from rich.table import Table

    table = Table(
        title=title,
        show_header=any(names),
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        title_justify="left",
    )
    table_width = 0
    for index, name in enumerate(names):
        cells = [name, *(row[index] for row in rows)]
        is_unfolded = all(_stays_on_one_line(cell) for cell in cells)
        width = folded_width
        if is_unfolded:
            width = max(map(len, cells))
        table.add_column(name, overflow="fold", no_wrap=is_unfolded, min_width=width)
        table_width += width + _COLUMN_GAP
    for row in rows:
        table.add_row(*row)
    screen = console()
    if not _is_bounded():
        screen.width = max(screen.width, table_width)
    elif table_width > screen.width:
        for column in table.columns:
            column.no_wrap = False
            column.min_width = None
    with screen.capture() as capture:
        screen.print(table)
    lines = (line.rstrip() for line in capture.get().splitlines())
    sys.stdout.write("\n".join(lines) + "\n\n")


def _stays_on_one_line(cell: str) -> bool:
    return len(cell) <= _LONGEST_UNFOLDED or " " not in cell


def number(value: Any) -> str:
    """Format a cell: floats with four digits or more, sequences with commas, None as a dash."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        if 1e3 <= abs(value) < 1e12:
            return f"{value:,.0f}"
        return f"{value:.4g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(map(number, value))
    return str(value)

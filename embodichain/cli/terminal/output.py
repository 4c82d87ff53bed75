"""Output of verbs on stdout: tables, names and values, JSON."""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from embodichain.utils.number_text import float_text, result_number

if TYPE_CHECKING:
    from rich.console import Console

__all__ = [
    "console",
    "number",
    "print_facts",
    "print_json",
    "print_table",
    "result_number",
    "result_row",
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
    """Print names and values in two columns; without a terminal no word is cut.

    Args:
        title: Printed above the table.
        facts: Names and values; without a value, which is None, a name is left out.
    """
    rows = [[name, number(value)] for name, value in facts if value is not None]
    _print(title, ["", ""], rows, whole_words=True)


def _print(
    title: str,
    names: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    whole_words: bool = False,
) -> None:
    """Print a table without trailing blanks; without a terminal as wide as necessary.

    Columns whose cells are short or one word are not folded if the width allows it; others are
    folded, between words if the width allows that.

    Args:
        title: Printed above the table.
        names: Titles of the columns.
        rows: The cells of each row.
        whole_words: Without a terminal, no word is cut.
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
    screen = console()
    columns = [_Column.of([name, *(row[i] for row in rows)]) for i, name in enumerate(names)]
    gaps = len(columns) * _COLUMN_GAP
    if not _is_bounded():
        least_widths = [column.least for column in columns]
        if whole_words:
            least_widths = [max(column.least, column.longest_word) for column in columns]
        screen.width = max(screen.width, sum(least_widths) + gaps)
    widths = _share_width(columns, screen.width - gaps)
    for name, width in zip(names, widths, strict=True):
        table.add_column(name, overflow="fold", width=width)
    for row in rows:
        table.add_row(*row)
    with screen.capture() as capture:
        screen.print(table)
    lines = (line.rstrip() for line in capture.get().splitlines())
    sys.stdout.write("\n".join(lines) + "\n\n")


@dataclass(frozen=True)
class _Column:
    """How wide a column of a table may be, in characters.

    Attributes:
        least: The least width where there is room: short cells stay on one line.
        longest_word: The width below which words are cut.
        longest_cell: The width that none of its cells exceeds.
    """

    least: int
    longest_word: int
    longest_cell: int

    @classmethod
    def of(cls, cells: Sequence[str]) -> _Column:
        """The widths of a column with these cells, its title among them."""
        words = " ".join(cells).split()
        longest_word = max(map(len, words), default=0)
        longest_cell = max(map(len, cells))
        least = min(_FOLDED_WIDTH, longest_cell)
        if all(map(_stays_on_one_line, cells)):
            least = longest_cell
        return cls(least=least, longest_word=longest_word, longest_cell=longest_cell)


def _share_width(columns: Sequence[_Column], space: int) -> list[int]:
    """Return the width of each column: whole words first, then short cells on one line.

    Args:
        columns: The columns.
        space: The characters that all of them may have.
    """
    least_widths = [column.least for column in columns]
    word_widths = [column.longest_word for column in columns]
    roomy_widths = [max(column.least, column.longest_word) for column in columns]
    widths = list(word_widths)
    if sum(roomy_widths) <= space:
        widths = roomy_widths
    elif sum(word_widths) > space:
        widths = least_widths
    while sum(widths) > space and max(widths) > 1:
        widest = max(range(len(widths)), key=widths.__getitem__)
        widths[widest] -= 1
    _grow(widths, word_widths, space)
    _grow(widths, [column.longest_cell for column in columns], space)
    return widths


def _grow(widths: list[int], wanted: Sequence[int], space: int) -> None:
    """Grow columns up to the widths that they want, the narrowest first."""
    for _ in range(space - sum(widths)):
        growing = [i for i, width in enumerate(wanted) if widths[i] < width]
        if not growing:
            return
        widths[min(growing, key=widths.__getitem__)] += 1


def _stays_on_one_line(cell: str) -> bool:
    return len(cell) <= _LONGEST_UNFOLDED or " " not in cell


def number(value: Any) -> str:
    """Format a cell: floats with four digits or more, sequences with commas, None as a dash."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return float_text(value)
    if isinstance(value, Mapping):
        return _nested(value)
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_nested, value))
    return str(value)


def _nested(value: Any) -> str:
    """A value within a cell, as in YAML: maps and sequences have their brackets."""
    if isinstance(value, Mapping):
        entries = (f"{key}: {_nested(item)}" for key, item in value.items())
        return f"{{{', '.join(entries)}}}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_nested, value))}]"
    return number(value)


def result_row(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row of a table of measured values: its floats as `result_number` writes them."""
    cells = dict(row)
    for name, value in row.items():
        if isinstance(value, float):
            cells[name] = result_number(value)
    return cells

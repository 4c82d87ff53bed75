"""Tables on the terminal. Knows nothing of what is in them."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

__all__ = ["console", "number", "print_facts", "print_table"]

_PIPE_WIDTH = 400  # nobody reads a pipe's margin: a table is never folded for grep


def console(*, stderr: bool = False) -> Console:
    """A rich console on stdout or stderr."""
    from rich.console import Console

    stream = sys.stderr if stderr else sys.stdout
    width = None if stream.isatty() else _PIPE_WIDTH
    return Console(file=stream, width=width, highlight=False, markup=False)


def print_table(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print one line a row under the keys of the first; says so when there is none."""
    from rich import box
    from rich.table import Table

    if not rows:
        sys.stdout.write(f"{title}: none\n\n")
        return
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for name in rows[0]:
        table.add_column(name, overflow="fold")
    for row in rows:
        table.add_row(*(number(row.get(name)) for name in rows[0]))
    _print(table)


def print_facts(title: str, facts: Iterable[tuple[str, Any]]) -> None:
    """Print names and values side by side."""
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, show_header=False)
    table.add_column()
    table.add_column(overflow="fold")
    for name, value in facts:
        table.add_row(name, number(value))
    _print(table)


def _print(table: Table) -> None:
    """Print a table without the blanks that fill it up to its right edge."""
    screen = console()
    with screen.capture() as capture:
        screen.print(table)
    sys.stdout.write("\n".join(line.rstrip() for line in capture.get().splitlines()) + "\n")


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

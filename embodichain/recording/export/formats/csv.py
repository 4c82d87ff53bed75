"""A table with a row for each step and environment, as text."""

from __future__ import annotations

import csv
from pathlib import Path

from embodichain.recording.export.format_register import log_format
from embodichain.recording.export.log_parts import Part
from embodichain.recording.export.tables import tables
from embodichain.recording.format.messages.columns import Column
from embodichain.recording.read.api import Log

__all__ = ["write_csv"]

_ROWS = 1000
"""Number of rows written at once; signals are handled in between."""


@log_format("csv", suffix=".csv")
def write_csv(log: Log, part: Part, path: Path) -> None:
    """Write a header line, ``field/column [unit]``, then the rows without loss of precision."""
    with path.open("x", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        for index, (columns, values) in enumerate(tables(log, part)):
            if index == 0:
                writer.writerow([_title(column) for column in columns])
            for first in range(0, len(values[0]), _ROWS):
                block = [column[first : first + _ROWS].tolist() for column in values]
                writer.writerows(zip(*block, strict=True))


def _title(column: Column) -> str:
    """Name and unit of a column."""
    if not column.unit:
        return column.name
    return f"{column.name} [{column.unit}]"

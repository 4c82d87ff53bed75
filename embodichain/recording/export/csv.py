"""CSV: one header line, ``field/column [unit]``, then a row for each step and environment.

Numbers are written so that reading them gives the same float64.
"""

from __future__ import annotations

import csv
from pathlib import Path

from embodichain.recording.api import Log
from embodichain.recording.export.formats import Part
from embodichain.recording.export.table import columns_of, parts_of

__all__ = ["write"]

_ROWS = 1000


def write(log: Log, part: Part, path: Path) -> None:
    """Write the table."""
    with path.open("x", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        for index, data in enumerate(parts_of(log, part)):
            columns, values = columns_of(data)
            if index == 0:
                writer.writerow([f"{c.name} [{c.unit}]" if c.unit else c.name for c in columns])
            for at in range(0, len(values[0]), _ROWS):  # between these a signal is heard
                block = (v[at : at + _ROWS].tolist() for v in values)
                writer.writerows(zip(*block, strict=True))

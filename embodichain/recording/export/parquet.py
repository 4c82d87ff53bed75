"""Parquet: the table of csv with types; units stand in each column's metadata."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from embodichain.recording.api import Log
from embodichain.recording.export.formats import Part, required
from embodichain.recording.export.table import about, columns_of, parts_of

__all__ = ["write"]


def write(log: Log, part: Part, path: Path) -> None:
    """Write the table, a row group for every part that was read.

    Raises:
        ConfigError: If pyarrow is not installed.
    """
    pa: Any = required("pyarrow", "parquet")
    pq: Any = required("pyarrow.parquet", "parquet")
    writer = None
    try:
        for data in parts_of(log, part):
            columns, values = columns_of(data)
            arrays = [pa.array(v) for v in values]
            schema = pa.schema(
                [
                    pa.field(c.name, array.type, metadata={"unit": c.unit} if c.unit else None)
                    for c, array in zip(columns, arrays, strict=True)
                ],
                metadata=about(log),
            )
            writer = writer or pq.ParquetWriter(path, schema)
            writer.write_table(pa.table(arrays, schema=schema))
    finally:
        if writer is not None:
            writer.close()

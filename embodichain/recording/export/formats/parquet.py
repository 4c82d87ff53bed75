"""The table of csv, typed, as a Parquet file."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from embodichain.recording.export.format_register import log_format, required
from embodichain.recording.export.log_parts import Part, about, episodes_with_draws
from embodichain.recording.export.parquet_files import new_parquet
from embodichain.recording.export.tables import tables
from embodichain.recording.read.api import Log

__all__ = ["write_parquet"]


@log_format("parquet", suffix=".parquet", requires="embodichain[parquet]")
def write_parquet(log: Log, part: Part, path: Path) -> None:
    """Write a typed table with a row group for every part that was read.

    Metadata of columns are their units, of the table what `about` has, and ``drawn``: JSON, a list
    of ``env``, ``episode`` and ``drawn`` of each episode that ended.
    """
    pa: Any = required("pyarrow", "parquet")
    drawn = [
        {"env": episode.env, "episode": episode.episode, "drawn": episode.drawn}
        for episode in episodes_with_draws(log, part)
    ]
    table_metadata = {**about(log), "drawn": json.dumps(drawn)}
    writer: Any = None
    with ExitStack() as stack:
        for columns, values in tables(log, part):
            arrays = [pa.array(v) for v in values]
            fields = []
            for column, array in zip(columns, arrays, strict=True):
                metadata = {"unit": column.unit} if column.unit else None
                fields.append(pa.field(column.name, array.type, metadata=metadata))
            schema = pa.schema(fields, metadata=table_metadata)
            if writer is None:
                writer = stack.enter_context(new_parquet(path, schema, "parquet"))
            writer.write_table(pa.table(arrays, schema=schema))

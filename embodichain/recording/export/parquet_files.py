"""What the formats with Parquet files share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from embodichain.recording.export.format_register import required

__all__ = ["new_parquet"]


@contextmanager
def new_parquet(path: Path, schema: Any, format: str) -> Iterator[Any]:
    """Open a new Parquet file; yields pyarrow's ``ParquetWriter``.

    Arrow writes through a file of Python's: of a file that it opened itself and cannot close, it
    does not say why.

    Args:
        path: The file, which must not exist.
        schema: pyarrow's schema of the tables.
        format: The export's format, for messages.

    Raises:
        ConfigError: If pyarrow is not installed.
        OSError: If the file cannot be written.
    """
    parquet: Any = required("pyarrow.parquet", format)
    with path.open("xb") as stream, parquet.ParquetWriter(stream, schema) as writer:
        yield writer

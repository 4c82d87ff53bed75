"""Tables (csv, parquet) with a row for each step and environment, and arrays (npz)."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.api import Log
from embodichain.recording.export.formats import Part, required
from embodichain.recording.columns import Column

__all__ = ["about", "write_csv", "write_npz", "write_parquet"]

_BYTES = 2**26
"""About how much is held at a time."""
_ROWS = 1000


def write_csv(log: Log, part: Part, path: Path) -> None:
    """Write one header line, ``field/column [unit]``, then the rows, exact to the bit."""
    with path.open("x", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        for index, (columns, values) in enumerate(_tables(log, part)):
            if index == 0:
                writer.writerow([f"{c.name} [{c.unit}]" if c.unit else c.name for c in columns])
            for at in range(0, len(values[0]), _ROWS):  # between these a signal is heard
                block = (v[at : at + _ROWS].tolist() for v in values)
                writer.writerows(zip(*block, strict=True))


def write_npz(log: Log, part: Part, path: Path) -> None:
    """Write fields, their names and units, `steps`, `time`, `env_ids` and `about`."""
    data = log.read(None, part.env, part.episode, part.start, part.stop)
    arrays: dict[str, NDArray[Any]] = {
        "steps": data.steps,
        "time": data.time,
        "env_ids": data.env_ids,
        "about": np.array(json.dumps(about(log))),
    }
    for field in data:
        arrays[field] = data[field]
        arrays[f"{field}.names"] = np.array(data.names(field), np.str_)
        arrays[f"{field}.units"] = np.array([c.unit for c in data.columns[field]], np.str_)
    with path.open("xb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def write_parquet(log: Log, part: Part, path: Path) -> None:
    """Write the table with types, a row group for every part that was read; units are metadata.

    Raises:
        ConfigError: If pyarrow is not installed.
    """
    pa: Any = required("pyarrow", "parquet")
    pq: Any = required("pyarrow.parquet", "parquet")
    writer = None
    try:
        for columns, values in _tables(log, part):
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


def _tables(log: Log, part: Part) -> Iterator[tuple[list[Column], list[NDArray[Any]]]]:
    """Yield columns and their values, each (T * N,), flags as 0 and 1: as many steps as fit.

    The first table may be empty; there is always one.
    """
    width = sum(len(columns) for columns in log.columns.values())
    steps = max(1, _BYTES // (8 * width * log.num_envs))
    empty = log.read(env=part.env, start=part.start, stop=part.start)
    parts = log.parts(None, part.env, part.episode, part.start, part.stop, steps)
    for data in chain([empty], parts):
        columns, values = zip(*data.flat(), strict=True)
        yield list(columns), [v.astype(np.int8) if v.dtype == np.bool_ else v for v in values]


def about(log: Log) -> dict[str, str]:
    """What a table does not say: task, seed, versions, whether the log is whole."""
    header = log.header
    return {
        "task": header.task,
        "seed": str(header.seed),
        "num_envs": str(header.num_envs),
        "control_dt": repr(header.control_dt),
        "physics_dt": repr(header.physics_dt),
        "mujoco_version": header.mujoco_version,
        "complete": str(log.complete).lower(),
        "quaternions": "wxyz",
    }

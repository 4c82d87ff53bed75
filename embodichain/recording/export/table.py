"""The table that csv and parquet hold: a row for each step and environment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.api import Log
from embodichain.recording.arrays import LogArrays
from embodichain.recording.export.formats import Part
from embodichain.recording.model_columns import Column

__all__ = ["about", "columns_of", "parts_of"]

_BYTES = 2**26
"""About how much is held at a time."""


def parts_of(log: Log, part: Part) -> Iterator[LogArrays]:
    """What is meant, as many steps at a time as fit; the first one may be empty, never none."""
    width = sum(len(columns) for columns in log.columns.values())
    steps = max(1, _BYTES // (8 * width * log.num_envs))
    yield log.read(env=part.env, start=part.start, stop=part.start)
    yield from log.parts(None, part.env, part.episode, part.start, part.stop, steps)


def columns_of(data: LogArrays) -> tuple[Sequence[Column], Sequence[NDArray[Any]]]:
    """Columns and their values, each (T * N,); flags as 0 and 1."""
    columns, values = zip(*data.flat(), strict=True)
    return columns, [v.astype(np.int8) if v.dtype == np.bool_ else v for v in values]


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

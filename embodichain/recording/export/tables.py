"""Tables of a log, with a row per step and environment, in parts that fit in memory."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.export.log_parts import Part
from embodichain.recording.format.messages.columns import Column
from embodichain.recording.read.api import Log

__all__ = ["tables"]

_BYTES = 2**26
"""Approximate size of the data in memory at a time."""


def tables(log: Log, part: Part) -> Iterator[tuple[list[Column], list[NDArray[Any]]]]:
    """Yield columns and their (T * N,) values, flags as 0 and 1, in parts that fit in memory.

    It yields at least one table; the first one may be empty.
    """
    width = sum(len(columns) for columns in log.columns.values())
    steps = max(1, _BYTES // (8 * width * log.num_envs))
    # A table without rows, first: the columns are known even if no step is.
    empty = log.read(env=part.env, start=part.start, stop=part.start)
    parts = log.parts(
        env=part.env,
        episode=part.episode,
        start=part.start,
        stop=part.stop,
        steps=steps,
    )
    for data in chain([empty], parts):
        columns = []
        arrays = []
        for column, values in data.flat():
            if values.dtype == np.bool_:
                values = values.astype(np.int8)
            columns.append(column)
            arrays.append(values)
        yield columns, arrays

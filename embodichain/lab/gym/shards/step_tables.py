"""`StepTable`: the arrays of one step of a shard as one array of bytes, for transport.

One array costs one copy and one message for any number of entries.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Path", "StepTable", "join_rows"]

Path = tuple[str, ...]
_ALIGNED = 8
"""Bytes to whose multiples arrays are aligned: the largest item of numpy's numeric types."""


@dataclass(frozen=True, slots=True)
class StepTable:
    """Named arrays in one array of bytes.

    Attributes:
        entries: Path, type and shape of each array, in order.
        data: Their bytes, (size,) uint8.
        values: What is not an array: plain values by name.
    """

    entries: tuple[tuple[Path, str, tuple[int, ...]], ...]
    data: NDArray[np.uint8]
    values: dict[str, Any]

    @classmethod
    def of(cls, arrays: Mapping[Path, NDArray[Any]], values: dict[str, Any]) -> StepTable:
        """Copy arrays into a table."""
        entries = tuple((path, a.dtype.str, a.shape) for path, a in arrays.items())
        size = sum(_padded(a.nbytes) for a in arrays.values())
        data = np.zeros(size, np.uint8)
        start = 0
        for array in arrays.values():
            target = data[start : start + array.nbytes].view(array.dtype).reshape(array.shape)
            target[...] = array
            start += _padded(array.nbytes)
        return cls(entries, data, values)

    def arrays(self) -> dict[Path, NDArray[Any]]:
        """Path -> array: views of the bytes, read only after transport."""
        arrays: dict[Path, NDArray[Any]] = {}
        start = 0
        for path, dtype_name, shape in self.entries:
            dtype = np.dtype(dtype_name)
            size = dtype.itemsize * int(np.prod(shape, dtype=np.int64))
            arrays[path] = self.data[start : start + size].view(dtype).reshape(shape)
            start += _padded(size)
        return arrays


def _padded(size: int) -> int:
    """The next multiple of the alignment."""
    return -(-size // _ALIGNED) * _ALIGNED


def join_rows(parts: Sequence[Mapping[Path, NDArray[Any]]]) -> dict[Path, NDArray[Any]]:
    """Join the arrays of shards, (n, ...) each, into (N, ...); new arrays.

    Raises:
        ValueError: If shards have different entries; names one.
    """
    first = parts[0]
    for part in parts[1:]:
        if part.keys() != first.keys():
            path = sorted(part.keys() ^ first.keys())[0]
            raise ValueError(f"{'/'.join(path)} is in some shards of the batch, and not in others")
    return {path: np.concatenate([part[path] for part in parts]) for path in first}

"""`ObservationStore`: the observations of recent steps; those of an episode are taken from it."""

from __future__ import annotations

import tempfile
from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.observation import Observation, Path, as_array

__all__ = ["ObservationStore"]

_LARGEST_IN_MEMORY = 2**18
"""Bytes; larger entries (images of all environments) are kept in a file."""


class _FiledArray(NamedTuple):
    """The place of an array in the file.

    Attributes:
        offset: Its first byte.
        dtype: Its type.
        shape: (N, ...).
    """

    offset: int
    dtype: np.dtype[Any]
    shape: tuple[int, ...]

    @property
    def row_bytes(self) -> int:
        """Bytes of one environment."""
        return self.dtype.itemsize * int(np.prod(self.shape[1:], dtype=np.int64))

    @property
    def nbytes(self) -> int:
        """Bytes of all environments."""
        return self.shape[0] * self.row_bytes


class _StoredObservation(NamedTuple):
    """An observation of all environments.

    Attributes:
        rows: (N, ...) the entries of the observation's array.
        others: Path to each other entry, such as an image.
    """

    rows: NDArray[Any]
    others: dict[Path, NDArray[Any] | _FiledArray]


class ObservationStore:
    """Keeps observations by number, ascending without gaps. Close it, or use `with`.

    Entries of the observation's array are kept in memory, images in a temporary file, whose
    places are used again. So memory does not grow with the number or the size of images.
    """

    def __init__(self) -> None:
        self._first_number = 0
        self._observations: deque[_StoredObservation] = deque()
        self._file = tempfile.TemporaryFile(prefix="embodichain_")  # noqa: SIM115
        self._free_offsets: dict[int, list[int]] = {}  # by the bytes of the array that was there
        self._end = 0

    def __enter__(self) -> ObservationStore:
        """Return the store."""
        return self

    def __exit__(self, *error: object) -> None:
        """Remove the temporary file."""
        self._file.close()

    def add(self, number: int, obs: Observation) -> None:
        """Keep an observation."""
        if not self._observations:
            self._first_number = number
        others: dict[Path, NDArray[Any] | _FiledArray] = {}
        for path, array in _others(obs):
            if array.nbytes > _LARGEST_IN_MEMORY:
                others[path] = self._write(array)
            else:
                others[path] = array
        self._observations.append(_StoredObservation(obs.rows, others))

    def forget(self, before: int) -> None:
        """Give up the observations with smaller numbers."""
        while self._observations and self._first_number < before:
            oldest = self._observations.popleft()
            self._first_number += 1
            for array in oldest.others.values():
                if isinstance(array, _FiledArray):
                    self._free_offsets.setdefault(array.nbytes, []).append(array.offset)

    def take(self, env: int, first: int, stop: int, final: Observation) -> dict[str, NDArray[Any]]:
        """The observations of one environment.

        Args:
            env: The environment.
            first: Number of the first.
            stop: Number after the last.
            final: One more observation of all environments, to come last.

        Returns:
            Path of the entry, joined by "/", to (stop - first + 1, ...), as new arrays.
        """
        observations = [self._observations[n - self._first_number] for n in range(first, stop)]
        rows = np.stack([*(stored.rows[env] for stored in observations), final.rows[env]])
        layout = final.layout
        entries: dict[str, NDArray[Any]] = {}
        for path in layout.paths:
            columns = rows[:, layout.columns[path]]
            entries["/".join(path)] = columns.reshape(len(rows), *layout.shapes[path]).copy()
        for path, final_array in _others(final):
            values = np.empty((len(rows), *final_array.shape[1:]), final_array.dtype)
            for index, stored in enumerate(observations):
                array = stored.others[path]
                if isinstance(array, _FiledArray):
                    values[index] = self._read(array, env)
                else:
                    values[index] = array[env]
            values[-1] = final_array[env]
            entries["/".join(path)] = values
        return entries

    def _write(self, array: NDArray[Any]) -> _FiledArray:
        free_offsets = self._free_offsets.get(array.nbytes)
        offset = free_offsets.pop() if free_offsets else self._end
        filed = _FiledArray(offset, array.dtype, array.shape)
        self._end = max(self._end, offset + filed.nbytes)
        self._file.seek(offset)
        self._file.write(np.ascontiguousarray(array).data)
        return filed

    def _read(self, array: _FiledArray, env: int) -> NDArray[Any]:
        self._file.seek(array.offset + env * array.row_bytes)
        data = self._file.read(array.row_bytes)
        return np.frombuffer(data, array.dtype).reshape(array.shape[1:])


def _others(obs: Observation) -> Iterator[tuple[Path, NDArray[Any]]]:
    """The entries of an observation that are not in its array."""
    return ((path, as_array(value)) for path, value in obs.others.items())

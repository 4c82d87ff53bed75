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

_FILED_BYTES = 2**18
"""Larger entries (images of all environments) are kept in a file."""


class _Filed(NamedTuple):
    """An array in the file."""

    offset: int
    dtype: np.dtype[Any]
    shape: tuple[int, ...]

    @property
    def row_bytes(self) -> int:
        return self.dtype.itemsize * int(np.prod(self.shape[1:], dtype=np.int64))

    @property
    def nbytes(self) -> int:
        return self.shape[0] * self.row_bytes


class ObservationStore:
    """Keeps observations by number, ascending without gaps. Close it, or use `with`.

    Entries of the environment's array are kept as they are, images in a temporary file, whose
    places are used again. So memory does not grow with the number or the size of images.
    """

    def __init__(self) -> None:
        self._first = 0
        self._kept: deque[tuple[Observation, dict[Path, NDArray[Any] | _Filed]]] = deque()
        self._file = tempfile.TemporaryFile(prefix="embodichain_")  # noqa: SIM115
        self._free: dict[int, list[int]] = {}
        self._end = 0

    def __enter__(self) -> ObservationStore:
        """Return the store."""
        return self

    def __exit__(self, *error: object) -> None:
        """Remove the temporary file."""
        self._file.close()

    def add(self, number: int, obs: Observation) -> None:
        """Keep an observation."""
        if not self._kept:
            self._first = number
        others = {
            path: self._write(array) if array.nbytes > _FILED_BYTES else array
            for path, array in _others(obs)
        }
        small = Observation(obs.layout, obs.rows)
        self._kept.append((small, others))

    def forget(self, before: int) -> None:
        """Give up the observations with smaller numbers."""
        while self._kept and self._first < before:
            _, others = self._kept.popleft()
            self._first += 1
            for place in others.values():
                if isinstance(place, _Filed):
                    self._free.setdefault(place.nbytes, []).append(place.offset)

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
        kept = [self._kept[number - self._first] for number in range(first, stop)]
        rows = np.stack([*(obs.rows[env] for obs, _ in kept), final.rows[env]])
        layout = final.layout
        found: dict[str, NDArray[Any]] = {}
        for path in layout.paths:
            columns = rows[:, layout.columns[path]]
            found["/".join(path)] = columns.reshape(len(rows), *layout.shapes[path]).copy()
        for path, array in _others(final):
            values = np.empty((len(rows), *array.shape[1:]), array.dtype)
            for index, (_, others) in enumerate(kept):
                place = others[path]
                values[index] = self._read(place, env) if isinstance(place, _Filed) else place[env]
            values[-1] = array[env]
            found["/".join(path)] = values
        return found

    def _write(self, array: NDArray[Any]) -> _Filed:
        free = self._free.get(array.nbytes)
        place = _Filed(free.pop() if free else self._end, array.dtype, array.shape)
        self._end = max(self._end, place.offset + place.nbytes)
        self._file.seek(place.offset)
        self._file.write(np.ascontiguousarray(array).data)
        return place

    def _read(self, place: _Filed, env: int) -> NDArray[Any]:
        self._file.seek(place.offset + env * place.row_bytes)
        data = self._file.read(place.row_bytes)
        return np.frombuffer(data, place.dtype).reshape(place.shape[1:])


def _others(obs: Observation) -> Iterator[tuple[Path, NDArray[Any]]]:
    """The entries of an observation that are not in its array."""
    return ((path, as_array(value)) for path, value in obs.others.items())

"""`Template`: a protobuf message whose bytes stay where they are; only numbers in it change.

Filling one costs a few microseconds, whatever it holds; with message objects every field costs as
much.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64
from embodichain.recording.foxglove.messages import Timestamp

__all__ = ["STAMP", "Template", "mark"]

STAMP = Timestamp(seconds=2**34 + 0x1234567, nanos=2**30 + 0x1234567)
"""Stands for the time; both numbers are as long as any on the wire."""
_STAMP = STAMP.SerializeToString()
_STAMP_TYPE = f"V{len(_STAMP)}"
_MARK = struct.Struct("<IHH")


def mark(number: int) -> float:
    """The double that stands for the number-th value; numbers count in the order of the bytes."""
    value: float = struct.unpack("<d", _MARK.pack(number, 0xBEEF, 0x3FF5))[0]
    return value


class Template:
    """A serialized message with marks for what changes.

    Args:
        data: The message, with `mark(0)` to `mark(count - 1)` as doubles, in ascending order, and
            `STAMP` wherever its time stands.
        count: How many marks there are.
        copies: How many messages like this are filled together.
        order: (count,) which mark each value is for; None is mark by mark.

    Raises:
        ValueError: If a mark is missing.
    """

    def __init__(
        self, data: bytes, count: int, copies: int = 1, order: NDArray[np.int64] | None = None
    ) -> None:
        self._size = len(data)
        self._bytes = bytearray(data * copies)  # filled in place: every mark is, every time
        found, at = [], 0
        for number in range(count):
            at = data.index(_MARK.pack(number, 0xBEEF, 0x3FF5), at)
            found.append(at)
            at += 8
        places = np.array(found, np.int64)
        self._places = places if order is None else places[order]
        self._at = self._in_copies(self._places, copies)
        self._numbers = _anywhere(self._bytes, len(self._bytes), "<f8")
        found, at = [], data.find(_STAMP)
        while at >= 0:
            found.append(at)
            at = data.find(_STAMP, at + len(_STAMP))
        self._stamp_places = np.array(found, np.int64)
        self._stamps_at = self._in_copies(self._stamp_places, copies)
        self._stamps = _anywhere(self._bytes, len(self._bytes), _STAMP_TYPE)
        self._stamped = len(self._stamps_at) > 0

    def _in_copies(self, places: NDArray[np.int64], copies: int) -> NDArray[np.int64]:
        """Where (k,) places of a message are in all copies."""
        return (self._size * np.arange(copies)[:, None] + places).reshape(-1)

    def fill_all(self, values: F64, time_ns: int = 0) -> list[bytes]:
        """The messages with these numbers, (copies, count) of them, and this time."""
        filled, size = self.fill(values, time_ns), self._size
        return [filled[at : at + size] for at in range(0, len(filled), size)]

    def table(self, values: F64, times: Sequence[int]) -> NDArray[np.uint8]:
        """(m, bytes) messages with (m, count) numbers, of these (m,) moments in ns."""
        size = self._size
        table = np.empty((len(values), size), np.uint8)
        table[:] = np.frombuffer(self._bytes, np.uint8, size)
        rows = size * np.arange(len(values))[:, None]
        _anywhere(table, table.size, "<f8")[rows + self._places] = values
        if self._stamped:
            stamps = np.array([_stamp(time_ns) for time_ns in times])
            _anywhere(table, table.size, _STAMP_TYPE)[rows + self._stamp_places] = stamps
        return table

    def fill(self, values: F64, time_ns: int = 0) -> bytes:
        """The messages one after another, with these numbers and this time."""
        self._numbers[self._at] = values.reshape(-1)
        if self._stamped:
            self._stamps[self._stamps_at] = _stamp(time_ns)
        return bytes(self._bytes)


def _anywhere(memory: Any, nbytes: int, kind: str) -> NDArray[Any]:
    """Bytes as overlapping values: the k-th begins at byte k."""
    last = nbytes - np.dtype(kind).itemsize
    return np.ndarray((max(0, last + 1),), kind, memory, 0, (1,))


@lru_cache(maxsize=128)  # messages of one moment share it
def _stamp(time_ns: int) -> NDArray[np.void]:
    """A `Timestamp` of `_STAMP`'s length: numbers with leading zeros, which every decoder reads."""
    seconds, nanos = divmod(time_ns, 1_000_000_000)
    return np.array([8, *_long(seconds), 16, *_long(nanos)], np.uint8).view(_STAMP_TYPE)


def _long(value: int) -> list[int]:
    """A varint of five bytes."""
    return [value >> shift & 0x7F | 0x80 for shift in (0, 7, 14, 21)] + [value >> 28 & 0x7F]

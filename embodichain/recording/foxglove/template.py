"""`Template`: a protobuf message whose bytes stay where they are; only numbers in it change.

Filling one costs a few microseconds, whatever it holds; with message objects every field costs as
much.
"""

from __future__ import annotations

import struct
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64
from embodichain.recording.foxglove.messages import Timestamp

__all__ = ["STAMP", "Template", "mark"]

STAMP = Timestamp(seconds=2**34 + 0x1234567, nanos=2**30 + 0x1234567)
"""Stands for the time; both numbers are as long as any on the wire."""
_STAMP = STAMP.SerializeToString()
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

    Raises:
        ValueError: If a mark is missing.
    """

    def __init__(self, data: bytes, count: int) -> None:
        self._bytes = np.frombuffer(data, np.uint8)
        found, at = [], 0
        for number in range(count):
            at = data.index(_MARK.pack(number, 0xBEEF, 0x3FF5), at)
            found.append(at)
            at += 8
        self._values = np.array(found, np.int64)[:, None] + np.arange(8)
        found, at = [], data.find(_STAMP)
        while at >= 0:
            found.append(at)
            at = data.find(_STAMP, at + len(_STAMP))
        self._stamps = np.array(found, np.int64)[:, None] + np.arange(len(_STAMP))

    def fill(self, values: F64, time_ns: int = 0) -> bytes:
        """The message with these numbers, as many as there are marks, and this time."""
        filled = self._bytes.copy()
        filled[self._values] = values.astype("<f8").reshape(-1, 1).view(np.uint8)
        filled[self._stamps] = _stamp(time_ns)
        return filled.tobytes()


@lru_cache(maxsize=2)  # messages of one moment share it
def _stamp(time_ns: int) -> NDArray[np.uint8]:
    """A `Timestamp` of `_STAMP`'s length: numbers with leading zeros, which every decoder reads."""
    seconds, nanos = divmod(time_ns, 1_000_000_000)
    return np.array([8, *_long(seconds), 16, *_long(nanos)], np.uint8)


def _long(value: int) -> list[int]:
    """A varint of five bytes."""
    return [value >> shift & 0x7F | 0x80 for shift in (0, 7, 14, 21)] + [value >> 28 & 0x7F]

"""CDR, the encoding of ROS 2 messages, for messages whose layout stays the same.

A message is laid out once; afterwards only its numbers are filled in. Little endian; every number
is aligned to its size, counted from after the four bytes of encapsulation (OMG DDS-XTypes 7.4).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["CdrTemplate"]

_ENCAPSULATION = b"\x00\x01\x00\x00"  # plain CDR, little endian
_BILLION = 10**9


class CdrTemplate:
    """The bytes of a message, with the places of its stamps and doubles."""

    def __init__(self) -> None:
        self._raw = bytearray()
        self._stamps: list[int] = []
        self._doubles: list[int] = []
        self._payload: NDArray[np.uint8] | None = None

    def uint(self, value: int) -> CdrTemplate:
        """Add a uint32: a constant, or how long a sequence is."""
        self._align(4)
        self._raw += struct.pack("<I", value)
        return self

    def text(self, value: str) -> CdrTemplate:
        """Add a string."""
        data = value.encode() + b"\0"
        self.uint(len(data))
        self._raw += data
        return self

    def stamp(self) -> CdrTemplate:
        """Add a time, which `fill` sets."""
        self._align(4)
        self._stamps.append(len(self._raw) // 4)
        self._raw += bytes(8)
        return self

    def doubles(self, count: int) -> CdrTemplate:
        """Add numbers, which `fill` sets in the order in which they were added."""
        if count:
            self._align(8)
            at = len(self._raw) // 8
            self._doubles += range(at, at + count)
            self._raw += bytes(8 * count)
        return self

    def header(self, frame_id: str = "") -> CdrTemplate:
        """Add a `std_msgs/Header`."""
        return self.stamp().text(frame_id)

    def texts(self, values: Sequence[str]) -> CdrTemplate:
        """Add a sequence of strings."""
        self.uint(len(values))
        for value in values:
            self.text(value)
        return self

    def _align(self, size: int) -> None:
        self._raw += bytes(-len(self._raw) % size)

    def fill(self, time_ns: int, values: NDArray[np.float64] | None = None) -> bytes:
        """The message at a time, with these doubles."""
        if self._payload is None:
            self._payload = np.frombuffer(bytes(self._raw) + bytes(-len(self._raw) % 8), np.uint8)
            self._payload = self._payload.copy()
        words = self._payload.view("<u4")
        for at in self._stamps:
            words[at], words[at + 1] = time_ns // _BILLION, time_ns % _BILLION
        if values is not None:
            self._payload.view("<f8")[self._doubles] = values
        return _ENCAPSULATION + self._payload[: len(self._raw)].tobytes()

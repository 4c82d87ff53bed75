"""`Template`: protobuf messages whose bytes stay where they are; only numbers in them change.

Those of many moments are made together, as a table of bytes, in a few operations whatever a message
holds; with message objects every field costs as much.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64
from embodichain.recording import wire
from embodichain.recording.foxglove.messages import Timestamp

__all__ = ["STAMP", "Template", "mark", "stamps"]

STAMP = Timestamp(seconds=2**34 + 0x1234567, nanos=2**30 + 0x1234567)
"""Stands for the time; both numbers are as long as any on the wire."""
_STAMP = STAMP.SerializeToString()
_STAMP_TYPE = f"V{len(_STAMP)}"
_FIELD = len(_STAMP) // 2
"""Bytes of each number in it: its key, and a varint of five."""
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
        order: (count,) which mark each value is for; None is mark by mark.

    Raises:
        ValueError: If a mark is missing.
    """

    def __init__(self, data: bytes, count: int, order: NDArray[np.int64] | None = None) -> None:
        self._bytes = np.frombuffer(data, np.uint8)
        found, at = [], 0
        for number in range(count):
            at = data.index(_MARK.pack(number, 0xBEEF, 0x3FF5), at)
            found.append(at)
            at += 8
        places = np.array(found, np.int64)
        self._places = places if order is None else places[order]
        found, at = [], data.find(_STAMP)
        while at >= 0:
            found.append(at)
            at = data.find(_STAMP, at + len(_STAMP))
        self._stamp_places = np.array(found, np.int64)

    def table(self, values: F64, stamped: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
        """(m, bytes) messages.

        Args:
            values: (m, count) numbers of each.
            stamped: The moment of each, as `stamps` has it, where the message has a time.
        """
        table = np.empty((len(values), len(self._bytes)), np.uint8)
        table[:] = self._bytes
        if len(self._places):
            _anywhere(table, "<f8")[:, self._places] = values
        if stamped is not None:
            _anywhere(table, _STAMP_TYPE)[:, self._stamp_places] = stamped.view(_STAMP_TYPE)
        return table


def _anywhere(table: NDArray[np.uint8], kind: str) -> NDArray[Any]:
    """Bytes of each row as overlapping values: the k-th begins at byte k."""
    count, size = table.shape
    places = max(0, size - np.dtype(kind).itemsize + 1)
    return np.ndarray((count, places), kind, table, 0, (size, 1))


def stamps(times: Sequence[int]) -> NDArray[np.uint8]:
    """(m, bytes) a `Timestamp` of `STAMP`'s length for each of (m,) moments in ns.

    Numbers have leading zeros, which every decoder reads.
    """
    parts = np.divmod(np.array(times, np.int64), 1_000_000_000)
    found = np.empty((len(times), len(_STAMP)), np.uint8)
    for number, part in enumerate(parts):
        field = found[:, _FIELD * number : _FIELD * (number + 1)]
        field[:, 0] = number + 1 << 3
        wire.put_varints(field[:, 1:], part)
    return found

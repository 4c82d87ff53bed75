"""Protobuf's wire format, as far as our own messages need it: no generated code, no copy of arrays.

A packed field of doubles is the array's own little-endian bytes
(https://protobuf.dev/programming-guides/encoding). What is built here is byte for byte what
protobuf's serializer writes: fields in ascending order, defaults left out.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "WireError",
    "array",
    "packed",
    "parse",
    "put_varints",
    "text",
    "uint",
    "uints",
    "unpack",
    "unpack_varints",
    "varint",
]

Fields = dict[int, list[Any]]


class WireError(ValueError):
    """Bytes are not a protobuf message."""


@lru_cache(maxsize=4096)
def varint(value: int) -> bytes:
    """Return a non-negative integer in base 128."""
    if value < 0x80:
        return bytes((value,))
    out = bytearray()
    while value >= 0x80:
        out.append((value & 0x7F) | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


@lru_cache(maxsize=4096)
def uint(field: int, value: int) -> bytes:
    """A varint field (uint32, uint64, enum); nothing for 0, as proto3 has it."""
    return varint(field << 3) + varint(value) if value else b""


def uints(field: int, first: int, count: int) -> NDArray[np.uint8] | None:
    """(count, bytes) `uint` of numbers that follow each other; None unless all are equally long."""
    begin, end = uint(field, first), uint(field, first + count - 1)
    if len(begin) != len(end):
        return None
    key = len(varint(field << 3))
    table = np.empty((count, len(begin)), np.uint8)
    table[:, :key] = np.frombuffer(begin[:key], np.uint8)
    put_varints(table[:, key:], np.arange(first, first + count))
    return table


def put_varints(table: NDArray[np.uint8], values: NDArray[np.int64]) -> None:
    """Write (m,) numbers as varints of (m, bytes), with leading zeros where they have fewer."""
    table[:] = values[:, None] >> 7 * np.arange(table.shape[1])  # a byte keeps the lowest bits
    table[:, :-1] |= 0x80


def text(field: int, value: str | bytes) -> bytes:
    """A string, bytes or message field; nothing for an empty one."""
    if not value:
        return b""
    raw = value.encode() if isinstance(value, str) else value
    return varint(field << 3 | 2) + varint(len(raw)) + raw


@lru_cache(maxsize=1024)
def packed(field: int, nbytes: int) -> bytes:
    """What precedes the bytes of a packed field; nothing for an empty one."""
    return varint(field << 3 | 2) + varint(nbytes) if nbytes else b""


def array(field: int, values: NDArray[Any], dtype: str) -> bytes:
    """A packed field of fixed-width numbers (``<f8``, ``<u8``, ``<i8``, ``<u4``)."""
    raw = np.ascontiguousarray(values, dtype).tobytes()
    return packed(field, len(raw)) + raw


def _read_varint(data: memoryview, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        if at >= len(data) or shift > 63:
            raise WireError("a varint does not end")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7


def parse(data: bytes | memoryview) -> Fields:
    """Return the values of every field: ints, or memoryviews of what has a length.

    Raises:
        WireError: If `data` is not a protobuf message.
    """
    view = memoryview(data)
    fields: Fields = {}
    at = 0
    while at < len(view):
        key, at = _read_varint(view, at)
        kind = key & 7
        value: int | float | memoryview
        if kind == 0:
            value, at = _read_varint(view, at)
        elif kind in (1, 5):
            size = 8 if kind == 1 else 4
            if at + size > len(view):
                raise WireError("a number is cut short")
            value = struct.unpack_from("<d" if kind == 1 else "<I", view, at)[0]
            at += size
        elif kind == 2:
            size, at = _read_varint(view, at)
            if at + size > len(view):
                raise WireError("a field is longer than its message")
            value = view[at : at + size]
            at += size
        else:
            raise WireError(f"unknown wire type {kind}")
        fields.setdefault(key >> 3, []).append(value)
    return fields


def unpack(fields: Fields, field: int, dtype: str) -> NDArray[Any]:
    """A packed field as a read-only array that shares the message's bytes; empty if absent."""
    values = fields.get(field)
    if not values:
        return np.empty(0, dtype)
    raw = values[-1]
    if not isinstance(raw, memoryview) or len(raw) % np.dtype(dtype).itemsize:
        raise WireError(f"field {field} is not a packed array of {dtype}")
    return np.frombuffer(raw, dtype)


def unpack_varints(fields: Fields, field: int) -> list[int]:
    """A packed field of varints as a list."""
    out: list[int] = []
    for raw in fields.get(field, []):
        at = 0
        while at < len(raw):
            value, at = _read_varint(raw, at)
            out.append(value)
    return out

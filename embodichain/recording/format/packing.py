"""Stores the arrays of a run one after another, without redundancy.

* Arrays of the same type with equal bytes are stored once.
* float64 arrays of values that float32 can represent (a policy's actions) are stored as float32.
* A float64 array that differs from another one in a few numbers only (ctrl and the actions it
  follows) is stored as the exclusive or of both, which is mostly zeros.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.format.log_error import LARGEST_CHUNK, DamageError

__all__ = ["DTYPES", "Place", "load", "store"]

DTYPES = {name: np.dtype(name) for name in ("<f8", "<f4", "<i8", "<u8", "|b1")}
_F4 = DTYPES["<f4"]
_F8 = DTYPES["<f8"]
_SMALLEST = 64
"""Bytes; smaller arrays are stored as they are."""
_MANTISSA_REST = 2**29 - 1
"""Mask of the mantissa bits that float32 does not have."""
_NOT_SINGLE = np.uint64(_MANTISSA_REST)


class Place(NamedTuple):
    """Where an array is stored, and how.

    Attributes:
        offset: Offset of its bytes.
        single: Whether they are float32.
        base: Offset of the array to combine them with by exclusive or; None if there is none.
        base_single: Whether the bytes at `base` are float32.
    """

    offset: int
    single: bool = False
    base: int | None = None
    base_single: bool = False


def store(arrays: Sequence[tuple[str, Sequence[Any]]]) -> tuple[list[Place], list[Any]]:
    """Place arrays one after another.

    Args:
        arrays: dtype of each, and the contiguous arrays that it consists of.

    Returns:
        The place of each array, and the stored bytes as bytes and arrays.
    """
    sizes = [sum(piece.nbytes for piece in pieces) for _, pieces in arrays]
    compared: dict[int, tuple[str, bytes, bytes | None]] = {}  # dtype, bytes, and as float32
    same_as: dict[int, int] = {}
    for number, ((dtype, pieces), size) in enumerate(zip(arrays, sizes, strict=True)):
        may_be_single = size >= _SMALLEST and dtype == "<f8" and _looks_single(pieces[0])
        if not may_be_single and (size < _SMALLEST or sizes.count(size) == 1):
            continue
        data = b"".join(pieces)
        same = (i for i, (kind, other, _) in compared.items() if kind == dtype and other == data)
        equal = next(same, None)
        if equal is None:
            compared[number] = dtype, data, _single(data) if may_be_single else None
        else:
            same_as[number] = equal
    places: dict[int, Place] = {}
    parts: list[Any] = []
    end = 0
    for number in sorted(compared, key=lambda k: compared[k][2] is None):
        dtype, data, single = compared[number]
        place = Place(end)
        written = data
        if single is not None:
            place = Place(end, single=True)
            written = single
        elif dtype == "<f8":
            for other, base in places.items():
                if base.base is None and compared[other][0] == dtype and sizes[other] == len(data):
                    mask = np.bitwise_xor(_words(data), _words(compared[other][1]))
                    if np.count_nonzero(mask) <= len(mask) // 4:
                        place = Place(end, False, base.offset, base.single)
                        written = mask.tobytes()
                        break
        places[number] = place
        parts.append(written)
        end += len(written)
    for number, (_, pieces) in enumerate(arrays):
        if number in same_as:
            places[number] = places[same_as[number]]
        elif number not in compared:
            places[number] = Place(end)
            parts += pieces
            end += sizes[number]
    return [places[number] for number in range(len(arrays))], parts


def _words(data: bytes) -> NDArray[np.uint64]:
    return np.frombuffer(data, np.uint64)


def _looks_single(values: NDArray[Any]) -> bool:
    """Whether a few of the values, which nearly always decide, are float32 values."""
    words = values.reshape(-1).view(np.uint64)
    return not any(word & _MANTISSA_REST for word in words[:: max(1, len(words) // 4)].tolist())


def _single(data: bytes) -> bytes | None:
    """float64 values as float32 if the conversion is exact; else None."""
    if (_words(data) & _NOT_SINGLE).any():
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        single = np.frombuffer(data, _F8).astype(_F4)
    same = np.array_equal(single.astype(_F8).view(np.uint64), _words(data))
    return single.tobytes() if same else None


def load(name: str, dtype: str, shape: tuple[int, ...], place: Place, data: memoryview) -> Any:
    """Read an array from the stored bytes; a view of them where possible.

    Args:
        name: For messages.
        dtype: Its type.
        shape: Its shape.
        place: Where it is.
        data: What was stored.

    Raises:
        DamageError: If its place is outside the stored bytes.
    """
    if (place.single or place.base is not None) and dtype != "<f8":
        raise DamageError(f"array {name!r} of type {dtype!r} is stored as float64")
    values = _load(name, dtype, shape, place.offset, place.single, data)
    if place.base is not None:
        base = _load(name, dtype, shape, place.base, place.base_single, data)
        values = np.bitwise_xor(values.view(np.uint64), base.view(np.uint64)).view(_F8)
    return values.reshape(shape)


def _load(
    name: str, dtype: str, shape: tuple[int, ...], offset: int, single: bool, data: memoryview
) -> NDArray[Any]:
    kind = _F4 if single else DTYPES[dtype]
    size = 1
    for length in shape:  # Python integers do not overflow
        size *= length
    if offset + size * kind.itemsize > min(len(data), LARGEST_CHUNK):
        raise DamageError(f"array {name!r} of shape {shape} is not in the message")
    flat = np.frombuffer(data, kind, size, offset)
    if dtype == "|b1":
        flat = flat.view(np.uint8) != 0  # any non-zero byte is True
    return flat.astype(_F8) if single else flat

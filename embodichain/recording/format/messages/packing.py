"""Stores the arrays of a run one after another, without redundancy.

* Arrays of the same type with equal bytes are stored once.
* float64 arrays of values that float32 can represent (a policy's actions) are stored as float32.
* A float64 array that differs from another one in a few numbers only (ctrl and the actions it
  follows) is stored as the exclusive or of both, which is mostly zeros.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.format.log_error import LARGEST_CHUNK, DamageError

__all__ = ["DTYPES", "Place", "load", "store"]

DTYPES = {name: np.dtype(name) for name in ("<f8", "<f4", "<i8", "<u8", "|b1")}
_F4 = DTYPES["<f4"]
_F8 = DTYPES["<f8"]
_SMALLEST_COMPARED = 64
"""Bytes; smaller arrays are stored as they are."""
_LARGEST_JOINED = 4096
"""Bytes; larger pieces are passed on as they are, without a copy."""
_EXTRA_MANTISSA = 2**29 - 1
"""Mask of the bits of a float64's mantissa that float32 does not have."""


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


class _Compared(NamedTuple):
    """An array that may be stored in another form.

    Attributes:
        dtype: Its type.
        data: Its bytes.
        single: Its values as float32; None if float32 cannot represent them.
    """

    dtype: str
    data: bytes
    single: bytes | None


def store(arrays: Sequence[tuple[str, Any]]) -> tuple[list[Place], list[Any]]:
    """Place arrays one after another.

    Small arrays, and those that cannot be equal to another one because of their size, are not
    looked at: they are stored as they are.

    Args:
        arrays: dtype of each, and the pieces that it consists of: a sequence of contiguous arrays
            or bytes of equal size, or an (S, size) array of the bytes of S pieces.

    Returns:
        The place of each array, and the stored bytes as bytes and arrays.
    """
    sizes = [len(pieces) * memoryview(pieces[0]).nbytes for _, pieces in arrays]
    compared: dict[int, _Compared] = {}  # by index in `arrays`
    same_as: dict[int, int] = {}  # index of an array to that of an equal one before it
    for index, (dtype, pieces) in enumerate(arrays):
        size = sizes[index]
        may_be_single = size >= _SMALLEST_COMPARED and dtype == "<f8" and _looks_single(pieces[0])
        if not may_be_single and (size < _SMALLEST_COMPARED or sizes.count(size) == 1):
            continue
        data = _join(pieces)
        equal = _equal_array(compared, dtype, data)
        if equal is None:
            single = _as_single(data) if may_be_single else None
            compared[index] = _Compared(dtype, data, single)
        else:
            same_as[index] = equal
    places: dict[int, Place] = {}
    stored: list[Any] = []
    end = 0
    # Arrays as float32 first: those that differ from one of them in a few numbers come after it.
    for index in sorted(compared, key=lambda index: compared[index].single is None):
        array = compared[index]
        if array.single is not None:
            place = Place(end, single=True)
            content = array.single
        else:
            place, content = _place_difference(array, end, places, compared)
        places[index] = place
        stored.append(content)
        end += len(content)
    for index, (_, pieces) in enumerate(arrays):
        if index in same_as:
            places[index] = places[same_as[index]]
        elif index not in compared:
            places[index] = Place(end)
            if isinstance(pieces, np.ndarray) or memoryview(pieces[0]).nbytes < _LARGEST_JOINED:
                stored.append(_join(pieces))
            else:
                stored += pieces
            end += sizes[index]
    return [places[index] for index in range(len(arrays))], stored


def _join(pieces: Any) -> bytes:
    return pieces.tobytes() if isinstance(pieces, np.ndarray) else b"".join(pieces)


def _equal_array(compared: Mapping[int, _Compared], dtype: str, data: bytes) -> int | None:
    for index, other in compared.items():
        if other.dtype == dtype and other.data == data:
            return index
    return None


def _place_difference(
    array: _Compared, end: int, places: Mapping[int, Place], compared: Mapping[int, _Compared]
) -> tuple[Place, bytes]:
    """Store a float64 array as its difference from a similar one; any other as it is.

    Args:
        array: The array.
        end: Where its bytes are stored.
        places: Arrays that have been placed before.
        compared: Their contents.
    """
    if array.dtype == "<f8":
        for index, base in places.items():
            other = compared[index]
            # A base must not need another array itself: reading takes one step.
            is_usable = base.base is None and other.dtype == array.dtype
            if not is_usable or len(other.data) != len(array.data):
                continue
            difference = np.bitwise_xor(_words(array.data), _words(other.data))
            if np.count_nonzero(difference) <= len(difference) // 4:
                place = Place(end, base=base.offset, base_single=base.single)
                return place, difference.tobytes()
    return Place(end), array.data


def _words(data: bytes) -> NDArray[np.uint64]:
    return np.frombuffer(data, np.uint64)


def _looks_single(values: Any) -> bool:
    """Whether a few of some float64 values, which nearly always decide, are float32 values."""
    words = np.frombuffer(values, np.uint64)
    stride = max(1, len(words) // 4)
    return not any(word & _EXTRA_MANTISSA for word in words[::stride].tolist())


def _as_single(data: bytes) -> bytes | None:
    """float64 values as float32 if the conversion is exact; else None."""
    if (_words(data) & np.uint64(_EXTRA_MANTISSA)).any():
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        single = np.frombuffer(data, _F8).astype(_F4)
    # Large, tiny and NaN values may have changed although their mantissas are short.
    if np.array_equal(single.astype(_F8).view(np.uint64), _words(data)):
        return single.tobytes()
    return None


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
    stored_dtype = _F4 if single else DTYPES[dtype]
    size = math.prod(shape)  # Python integers do not overflow
    if offset + size * stored_dtype.itemsize > min(len(data), LARGEST_CHUNK):
        raise DamageError(f"array {name!r} of shape {shape} is not in the message")
    values = np.frombuffer(data, stored_dtype, size, offset)
    if dtype == "|b1":
        values = values.view(np.uint8) != 0  # any non-zero byte is True
    if single:
        values = values.astype(_F8)
    return values

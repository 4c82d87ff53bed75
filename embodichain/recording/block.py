"""A run of control steps with the same calls, and the `embodichain.Steps` message that holds it.

What happens in a control step is a list of calls, in the order in which they happened:

========= ========================= ======================= =======================================
kind      name                      mode                    arrays
========= ========================= ======================= =======================================
write     field of the write        op of the write:        ``env_ids`` (n,) i8 if not all N,
                                    state, model, reset,    ``values`` (n, k) f8 but for set_const;
                                    set_const               of a reset the (n, nstate) rows it left
physics                                                     ``env_ids`` (n,) i8 if not all N,
                                                            ``rows`` (n, moved) f8 as returned, or
                                                            ``hashes`` (n,) u8 of them, ``failed``
                                                            (m,) i8 where the engine raised
event     term                      startup, reset,         ``env_ids`` (n,) i8 if not all N, and
                                    interval, command       ``drawn.NAME`` f8 for each draw
step                                                        ``action`` (N, A) f8, ``reward`` (N,)
                                                            f4, ``terminated``, ``truncated`` (N,)
                                                            bool, ``episode_ids`` (N,) i8
start                                                       ``row`` (N, nstate) f8 and each
                                                            randomized model field, (N, size) f8
========= ========================= ======================= =======================================

`nstep` is the number of physics steps of a physics call, `columns` those of a write within the
flattened field (None: all). `moved` are the columns of a row that physics writes
(`columns.moved_ranges`); the others, its inputs, change by writes alone. Everything that happens
after a control step belongs to the next one: its calls come first there. The last call of a step
is ``step``; only what follows the last step of a recording ends without it. A ``start`` stands
alone in a message of its own on `START_TOPIC`, and says what the simulation is before control step
`first`: no message before it is needed to follow those after it.

Steps with equal calls (names, columns, dtypes, shapes) make one message on `STEPS_TOPIC`: steps
`first` to `first + count - 1`. The array `name` of a call lies in `data` at `offset`, as `count`
arrays of `shape` one after another, little-endian, by rows. Two arrays may have the same offset:
equal bytes are stored once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from embodichain.recording.log_error import LARGEST_CHUNK, DamageError
from embodichain.recording.schema import message_class

__all__ = ["DRAWN", "ArrayKind", "Call", "CallKind", "Run", "pack_run", "unpack_run"]

DRAWN = "drawn."
"""Names of arrays that an event drew begin so."""

MOST_STEPS = 2**12
MOST_PHYSICS_STEPS = 1_000_000
"""Larger counts in a file are not believed."""

_SMALLEST_SHARED = 64
"""Bytes; smaller arrays are not compared with others."""
_DTYPES = {"<f8": 8, "<f4": 4, "<i8": 8, "<u8": 8, "|b1": 1}
_KINDS = {"write", "physics", "event", "step", "start"}
_WRITES = {"state": True, "model": True, "reset": True, "set_const": False}
"""Operation of a write: whether it has values."""


class ArrayKind(NamedTuple):
    """What every array of this name in a run is like.

    Attributes:
        name: See the table above.
        dtype: ``<f8``, ``<f4``, ``<i8``, ``<u8`` or ``|b1``.
        shape: In one control step.
    """

    name: str
    dtype: str
    shape: tuple[int, ...]


class CallKind(NamedTuple):
    """What is the same in a call of every step of a run: see the table above.

    Attributes:
        kind: ``write``, ``physics``, ``event``, ``step`` or ``start``.
        name: Field of a write, term of an event.
        mode: Operation of a write, mode of an event.
        nstep: Physics steps of a physics call.
        columns: Columns of a write; None is all of them.
        arrays: What the call carries.
    """

    kind: str
    name: str = ""
    mode: str = ""
    nstep: int = 0
    columns: tuple[int, ...] | None = None
    arrays: tuple[ArrayKind, ...] = ()


@dataclass(frozen=True, slots=True)
class Call:
    """A call in every step of a run.

    Attributes:
        kind: What it is.
        arrays: Name to (count, ...) values, read-only.
    """

    kind: CallKind
    arrays: Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Run:
    """Steps with the same calls.

    Attributes:
        first: Control step of the first.
        count: How many.
        calls: In the order in which they happened in each step.
    """

    first: int
    count: int
    calls: list[Call]

    @property
    def steps(self) -> int:
        """Control steps that were finished: `count`, or 0 where the run ends within a step."""
        return self.count if self.calls and self.calls[-1].kind.kind == "step" else 0

    def of_kind(self, kind: str) -> list[Call]:
        """Calls of a kind."""
        return [call for call in self.calls if call.kind.kind == kind]


def pack_run(
    first: int, kinds: Sequence[CallKind], steps: Sequence[Sequence[Sequence[NDArray[Any]]]]
) -> bytes:
    """Serialize a run as `embodichain.Steps`.

    Args:
        first: Control step of the first.
        kinds: The calls of every step.
        steps: For each step, for each call, its arrays in the order of the kind: contiguous, of
            the kind's dtype and shape.
    """
    message = message_class("Steps")(first=first, count=len(steps))
    parts: list[bytes] = []
    offsets: list[int] = []
    end = 0
    for i, kind in enumerate(kinds):
        call = message.calls.add(kind=kind.kind, name=kind.name, mode=kind.mode, nstep=kind.nstep)
        if kind.columns is not None:
            call.some_columns = True
            call.columns.extend(kind.columns)
        for j, array in enumerate(kind.arrays):
            data = b"".join([step[i][j].data for step in steps])
            offset = end
            if len(data) >= _SMALLEST_SHARED:
                same = (o for o, p in zip(offsets, parts, strict=True) if p == data)
                offset = next(same, end)
            if offset == end:
                parts.append(data)
                offsets.append(end)
                end += len(data)
            call.arrays.add(name=array.name, dtype=array.dtype, shape=array.shape, offset=offset)
    # Protobuf concatenates: the key of field 4 and its length, without copying the bytes again.
    head = message.SerializeToString()
    return b"".join([head, b"\x22", _varint(end), *parts])


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def unpack_run(data: bytes | memoryview, num_envs: int, moved: int, nstate: int) -> Run:
    """Read `embodichain.Steps`; no length, index or shape in it is believed unchecked.

    Args:
        data: The message.
        num_envs: N of the log.
        moved: Columns that physics writes.
        nstate: Columns of a whole row.

    Returns:
        The run; its arrays share the message's bytes.

    Raises:
        DamageError: If the message is not a run of such a log.
    """
    message = message_class("Steps")()
    try:
        message.ParseFromString(bytes(data))
    except DecodeError as error:
        raise DamageError(f"a run of control steps is damaged: {error}") from error
    first, count, blob = message.first, message.count, message.data
    if not 0 < count <= MOST_STEPS or first >= 2**62:
        raise DamageError(f"a run of {count} control steps from step {first}")
    calls = []
    for found in message.calls:
        arrays: dict[str, NDArray[Any]] = {}
        for array in found.arrays:
            arrays[array.name] = _array(array, count, blob)
        kinds = tuple(ArrayKind(a.name, a.dtype, tuple(a.shape)) for a in found.arrays)
        columns = tuple(found.columns) if found.some_columns else None
        kind = CallKind(found.kind, found.name, found.mode, found.nstep, columns, kinds)
        why = _wrong(kind, arrays, num_envs, moved, nstate)
        if why:
            raise DamageError(f"step {first}: {why}")
        calls.append(Call(kind, arrays))
    return Run(first, count, calls)


def _array(array: Any, count: int, blob: bytes) -> NDArray[Any]:
    """(count, *shape) values of an `embodichain.Array`."""
    shape = tuple(array.shape)
    itemsize = _DTYPES.get(array.dtype)
    if itemsize is None:
        raise DamageError(f"array {array.name!r} has the unknown type {array.dtype!r}")
    size = count * math.prod(shape)
    if len(shape) > 8 or array.offset + size * itemsize > min(len(blob), LARGEST_CHUNK):
        raise DamageError(f"array {array.name!r} of shape {shape} is not in the message")
    flat = np.frombuffer(blob, array.dtype, size, array.offset)
    if array.dtype == "|b1" and size and int(flat.view(np.uint8).max()) > 1:
        raise DamageError(f"array {array.name!r} has flags that are neither true nor false")
    return flat.reshape(count, *shape)


def _wrong(
    kind: CallKind, arrays: Mapping[str, NDArray[Any]], num_envs: int, moved: int, nstate: int
) -> str:
    """What is wrong with a call; empty if nothing is."""
    what = f"{kind.kind} {kind.name}".rstrip()
    if kind.kind not in _KINDS:
        return f"unknown call {kind.kind!r}"
    if len(arrays) != len(kind.arrays):
        return f"{what} has an array twice"
    n = num_envs
    for name in ("env_ids", "failed"):
        if name in arrays:
            ids = arrays[name]
            if ids.ndim != 2 or ids.dtype != np.int64 or not _ascending(ids, num_envs):
                return f"{what} has no environments of this log as {name}"
    if "env_ids" in arrays:
        n = arrays["env_ids"].shape[1]
    have = {array.name: (array.dtype, array.shape) for array in kind.arrays}
    have.pop("env_ids", None)
    if kind.kind == "write":
        return _wrong_write(kind, have, n, nstate)
    if kind.kind == "physics":
        have.pop("failed", None)
        if kind.nstep > MOST_PHYSICS_STEPS:
            return f"{kind.nstep} physics steps at once"
        if have not in ({"rows": ("<f8", (n, moved))}, {"hashes": ("<u8", (n,))}):
            return "physics has no result of these environments"
    elif kind.kind == "step":
        width = have.get("action", ("", ()))[1][1:]
        flags = ("|b1", (n,))
        if len(width) != 1 or have != {
            "action": ("<f8", (n, *width)),
            "reward": ("<f4", (n,)),
            "terminated": flags,
            "truncated": flags,
            "episode_ids": ("<i8", (n,)),
        }:
            return "a step lacks actions, rewards or flags"
    elif kind.kind == "start":
        row = have.pop("row", None)
        if row != ("<f8", (num_envs, nstate)):
            return "a start lacks whole rows"
        if any(d != "<f8" or len(s) != 2 or s[0] != num_envs for d, s in have.values()):
            return "a start has model fields that are not of every environment"
    elif any(not name.startswith(DRAWN) or d != "<f8" for name, (d, _) in have.items()):
        return f"{what} has arrays that are no draws"
    return ""


def _wrong_write(
    kind: CallKind, have: Mapping[str, tuple[str, tuple[int, ...]]], n: int, nstate: int
) -> str:
    if kind.mode not in _WRITES:
        return f"unknown operation {kind.mode!r}"
    if not _WRITES[kind.mode]:
        return f"{kind.mode} has values" if have or kind.columns is not None else ""
    values = have.get("values", ("", ()))
    if len(have) != 1 or values[0] != "<f8" or len(values[1]) != 2 or values[1][0] != n:
        return f"a write to {kind.name!r} lacks values"
    if kind.mode == "reset" and (kind.columns is not None or values[1][1] != nstate):
        return "a reset lacks whole rows"
    if kind.columns is not None and len(kind.columns) != values[1][1]:
        return f"a write to {kind.name!r} has other columns than values"
    return ""


def _ascending(ids: NDArray[Any], num_envs: int) -> bool:
    if not ids.size:
        return True
    inside = int(ids.min()) >= 0 and int(ids.max()) < num_envs
    return inside and bool((np.diff(ids, axis=1) > 0).all())

"""A run of control steps with the same calls, and the `embodichain.Steps` message of a run.

A control step is recorded as a list of calls, in the order in which they happened:

========= ========================= ======================= =======================================
kind      name                      mode                    arrays
========= ========================= ======================= =======================================
write     field of the write        op of the write:        ``env_ids`` (n,) i8 if not all N,
                                    state, model, reset,    ``values`` (n, k) f8, not in set_const;
                                    set_const               in reset the resulting (n, nstate) rows
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

`nstep` is the number of physics steps of a physics call. `columns` are the columns of the flattened
field that a write changes (None: all). `moved` is the number of columns of a row that physics
writes (`columns.moved_ranges`); the other columns are inputs and change only by writes. Calls after
a control step are the first calls of the next one. The last call of a step is ``step``; only the
calls after the last step of a recording end without it. A ``start`` is a separate message on
`START_TOPIC` with the state of the simulation before control step `first`: replaying the messages
after it needs none before it.

Consecutive steps with equal calls (names, columns, dtypes, shapes) form one message on
`STEPS_TOPIC`: steps `first` to `first + count - 1`. The array `name` of a call is in `data` at
`offset`: `count` arrays of `shape`, little-endian, row-major; `packing` may store it compactly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from embodichain.recording.log_error import DamageError
from embodichain.recording.packing import DTYPES, Place, load, store
from embodichain.recording.schema import message_class

__all__ = ["DRAWN", "ArrayKind", "Call", "CallKind", "Run", "pack_run", "unpack_run"]

DRAWN = "drawn."
"""Prefix of the names of arrays that an event drew."""

MOST_STEPS = 2**12
MOST_PHYSICS_STEPS = 1_000_000
"""Larger counts in a file are refused."""

_IDS = frozenset({"env_ids", "failed"})
"""Arrays of environment indices."""
_FIRST, _COUNT, _CALLS, _DATA = 0x08, 0x10, 0x1A, 0x22
"""Keys of the fields of `embodichain.Steps`: number and wire type."""
_LARGEST_CACHED = 4096
"""Size limit in bytes of a call's declaration that is cached for later messages."""
_KINDS = {"write", "physics", "event", "step", "start"}
_WRITES = {"state": True, "model": True, "reset": True, "set_const": False}
"""Operation of a write to whether it has values."""


class ArrayKind(NamedTuple):
    """Name, dtype and shape of an array of a call, the same in every step of a run.

    Attributes:
        name: See the table above.
        dtype: ``<f8``, ``<f4``, ``<i8``, ``<u8`` or ``|b1``.
        shape: Shape in one control step.
    """

    name: str
    dtype: str
    shape: tuple[int, ...]


class CallKind(NamedTuple):
    """The properties of a call that are the same in every step of a run: see the table above.

    Attributes:
        kind: ``write``, ``physics``, ``event``, ``step`` or ``start``.
        name: Field of a write, term of an event.
        mode: Operation of a write, mode of an event.
        nstep: Physics steps of a physics call.
        columns: Columns of a write; None is all of them.
        arrays: Kinds of its arrays.
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
        kind: Its properties.
        arrays: Name to (count, ...) values, read-only.
    """

    kind: CallKind
    arrays: Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Run:
    """Consecutive control steps with the same calls.

    Attributes:
        first: Number of the first control step.
        count: Number of steps.
        calls: The calls, in the order in which they happened in each step.
    """

    first: int
    count: int
    calls: list[Call]

    @property
    def steps(self) -> int:
        """Number of finished control steps: `count`, or 0 if the run has no ``step`` call."""
        return self.count if self.calls and self.calls[-1].kind.kind == "step" else 0

    def of_kind(self, kind: str) -> list[Call]:
        """Calls of a kind."""
        return [call for call in self.calls if call.kind.kind == kind]


def pack_run(
    first: int, kinds: Sequence[CallKind], steps: Sequence[Sequence[Sequence[Any]]]
) -> bytes:
    """Serialize a run as `embodichain.Steps`.

    Args:
        first: Number of the first control step.
        kinds: The calls of every step.
        steps: For each step and each call, its arrays, in the order of the kind: contiguous, with
            the kind's dtype and shape.
    """
    message = message_class("Steps")(first=first, count=len(steps))
    contents: list[tuple[str, bytes]] = []
    described: list[Any] = []
    for i, kind in enumerate(kinds):
        call = message.calls.add(kind=kind.kind, name=kind.name, mode=kind.mode, nstep=kind.nstep)
        if kind.columns is not None:
            call.some_columns = True
            call.columns.extend(kind.columns)
        for j, array in enumerate(kind.arrays):
            contents.append((array.dtype, b"".join([step[i][j] for step in steps])))
            described.append(call.arrays.add(name=array.name, dtype=array.dtype, shape=array.shape))
    places, parts = store(contents)
    for array, place in zip(described, places, strict=True):
        array.offset, array.single = place.offset, place.single
        if place.base is not None:
            array.differs, array.base, array.base_single = True, place.base, place.base_single
    # Append field 4 (its key, length and bytes) by hand: protobuf would copy the bytes again.
    head = message.SerializeToString()
    return b"".join([head, b"\x22", _varint(sum(map(len, parts))), *parts])


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def unpack_run(
    data: bytes | memoryview,
    num_envs: int,
    moved: int,
    nstate: int,
    wanted: Callable[[CallKind], bool] | None = None,
) -> Run:
    """Read an `embodichain.Steps` message; every length, index and shape in it is checked.

    Args:
        data: The message.
        num_envs: N of the log.
        moved: Number of columns that physics writes.
        nstate: Number of columns of a full row.
        wanted: Whether a call is read; None reads all. A ``step`` that is not read is kept without
            arrays.

    Returns:
        The run; most of its arrays share the message's bytes.

    Raises:
        DamageError: If the message is not a valid run of this log.
    """
    first, count, declared_calls, blob = _split(memoryview(data))
    if not 0 < count <= MOST_STEPS or first >= 2**62:
        raise DamageError(f"a run of {count} control steps from step {first}")
    calls = []
    for declared in declared_calls:
        declaration = _declaration if len(declared) < _LARGEST_CACHED else _declaration.__wrapped__
        kind, places, why = declaration(declared, num_envs, moved, nstate)
        if wanted is not None and not wanted(kind):
            if kind.kind == "step":
                calls.append(Call(kind, {}))
            continue
        if why:
            raise DamageError(f"step {first}: {why}")
        arrays = {}
        for array, place in zip(kind.arrays, places, strict=True):
            name, dtype, shape = array
            values = arrays[name] = load(name, dtype, (count, *shape), place, blob)
            if name in _IDS and not _ascending(values, num_envs):
                raise DamageError(f"step {first}: {name} are no environments of this log")
        calls.append(Call(kind, arrays))
    return Run(first, count, calls)


def _split(data: memoryview) -> tuple[int, int, list[bytes], memoryview]:
    """The fields of a serialized `embodichain.Steps`; unlike protobuf, it does not copy `data`."""
    numbers = {_FIRST: 0, _COUNT: 0}
    calls: list[bytes] = []
    blob, at = data[:0], 0
    while at < len(data):
        key, at = _read_varint(data, at)
        value, at = _read_varint(data, at)
        if key in numbers:
            numbers[key] = value
            continue
        if key not in (_CALLS, _DATA) or value > len(data) - at:
            raise DamageError("a run of control steps is damaged: it has an unknown field")
        found, at = data[at : at + value], at + value
        if key == _CALLS:
            calls.append(bytes(found))
        else:
            blob = found
    return numbers[_FIRST], numbers[_COUNT], calls, blob


def _read_varint(data: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for index, byte in enumerate(data[at : at + 10]):
        value |= (byte & 0x7F) << 7 * index
        if byte < 0x80:
            return value, at + index + 1
    raise DamageError("a run of control steps is damaged: it is cut short")


@lru_cache(maxsize=1024)
def _declaration(
    data: bytes, num_envs: int, moved: int, nstate: int
) -> tuple[CallKind, tuple[Place, ...], str]:
    """Parse a serialized `embodichain.Call`: its kind, the places of its arrays, and the error."""
    try:
        call = message_class("Call").FromString(data)
    except DecodeError as error:
        raise DamageError(f"a run of control steps is damaged: {error}") from error
    arrays = tuple(ArrayKind(a.name, a.dtype, tuple(a.shape)) for a in call.arrays)
    columns = tuple(call.columns) if call.some_columns else None
    kind = CallKind(call.kind, call.name, call.mode, call.nstep, columns, arrays)
    places = tuple(
        Place(a.offset, a.single, a.base if a.differs else None, a.base_single) for a in call.arrays
    )
    return kind, places, _wrong(kind, num_envs, moved, nstate)


def _wrong(kind: CallKind, num_envs: int, moved: int, nstate: int) -> str:
    """The error in a call; empty if there is none."""
    what = f"{kind.kind} {kind.name}".rstrip()
    if kind.kind not in _KINDS:
        return f"unknown call {kind.kind!r}"
    shapes = {array.name: array.shape for array in kind.arrays}
    if len(shapes) != len(kind.arrays):
        return f"{what} has an array twice"
    for array in kind.arrays:
        if array.dtype not in DTYPES or len(array.shape) > 8:
            return f"{what} has an array of unknown type, {array.dtype!r}"
        if array.name in _IDS and (array.dtype != "<i8" or len(array.shape) != 1):
            return f"{what} has no environments as {array.name}"
    n = shapes["env_ids"][0] if "env_ids" in shapes else num_envs
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
    """Whether each of the (count, n) rows has valid environment indices in ascending order."""
    if not ids.size:
        return True
    inside = int(ids[:, 0].min()) >= 0 and int(ids[:, -1].max()) < num_envs
    return inside and bool((ids[:, 1:] > ids[:, :-1]).all())

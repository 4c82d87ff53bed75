"""Recorded control steps, and the `embodichain.Steps` message that has several of them.

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

A message on `STEPS_TOPIC` has steps `first` to `first + count - 1`. Calls of the same kind (names,
columns, dtypes, shapes) are one entry, which lists its `steps` (from 0) if it is not in all of
them; the calls of a step are in the order of the entries. The array `name` of an entry is in `data`
at `offset`: as many arrays of `shape` as it has steps, little-endian, row-major; `packing` may
store it compactly. On reading, consecutive steps with the same calls form a `Run`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from embodichain.recording.format.log_error import DamageError
from embodichain.recording.format.messages.packing import DTYPES, Place, load, store
from embodichain.recording.format.messages.schema import message_class

__all__ = [
    "DRAWN",
    "ArrayKind",
    "Call",
    "CallKind",
    "Recorded",
    "Run",
    "pack_steps",
    "unpack_steps",
]

DRAWN = "drawn."
"""Prefix of the names of arrays that an event drew."""

MOST_STEPS = 2**12
MOST_PHYSICS_STEPS = 1_000_000
MOST_CALLS = 2**23
"""Larger counts in a file are refused; the last one is of calls times steps in a message."""

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


Recorded = tuple[CallKind, tuple[NDArray[Any], ...]]
"""A call of one step, and its arrays: contiguous, with the kind's dtypes and shapes."""


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


@dataclass(slots=True)
class _Entry:
    """The calls of one kind in a message: their steps, and their arrays in each of these."""

    kind: CallKind
    steps: list[int] = field(default_factory=list)
    arrays: list[tuple[NDArray[Any], ...]] = field(default_factory=list)


def _entries(steps: Sequence[Sequence[Recorded]]) -> list[_Entry]:
    """Group the calls of some steps, so that the entries are in the order of each step's calls."""
    entries: list[_Entry] = []
    places: dict[tuple[int, ...], list[_Entry]] = {}
    for step, calls in enumerate(steps):
        key = tuple([id(kind) for kind, _ in calls])
        found = places.get(key)
        if found is None:
            found, at = [], 0
            for kind, _ in calls:
                where = [i for i in range(at, len(entries)) if entries[i].kind == kind]
                if not where:
                    entries.insert(at, _Entry(kind))
                at = where[0] if where else at
                found.append(entries[at])
                at += 1
            places[key] = found
        for entry, (_, arrays) in zip(found, calls, strict=True):
            entry.steps.append(step)
            entry.arrays.append(arrays)
    return entries


def pack_steps(first: int, steps: Sequence[Sequence[Recorded]]) -> list[Any]:
    """Serialize control steps as `embodichain.Steps`.

    Args:
        first: Number of the first control step.
        steps: The calls of each step.

    Returns:
        The message, as bytes and arrays that follow one another.
    """
    message = message_class("Steps")(first=first, count=len(steps))
    contents: list[tuple[str, list[NDArray[Any]]]] = []
    described: list[Any] = []
    for entry in _entries(steps):
        kind = entry.kind
        call = message.calls.add(kind=kind.kind, name=kind.name, mode=kind.mode, nstep=kind.nstep)
        if kind.columns is not None:
            call.some_columns = True
            call.columns.extend(kind.columns)
        if len(entry.steps) < len(steps):
            call.steps.extend(entry.steps)
        for j, array in enumerate(kind.arrays):
            contents.append((array.dtype, [arrays[j] for arrays in entry.arrays]))
            described.append(call.arrays.add(name=array.name, dtype=array.dtype, shape=array.shape))
    places, parts = store(contents)
    for array, place in zip(described, places, strict=True):
        array.offset, array.single = place.offset, place.single
        if place.base is not None:
            array.differs, array.base, array.base_single = True, place.base, place.base_single
    # Append field 4 (its key, length and bytes) by hand: protobuf would copy the bytes again.
    size = sum(memoryview(part).nbytes for part in parts)
    return [message.SerializeToString() + b"\x22" + _varint(size), *parts]


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def unpack_steps(
    data: bytes | memoryview,
    num_envs: int,
    moved: int,
    nstate: int,
    wanted: Callable[[CallKind], bool] | None = None,
) -> list[Run]:
    """Read an `embodichain.Steps` message; every length, index and shape in it is checked.

    Args:
        data: The message.
        num_envs: N of the log.
        moved: Number of columns that physics writes.
        nstate: Number of columns of a full row.
        wanted: Whether a call is read; None reads all. A ``step`` that is not read is kept without
            arrays.

    Returns:
        Its steps, grouped by the calls that are read; most arrays share the message's bytes.

    Raises:
        DamageError: If the message has no valid control steps of this log.
    """
    first, count, declared_calls, blob = _split(memoryview(data))
    if not 0 < count <= MOST_STEPS or first >= 2**62 or count * len(declared_calls) > MOST_CALLS:
        raise DamageError(f"a message of {count} control steps from step {first}")
    calls: list[Call] = []
    happens = np.ones((count, len(declared_calls)), np.bool_)
    for declared in declared_calls:
        declaration = _declaration if len(declared) < _LARGEST_CACHED else _declaration.__wrapped__
        kind, places, some, why = declaration(declared, num_envs, moved, nstate)
        read = wanted is None or wanted(kind)
        if not read and kind.kind != "step":
            continue
        why = why or _wrong_steps(some, count)
        if why:
            raise DamageError(f"step {first}: {why}")
        if some:
            happens[:, len(calls)] = False
            happens[some, len(calls)] = True
        arrays = {}
        for array, place in zip(kind.arrays, places, strict=True) if read else ():
            name, dtype, shape = array
            values = load(name, dtype, (len(some) or count, *shape), place, blob)
            if name in _IDS and not _ascending(values, num_envs):
                raise DamageError(f"step {first}: {name} are no environments of this log")
            arrays[name] = values
        calls.append(Call(kind, arrays))
    return list(_runs(first, calls, happens[:, : len(calls)]))


def _wrong_steps(some: Sequence[int], count: int) -> str:
    """The error in the steps that a call lists; empty if there is none."""
    ascending = all(a < b for a, b in pairwise(some))
    return "" if not some or (ascending and some[-1] < count) else f"a call is in steps {some}"


def _runs(first: int, calls: Sequence[Call], happens: NDArray[np.bool_]) -> Iterator[Run]:
    """Split a message into runs; `happens` is (count, calls)."""
    count = len(happens)
    changes = np.flatnonzero((happens[1:] != happens[:-1]).any(axis=1)) + 1
    if not len(changes) and happens[:1].all():
        yield Run(first, count, list(calls))
        return
    done = [0] * len(calls)
    for begin, end in pairwise([0, *changes.tolist(), count]):
        found = []
        for i in np.flatnonzero(happens[begin]).tolist():
            at, done[i] = done[i], done[i] + end - begin
            arrays = {name: a[at : done[i]] for name, a in calls[i].arrays.items()}
            found.append(Call(calls[i].kind, arrays))
        yield Run(first + begin, end - begin, found)


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
            raise DamageError("a message of control steps is damaged: it has an unknown field")
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
    raise DamageError("a message of control steps is damaged: it is cut short")


@lru_cache(maxsize=1024)
def _declaration(
    data: bytes, num_envs: int, moved: int, nstate: int
) -> tuple[CallKind, tuple[Place, ...], tuple[int, ...], str]:
    """Parse a serialized `embodichain.Call`.

    Returns:
        Its kind, the places of its arrays, its steps (empty: all of them), and the error in it.
    """
    try:
        call = message_class("Call").FromString(data)
    except DecodeError as error:
        raise DamageError(f"a message of control steps is damaged: {error}") from error
    arrays = tuple(ArrayKind(a.name, a.dtype, tuple(a.shape)) for a in call.arrays)
    columns = tuple(call.columns) if call.some_columns else None
    kind = CallKind(call.kind, call.name, call.mode, call.nstep, columns, arrays)
    places = tuple(
        Place(a.offset, a.single, a.base if a.differs else None, a.base_single) for a in call.arrays
    )
    return kind, places, tuple(call.steps), _wrong(kind, num_envs, moved, nstate)


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

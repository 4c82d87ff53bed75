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
calls after the last step of a recording end without it. A ``start`` (users know them as keyframes)
is a separate message on `START_TOPIC` with the state of the simulation before control step `first`:
replaying the messages after it needs none before it.

A message on `STEPS_TOPIC` has steps `first` to `first + count - 1`. Calls of the same kind (names,
columns, dtypes, shapes) are one entry, which lists its `steps` (from 0) if it is not in all of
them; the calls of a step are in the order of the entries. The array `name` of an entry is in `data`
at `offset`: as many arrays of `shape` as it has steps, little-endian, row-major; `packing` may
store it compactly. On reading, consecutive steps with the same calls form a `Run`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import groupby, pairwise
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
    "joined_places",
    "pack_steps",
    "unpack_steps",
]

DRAWN = "drawn."
"""Prefix of the names of arrays that an event drew."""

MOST_STEPS = 2**12
MOST_PHYSICS_STEPS = 1_000_000
MOST_CALLS = 2**23
"""Larger counts in a file are refused; the last one is of calls times steps in a message."""

_ID_ARRAYS = frozenset({"env_ids", "failed"})
"""Arrays of environment indices."""
_FIRST = 0x08
_COUNT = 0x10
_CALLS = 0x1A
_DATA = 0x22
"""Keys of the fields of `embodichain.Steps`: number and wire type."""
_LARGEST_CACHED = 4096
"""Size limit in bytes of a call's declaration that is cached for later messages."""
_KINDS = {"write", "physics", "event", "step", "start"}
_HAS_VALUES = {"state": True, "model": True, "reset": True, "set_const": False}
"""Operation of a write -> whether it has values."""


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
    """What calls have in common that are stored as one entry: a row of the table above, filled in.

    Attributes:
        kind: The first column: ``write``, ``physics``, ``event``, ``step`` or ``start``.
        name: Of a write, the field that it changes, such as ``qpos``; of an event, its term. Empty
            for other calls.
        mode: Of a write, what it does: `Write.op`, such as ``state``. Of an event, when it fired:
            ``startup``, ``reset``, ``interval`` or ``command``. Empty for other calls.
        nstep: Of a physics call, its physics steps.
        columns: Of a write, the columns of the field; None is all of them.
        arrays: Name, dtype and shape of each array of the call.
    """

    kind: str
    name: str = ""
    mode: str = ""
    nstep: int = 0
    columns: tuple[int, ...] | None = None
    arrays: tuple[ArrayKind, ...] = ()


Recorded = tuple[CallKind, tuple[NDArray[Any] | bytes, ...] | bytes]
"""A call of one step, and its arrays: contiguous, with the kind's dtypes and shapes; or the bytes
of all of them one after another, which take a third of the time to copy."""


@dataclass(frozen=True, slots=True)
class Call:
    """A call in every step of a run.

    Attributes:
        kind: What it is; its `CallKind.kind` is the word in the first column of the table.
        arrays: Name -> (count, ...) values, one for each step of the run, read-only.
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
    """The calls of one kind in a message: their steps, and their arrays in each of these.

    Attributes:
        kind: The kind.
        steps: The steps.
        arrays: As in `Recorded`, for each step.
    """

    kind: CallKind
    steps: list[int] = field(default_factory=list)
    arrays: list[Any] = field(default_factory=list)

    def pieces(self) -> list[Any]:
        """For each of the kind's arrays, its values in each step."""
        kinds = self.kind.arrays
        if not kinds:
            return []
        if isinstance(self.arrays[0], bytes):
            if len(kinds) == 1:
                return [self.arrays]
            return _split_arrays(kinds, self.arrays)
        # Readers' tests declare fewer arrays than they store.
        return list(zip(*self.arrays, strict=True))[: len(kinds)]


def _split_arrays(kinds: Sequence[ArrayKind], joined: Sequence[Any]) -> list[NDArray[np.uint8]]:
    """Split the joined arrays of some steps.

    Args:
        kinds: The arrays.
        joined: Their bytes in each of S steps, one after another.

    Returns:
        The (S, size) bytes of each array in all S steps.
    """
    steps = np.frombuffer(b"".join(joined), np.uint8).reshape(len(joined), -1)
    return [steps[:, place] for place in joined_places(kinds)]


def joined_places(kinds: Sequence[ArrayKind]) -> list[slice]:
    """Where each array is in the bytes of all of them, one after another."""
    places = []
    start = 0
    for kind in kinds:
        end = start + DTYPES[kind.dtype].itemsize * math.prod(kind.shape)
        places.append(slice(start, end))
        start = end
    return places


def _entries(steps: Sequence[Sequence[Recorded]]) -> list[_Entry]:
    """Group the calls of some steps, so that the entries are in the order of each step's calls.

    Most steps make the same calls as the one before, so the calls of consecutive steps are taken
    together, and it is looked up once for each sequence of calls which entries they belong to.
    Sequences are compared by the identity of their kinds: a recorder builds each kind once
    (`CallEncoder`), and hashing kinds would be slower.
    """
    entries: list[_Entry] = []
    entries_of: dict[tuple[int, ...], list[_Entry]] = {}
    keys = [tuple([id(kind) for kind, _ in calls]) for calls in steps]
    first = 0
    for key, equal_keys in groupby(keys):
        end = first + len(list(equal_keys))
        step_entries = entries_of.get(key)
        if step_entries is None:
            step_entries = _place_calls(entries, [kind for kind, _ in steps[first]])
            entries_of[key] = step_entries
        for index, entry in enumerate(step_entries):
            entry.steps.extend(range(first, end))
            entry.arrays.extend([calls[index][1] for calls in steps[first:end]])
        first = end
    return entries


def _place_calls(entries: list[_Entry], kinds: Sequence[CallKind]) -> list[_Entry]:
    """The entries of a step's calls, in ascending order; missing ones are inserted.

    A call gets the next entry of its kind after the entry of the call before it, so that reading
    the entries from first to last gives the calls in the order in which they happened. A kind that
    occurs twice in a step therefore has two entries.
    """
    step_entries: list[_Entry] = []
    index = 0
    for kind in kinds:
        same_kind = [i for i in range(index, len(entries)) if entries[i].kind == kind]
        if same_kind:
            index = same_kind[0]
        else:
            entries.insert(index, _Entry(kind))
        step_entries.append(entries[index])
        index += 1
    return step_entries


def pack_steps(first: int, steps: Sequence[Sequence[Recorded]]) -> list[Any]:
    """Serialize control steps as `embodichain.Steps`.

    Args:
        first: Number of the first control step.
        steps: The calls of each step.

    Returns:
        The message, as bytes and arrays that follow one another.
    """
    message = message_class("Steps")(first=first, count=len(steps))
    contents: list[tuple[str, Any]] = []  # dtype and pieces of each array
    declared_arrays: list[Any] = []
    for entry in _entries(steps):
        kind = entry.kind
        call = message.calls.add(
            kind=kind.kind,
            name=kind.name,
            mode=kind.mode,
            nstep=kind.nstep,
        )
        if kind.columns is not None:
            call.some_columns = True
            call.columns.extend(kind.columns)
        if len(entry.steps) < len(steps):
            call.steps.extend(entry.steps)
        for array, pieces in zip(kind.arrays, entry.pieces(), strict=True):
            contents.append((array.dtype, pieces))
            declared_arrays.append(
                call.arrays.add(name=array.name, dtype=array.dtype, shape=array.shape)
            )
    places, parts = store(contents)
    for array, place in zip(declared_arrays, places, strict=True):
        array.offset = place.offset
        array.single = place.single
        if place.base is not None:
            array.differs = True
            array.base = place.base
            array.base_single = place.base_single
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
    is_read: Callable[[CallKind], bool] | None = None,
) -> list[Run]:
    """Read an `embodichain.Steps` message; every length, index and shape in it is checked.

    Args:
        data: The message.
        num_envs: N of the log.
        moved: Number of columns that physics writes.
        nstate: Number of columns of a full row.
        is_read: Whether a call is read; None reads all. A ``step`` that is not read is kept without
            arrays.

    Returns:
        Its steps, grouped by the calls that are read; most arrays share the message's bytes.

    Raises:
        DamageError: If the message has no valid control steps of this log.
    """
    message = _split(memoryview(data))
    first = message.first
    count = message.count
    num_calls = count * len(message.calls)
    if not 0 < count <= MOST_STEPS or first >= 2**62 or num_calls > MOST_CALLS:
        raise DamageError(f"a message of {count} control steps from step {first}")
    calls: list[Call] = []
    happens = np.ones((count, len(message.calls)), np.bool_)
    for serialized in message.calls:
        # A write to many columns may be long, and not come again: it would fill the cache.
        is_short = len(serialized) < _LARGEST_CACHED
        parse_call = _parse_call if is_short else _parse_call.__wrapped__
        declaration = parse_call(serialized, num_envs, moved, nstate)
        kind = declaration.kind
        reads_call = is_read is None or is_read(kind)
        if not reads_call and kind.kind != "step":
            continue
        error = declaration.error or _steps_error(declaration.steps, count)
        if error:
            raise DamageError(f"step {first}: {error}")
        if declaration.steps:
            happens[:, len(calls)] = False
            happens[declaration.steps, len(calls)] = True
        arrays = {}
        if reads_call:
            num_steps = len(declaration.steps) or count
            for array, place in zip(kind.arrays, declaration.places, strict=True):
                name = array.name
                shape = (num_steps, *array.shape)
                values = load(name, array.dtype, shape, place, message.data)
                if name in _ID_ARRAYS and not _are_ascending(values, num_envs):
                    raise DamageError(f"step {first}: {name} are not environments of this log")
                arrays[name] = values
        calls.append(Call(kind, arrays))
    return list(_runs(first, calls, happens[:, : len(calls)]))


def _steps_error(steps: Sequence[int], count: int) -> str:
    """The error in the steps that a call lists; empty if there is none."""
    if not steps:
        return ""
    is_ascending = all(step < following for step, following in pairwise(steps))
    if is_ascending and steps[-1] < count:
        return ""
    return f"a call is in steps {steps}"


def _runs(first: int, calls: Sequence[Call], happens: NDArray[np.bool_]) -> Iterator[Run]:
    """Split a message into runs; `happens` is (count, calls)."""
    count = len(happens)
    changes = np.flatnonzero((happens[1:] != happens[:-1]).any(axis=1)) + 1
    if not len(changes) and happens[:1].all():
        yield Run(first, count, list(calls))
        return
    # A call's arrays have a row for each step in which it happens, and none for the others.
    rows_read = [0] * len(calls)
    for begin, end in pairwise([0, *changes.tolist(), count]):
        run_calls = []
        for i in np.flatnonzero(happens[begin]).tolist():
            rows = slice(rows_read[i], rows_read[i] + end - begin)
            rows_read[i] = rows.stop
            arrays = {name: values[rows] for name, values in calls[i].arrays.items()}
            run_calls.append(Call(calls[i].kind, arrays))
        yield Run(first + begin, end - begin, run_calls)


@dataclass(slots=True)
class _StepsMessage:
    """The fields of a serialized `embodichain.Steps`.

    Attributes:
        first: Number of the first control step.
        count: Number of control steps.
        calls: Each a serialized `embodichain.Call`.
        data: The bytes of all arrays.
    """

    first: int
    count: int
    calls: list[bytes]
    data: memoryview


def _split(message: memoryview) -> _StepsMessage:
    """Read the fields of a serialized `embodichain.Steps`.

    Unlike protobuf, this does not copy the arrays.
    """
    numbers = {_FIRST: 0, _COUNT: 0}
    calls: list[bytes] = []
    data = message[:0]
    position = 0
    while position < len(message):
        key, position = _read_varint(message, position)
        value, position = _read_varint(message, position)
        if key in numbers:
            numbers[key] = value
            continue
        if key not in (_CALLS, _DATA) or value > len(message) - position:
            raise DamageError("a message of control steps is damaged: it has an unknown field")
        content = message[position : position + value]
        position += value
        if key == _CALLS:
            calls.append(bytes(content))
        else:
            data = content
    return _StepsMessage(first=numbers[_FIRST], count=numbers[_COUNT], calls=calls, data=data)


def _read_varint(data: memoryview, position: int) -> tuple[int, int]:
    """Read a number of protobuf's, and return it and the position after it."""
    value = 0
    for index, byte in enumerate(data[position : position + 10]):
        value |= (byte & 0x7F) << 7 * index
        if byte < 0x80:
            return value, position + index + 1
    raise DamageError("a message of control steps is damaged: it is cut short")


class _Declaration(NamedTuple):
    """A parsed `embodichain.Call`.

    Attributes:
        kind: Its kind.
        places: Where its arrays are.
        steps: The steps in which it happens; empty if in all of them.
        error: What is wrong with it; empty if nothing is.
    """

    kind: CallKind
    places: tuple[Place, ...]
    steps: tuple[int, ...]
    error: str


@lru_cache(maxsize=1024)
def _parse_call(data: bytes, num_envs: int, moved: int, nstate: int) -> _Declaration:
    """Parse a serialized `embodichain.Call`.

    An error in it is returned, not raised: it does not matter in a call that is not read.
    """
    try:
        call = message_class("Call").FromString(data)
    except DecodeError as error:
        raise DamageError(f"a message of control steps is damaged: {error}") from error
    kind = CallKind(
        kind=call.kind,
        name=call.name,
        mode=call.mode,
        nstep=call.nstep,
        columns=tuple(call.columns) if call.some_columns else None,
        arrays=tuple(ArrayKind(a.name, a.dtype, tuple(a.shape)) for a in call.arrays),
    )
    places = tuple(
        Place(
            offset=array.offset,
            single=array.single,
            base=array.base if array.differs else None,
            base_single=array.base_single,
        )
        for array in call.arrays
    )
    return _Declaration(
        kind=kind,
        places=places,
        steps=tuple(call.steps),
        error=_kind_error(kind, num_envs, moved, nstate),
    )


_Type = tuple[str, tuple[int, ...]]
"""dtype and shape of an array."""


def _kind_error(kind: CallKind, num_envs: int, moved: int, nstate: int) -> str:
    """What is wrong with a call: see the table above. Empty if nothing is."""
    label = f"{kind.kind} {kind.name}".rstrip()
    if kind.kind not in _KINDS:
        return f"unknown call {kind.kind!r}"
    types: dict[str, _Type] = {}
    for array in kind.arrays:
        if array.name in types:
            return f"{label} has an array twice"
        if array.dtype not in DTYPES or len(array.shape) > 8:
            return f"{label} has an array of unknown type, {array.dtype!r}"
        if array.name in _ID_ARRAYS and (array.dtype != "<i8" or len(array.shape) != 1):
            return f"{label}: {array.name} are not environments"
        types[array.name] = (array.dtype, array.shape)
    ids_type = types.pop("env_ids", None)
    num_ids = num_envs if ids_type is None else ids_type[1][0]
    if kind.kind == "write":
        return _write_error(kind, types, num_ids, nstate)
    if kind.kind == "physics":
        return _physics_error(kind, types, num_ids, moved)
    if kind.kind == "step":
        return _step_error(types, num_ids)
    if kind.kind == "start":
        return _start_error(types, num_envs, nstate)
    for name, (dtype, _) in types.items():
        if not name.startswith(DRAWN) or dtype != "<f8":
            return f"{label} has arrays that are not draws"
    return ""


def _write_error(kind: CallKind, types: Mapping[str, _Type], num_ids: int, nstate: int) -> str:
    if kind.mode not in _HAS_VALUES:
        return f"unknown operation {kind.mode!r}"
    if not _HAS_VALUES[kind.mode]:
        if types or kind.columns is not None:
            return f"{kind.mode} has values"
        return ""
    dtype, shape = types.get("values", ("", ()))
    if len(types) != 1 or dtype != "<f8" or len(shape) != 2 or shape[0] != num_ids:
        return f"a write to {kind.name!r} lacks values"
    width = shape[1]
    if kind.mode == "reset" and (kind.columns is not None or width != nstate):
        return "a reset lacks whole rows"
    if kind.columns is not None and len(kind.columns) != width:
        return f"a write to {kind.name!r} has other columns than values"
    return ""


def _physics_error(kind: CallKind, types: Mapping[str, _Type], num_ids: int, moved: int) -> str:
    if kind.nstep > MOST_PHYSICS_STEPS:
        return f"{kind.nstep} physics steps at once"
    results = {name: array_type for name, array_type in types.items() if name != "failed"}
    if results not in ({"rows": ("<f8", (num_ids, moved))}, {"hashes": ("<u8", (num_ids,))}):
        return "physics has no result of these environments"
    return ""


def _step_error(types: Mapping[str, _Type], num_ids: int) -> str:
    _, action_shape = types.get("action", ("", ()))
    expected = {
        "action": ("<f8", (num_ids, *action_shape[1:])),
        "reward": ("<f4", (num_ids,)),
        "terminated": ("|b1", (num_ids,)),
        "truncated": ("|b1", (num_ids,)),
        "episode_ids": ("<i8", (num_ids,)),
    }
    if len(action_shape) != 2 or types != expected:
        return "a step lacks actions, rewards or flags"
    return ""


def _start_error(types: Mapping[str, _Type], num_envs: int, nstate: int) -> str:
    if types.get("row") != ("<f8", (num_envs, nstate)):
        return "a start lacks whole rows"
    for dtype, shape in types.values():
        if dtype != "<f8" or len(shape) != 2 or shape[0] != num_envs:
            return "a start has model fields that are not of every environment"
    return ""


def _are_ascending(ids: NDArray[Any], num_envs: int) -> bool:
    """Whether each of the (count, n) rows has valid environment indices in ascending order."""
    if not ids.size:
        return True
    if int(ids[:, 0].min()) < 0 or int(ids[:, -1].max()) >= num_envs:
        return False
    return bool((ids[:, 1:] > ids[:, :-1]).all())

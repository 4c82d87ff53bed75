"""Bytes of our own messages, and back.

Encoders return parts (bytes and arrays) that are copied into a chunk: nothing is copied twice
before. `schemas` declares the fields; tests hold both together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.observers import EventRecord
from embodichain.lab.sim.engine.base import F64, EnvIndex
from embodichain.recording import wire
from embodichain.recording.mcap_file import Part

__all__ = [
    "START",
    "Calls",
    "State",
    "StepOutcome",
    "WriteRecord",
    "drawn_head",
    "encode_call",
    "encode_event",
    "encode_state",
    "encode_step",
    "encode_write",
    "event_head",
    "is_start",
    "shape_head",
    "stamp",
    "step_heads",
    "write_head",
]


_F8, _I8 = np.dtype("<f8"), np.dtype("<i8")
_BOOL = np.dtype(np.bool_)

START = "start"
"""Phase of what a file begins with."""


@dataclass(frozen=True, slots=True)
class Calls:
    """A physics call: its number, where it ran, and the hash of what it returned."""

    step: int
    call: int
    env_ids: EnvIndex | None
    hashes: NDArray[np.uint64]
    failed: EnvIndex | None

    @classmethod
    def decode(cls, data: bytes | memoryview) -> Calls:
        """Read a `PhysicsCall`."""
        f = wire.parse(data)
        ids, hashes = _ids(f, 3), wire.unpack(f, 4, "<u8")
        if ids is not None and len(hashes) not in (0, len(ids)):
            raise wire.WireError(f"{len(hashes)} hashes of {len(ids)} environments")
        return cls(_uint(f, 1), _uint(f, 2), ids, hashes, _ids(f, 5))


@dataclass(frozen=True, slots=True)
class State:
    """A decoded `BatchedState`; `rows` is (n, width) and shares the message's bytes."""

    step: int
    call: int
    nstep: int
    env_ids: EnvIndex | None
    rows: F64

    @classmethod
    def decode(cls, data: bytes | memoryview) -> State:
        """Read a `BatchedState`.

        Raises:
            WireError: If the bytes are not one.
        """
        f = wire.parse(data)
        flat, n, width = wire.unpack(f, 4, "<f8"), _uint(f, 2), _uint(f, 3)
        if flat.size != n * width:
            raise wire.WireError(f"{flat.size} numbers where {n} rows of {width} were announced")
        return cls(_uint(f, 1), _uint(f, 5), _uint(f, 6), _ids(f, 7), flat.reshape(n, width))


@dataclass(frozen=True, slots=True)
class StepOutcome:
    """A decoded `Step`."""

    step: int
    action: F64
    reward: F64
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    episode_ids: NDArray[np.int64]
    physics: Calls

    @classmethod
    def decode(cls, data: bytes | memoryview) -> StepOutcome:
        """Read a `Step`.

        Raises:
            WireError: If the bytes are not one.
        """
        f = wire.parse(data)
        step, n, width = _uint(f, 1), _uint(f, 3), _uint(f, 4)
        action = wire.unpack(f, 5, "<f8")
        if action.size != n * width:
            raise wire.WireError(f"{action.size} numbers where {n} actions of {width} are")
        calls = Calls(step, _uint(f, 2), None, wire.unpack(f, 10, "<u8"), _ids(f, 11))
        reward, ids = wire.unpack(f, 6, "<f8"), wire.unpack(f, 9, "<i8")
        terminated, truncated = wire.unpack(f, 7, "?"), wire.unpack(f, 8, "?")
        sizes = {len(reward), len(terminated), len(truncated), len(ids)}
        if sizes != {n} or len(calls.hashes) not in (0, n):
            raise wire.WireError(f"a step of {n} environments lacks some of them")
        return cls(step, action.reshape(n, width), reward, terminated, truncated, ids, calls)


@dataclass(frozen=True, slots=True)
class WriteRecord:
    """A decoded `Write`; `values` is flat, (n * k,)."""

    step: int
    call: int
    phase: str
    op: str
    field: str
    env_ids: EnvIndex | None
    columns: NDArray[np.int64] | slice
    values: F64

    @classmethod
    def decode(cls, data: bytes | memoryview) -> WriteRecord:
        """Read a `Write`."""
        f = wire.parse(data)
        columns = wire.unpack(f, 7, "<u4")
        return cls(
            _uint(f, 1),
            _uint(f, 2),
            _text(f, 3),
            _text(f, 4),
            _text(f, 5),
            _ids(f, 6),
            columns.astype(np.int64) if columns.size else slice(None),
            wire.unpack(f, 8, "<f8"),
        )


def _uint(fields: wire.Fields, number: int) -> int:
    values = fields.get(number)
    if not values:
        return 0
    if not isinstance(values[-1], int):
        raise wire.WireError(f"field {number} is not an integer")
    return values[-1]


def _text(fields: wire.Fields, number: int) -> str:
    values = fields.get(number)
    if not values:
        return ""
    if not isinstance(values[-1], memoryview):
        raise wire.WireError(f"field {number} is not a text")
    try:
        return bytes(values[-1]).decode()
    except UnicodeDecodeError as error:
        raise wire.WireError(f"field {number} is not a text: {error}") from error


def _ids(fields: wire.Fields, number: int) -> EnvIndex | None:
    ids = wire.unpack(fields, number, "<u4").astype(np.int64)
    if (np.diff(ids) <= 0).any():
        raise wire.WireError(f"field {number} does not name environments in ascending order")
    return ids if ids.size else None


def _env_ids(field: int, ids: EnvIndex | None) -> bytes:
    return b"" if ids is None else wire.array(field, ids, "<u4")


def stamp(step: int, call: int) -> bytes:
    """What `Step`, `PhysicsCall`, `Write` and `Event` begin with."""
    return wire.uint(1, step) + wire.uint(2, call)


@lru_cache(maxsize=64)
def shape_head(n: int, width: int) -> bytes:
    """What precedes the (n, width) rows of a `BatchedState`, after its step."""
    return wire.uint(2, n) + wire.uint(3, width) + wire.packed(4, 8 * n * width)


def encode_state(
    step: int, rows: F64 | None, call: int, nstep: int, env_ids: EnvIndex | None
) -> tuple[Part, ...]:
    """`BatchedState` of contiguous (n, width) rows, which are not copied.

    Without rows it only says that physics is called here: see keyframes in `state_log`.
    """
    tail = wire.uint(5, call) + wire.uint(6, nstep) + _env_ids(7, env_ids)
    if rows is None:
        return (wire.uint(1, step) + tail,)
    return wire.uint(1, step) + shape_head(*rows.shape), rows, tail


@lru_cache(maxsize=64)
def step_heads(n: int, width: int) -> tuple[bytes, ...]:
    """What precedes each array of a `Step`."""
    first = wire.uint(3, n) + wire.uint(4, width) + wire.packed(5, 8 * n * width)
    sizes = ((6, 8 * n), (7, n), (8, n), (9, 8 * n), (10, 8 * n))
    return (first, *(wire.packed(field, size) for field, size in sizes))


def encode_step(
    step: int,
    action: F64,
    reward: NDArray[Any],
    terminated: NDArray[np.bool_],
    truncated: NDArray[np.bool_],
    episode_ids: NDArray[np.int64],
    physics: Calls | None,
) -> tuple[Part, ...]:
    """`Step`: what went in and came out of one control step."""
    n = len(reward)
    actions, rewards, terms, truncs, ids, hashes = step_heads(n, action.size // n)
    parts: list[Part] = [
        stamp(step, physics.call if physics else 0) + actions,
        np.ascontiguousarray(action, _F8),
        rewards,
        np.ascontiguousarray(reward, _F8),
        terms,
        np.ascontiguousarray(terminated, _BOOL),
        truncs,
        np.ascontiguousarray(truncated, _BOOL),
        ids,
        np.ascontiguousarray(episode_ids, _I8),
    ]
    if physics is not None:
        parts += [hashes, physics.hashes]
        if physics.failed is not None:
            parts.append(_env_ids(11, physics.failed))
    return tuple(parts)


def encode_call(call: Calls) -> tuple[Part, ...]:
    """`PhysicsCall`: one that is not its control step's own."""
    return (
        stamp(call.step, call.call) + _env_ids(3, call.env_ids),
        wire.array(4, call.hashes, "<u8") + _env_ids(5, call.failed),
    )


def write_head(
    phase: str, op: str, field: str, columns: NDArray[np.int64] | None
) -> tuple[bytes, bytes]:
    """What stays the same in every `Write` to the same place: before and after the environments.

    Args:
        phase: ``start``, ``before_physics`` or ``after_physics``.
        op: As in `Write`.
        field: As in `Write`.
        columns: (k,) columns; None is all of them.
    """
    before = wire.text(3, phase) + wire.text(4, op) + wire.text(5, field)
    return before, b"" if columns is None else wire.array(7, columns, "<u4")


def is_start(data: bytes | memoryview) -> bool:
    """Whether a `Write` only says what the simulation was when its file began.

    Raises:
        WireError: If the bytes are no message.
    """
    return _text(wire.parse(data), 3) == START


def encode_write(
    when: bytes, head: tuple[bytes, bytes], env_ids: EnvIndex | None, values: F64 | None
) -> tuple[Part, ...]:
    """`Write`, with its `stamp` and `write_head`. Contiguous values are not copied."""
    start = when + head[0] + _env_ids(6, env_ids) + head[1]
    if values is None:
        return (start,)
    data = np.ascontiguousarray(values, _F8)
    return start + wire.packed(8, data.nbytes), data


def encode_event(when: bytes, event: EventRecord) -> tuple[Part, ...]:
    """`Event`, with its `stamp`: a term, where it fired, and what it drew."""
    start = when + event_head(event.term, event.mode) + _env_ids(5, event.env_ids)
    parts: list[Part] = [start]
    for name, drawn in event.drawn.items():
        values = np.ascontiguousarray(drawn, _F8)
        parts += [drawn_head(name, values.shape), values]
    return tuple(parts)


@lru_cache(maxsize=256)
def event_head(term: str, mode: str) -> bytes:
    """What follows the `stamp` of an `Event`."""
    return wire.text(3, term) + wire.text(4, mode)


@lru_cache(maxsize=256)
def drawn_head(name: str, shape: tuple[int, ...]) -> bytes:
    """What precedes the numbers of a drawn value: its submessage up to them, with the length."""
    nbytes = 8 * math.prod(shape)
    dimensions = b"".join(map(wire.varint, shape))
    body = wire.text(1, name) + wire.text(2, dimensions) + wire.packed(3, nbytes)
    return wire.packed(6, len(body) + nbytes) + body

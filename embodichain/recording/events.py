"""Decodes `/sim/event`: which term fired where, and what it drew."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from embodichain.recording import wire

__all__ = ["LogEvent"]


@dataclass(frozen=True, slots=True)
class LogEvent:
    """A term of the event manager fired.

    Attributes:
        step: Control step.
        call: Number of the physics call that follows.
        term: The term.
        mode: ``startup``, ``reset``, ``interval``, ...
        env_ids: Where; None is everywhere.
        drawn: What it drew: name to array.
    """

    step: int
    call: int
    term: str
    mode: str
    env_ids: NDArray[np.int64] | None
    drawn: dict[str, NDArray[np.float64]]

    @classmethod
    def decode(cls, data: bytes | memoryview) -> LogEvent:
        """Read an `Event`.

        Raises:
            WireError: If the bytes are not one.
        """
        f = wire.parse(data)
        ids = wire.unpack(f, 5, "<u4")
        drawn = dict(_drawn(raw) for raw in f.get(6, []))
        return cls(
            _number(f, 1),
            _number(f, 2),
            _text(f, 3),
            _text(f, 4),
            ids.astype(np.int64) if ids.size else None,
            drawn,
        )


def _drawn(raw: object) -> tuple[str, NDArray[np.float64]]:
    if not isinstance(raw, memoryview):
        raise wire.WireError("what was drawn is not a message")
    f = wire.parse(raw)
    shape, values = wire.unpack_varints(f, 2), wire.unpack(f, 3, "<f8")
    if math.prod(shape) != values.size:
        raise wire.WireError(f"{values.size} numbers were drawn where the shape is {shape}")
    return _text(f, 1), values.reshape(shape)


def _number(fields: wire.Fields, number: int) -> int:
    value = fields.get(number, [0])[-1]
    if not isinstance(value, int):
        raise wire.WireError(f"field {number} is not an integer")
    return value


def _text(fields: wire.Fields, number: int) -> str:
    value = fields.get(number, [b""])[-1]
    try:
        return bytes(value).decode()
    except (TypeError, UnicodeDecodeError) as error:
        raise wire.WireError(f"field {number} is not text") from error

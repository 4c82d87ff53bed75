"""Decodes many `/sim/step` messages at once: of one run they have one layout.

The layout is that of `messages.encode_step`; what has another one is left to `StepOutcome`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording import wire
from embodichain.recording.messages import StepOutcome

__all__ = ["after_stamp", "decode_steps"]


def decode_steps(payloads: Sequence[memoryview]) -> dict[str, NDArray[Any]]:
    """Arrays (T, N, ...) by the attribute of `StepOutcome` they are; of at least one message.

    Raises:
        WireError: If one is no `Step`, or they have different numbers of environments or actions.
    """
    first = StepOutcome.decode(payloads[0])
    return _at_once(payloads, *first.action.shape) or _one_by_one(payloads)


def _at_once(payloads: Sequence[memoryview], n: int, width: int) -> dict[str, NDArray[Any]] | None:
    """All of them by their places in the bytes; None if one of them is laid out otherwise."""
    start = wire.uint(3, n) + wire.uint(4, width)
    fields = (
        ("action", 5, 8 * n * width, "<f8"),
        ("reward", 6, 8 * n, "<f8"),
        ("terminated", 7, n, "?"),
        ("truncated", 8, n, "?"),
        ("episode_ids", 9, 8 * n, "<i8"),
    )
    size = len(start) + sum(len(wire.packed(f, nbytes)) + nbytes for _, f, nbytes, _ in fields)
    bodies = [payload[after_stamp(payload) :][:size] for payload in payloads]
    if any(len(body) != size for body in bodies):
        return None
    table = np.frombuffer(b"".join(bodies), np.uint8).reshape(len(bodies), size)
    found: dict[str, NDArray[Any]] = {}
    head, at = start, 0
    for name, number, nbytes, dtype in fields:
        head += wire.packed(number, nbytes)
        if (table[:, at : at + len(head)] != np.frombuffer(head, np.uint8)).any():
            return None
        at += len(head)
        values = np.ascontiguousarray(table[:, at : at + nbytes]).view(dtype)
        found[name] = values.reshape(len(bodies), n, width) if name == "action" else values
        head, at = b"", at + nbytes
    return found


def after_stamp(payload: memoryview) -> int:
    """Where a message goes on after its `messages.stamp`, whose numbers are left out when 0."""
    at = 0
    for key in (0x08, 0x10):
        if at < len(payload) and payload[at] == key:
            at += 1
            while at < len(payload) and payload[at] & 0x80:
                at += 1
            at += 1
    return at


def _one_by_one(payloads: Sequence[memoryview]) -> dict[str, NDArray[Any]]:
    decoded = [StepOutcome.decode(payload) for payload in payloads]
    found: dict[str, NDArray[Any]] = {}
    for name in ("action", "reward", "terminated", "truncated", "episode_ids"):
        arrays = [getattr(step, name) for step in decoded]
        if len({a.shape for a in arrays}) > 1:
            raise wire.WireError("steps have different numbers of environments or actions")
        found[name] = np.stack(arrays)
    return found

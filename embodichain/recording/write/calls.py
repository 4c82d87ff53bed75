"""`CallEncoder`: turns writes, physics, events and control steps into calls of a log."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.observers import EventRecord, StepRecord
from embodichain.lab.sim.engine.api import Engine, PhysicsEvent, Write
from embodichain.recording.format.messages.block import DRAWN, ArrayKind, CallKind, Recorded
from embodichain.recording.format.messages.columns import Moved
from embodichain.recording.format.messages.hashing import row_hashes
from embodichain.utils.array_types import EnvIds, host_ids

__all__ = ["CallEncoder"]


class CallEncoder:
    """Encodes calls, with copied arrays, as `format.messages.block` describes them.

    Building a `CallKind` takes longer than copying a few numbers, and a simulation makes the same
    calls in every step. So each kind is built once. It is found again by a key that has whatever
    differs between two kinds of such calls: names, columns, and the shapes of arrays.

    Args:
        engine: The engine.
        moved: The columns of a row that physics writes.
        hashes: Whether results of physics are recorded as hashes of their rows.
    """

    def __init__(self, engine: Engine, moved: Moved, hashes: bool) -> None:
        self._engine = engine
        self._moved = moved
        self._hashes = hashes
        self._write_kinds: dict[tuple[object, ...], CallKind] = {}
        self._physics_kinds: dict[tuple[object, ...], CallKind] = {}
        self._event_kinds: dict[tuple[object, ...], CallKind] = {}
        self._step_kinds: dict[tuple[int, ...], CallKind] = {}  # by the shape of the actions

    def encode_write(self, write: Write) -> Recorded:
        """Encode a write outside physics; for a reset, with the resulting rows."""
        op, field, env_ids, columns, values = write
        ids = None if env_ids is None else host_ids(env_ids)
        if op == "reset":
            values = self._engine.rows if ids is None else self._engine.rows[ids]
        if isinstance(columns, slice):
            # A slice has no hash before Python 3.12.
            column_key: object = (columns.start, columns.stop, columns.step)
        else:
            column_key = columns.tobytes()
        shape = None if values is None else values.shape
        num_ids = None if ids is None else len(ids)
        key = (op, field, column_key, shape, num_ids)
        kind = self._write_kinds.get(key)
        if kind is None:
            kind = self._write_kind(write, ids, shape)
            self._write_kinds[key] = kind
        if ids is None:
            return kind, b"" if values is None else values.tobytes()
        return kind, (ids.copy(),) if values is None else (ids.copy(), values.copy())

    def _write_kind(
        self, write: Write, ids: EnvIds | None, shape: tuple[int, ...] | None
    ) -> CallKind:
        arrays = _id_arrays("env_ids", ids)
        if shape is not None:
            arrays.append(ArrayKind("values", "<f8", shape))
        return CallKind(
            kind="write",
            name=write.field,
            mode=write.op,
            columns=self._listed_columns(write),
            arrays=tuple(arrays),
        )

    def _listed_columns(self, write: Write) -> tuple[int, ...] | None:
        """The columns that a write changes; None if it changes all of them."""
        columns = write.columns
        if not isinstance(columns, slice):
            return tuple(columns.tolist())
        if write.op not in ("state", "model") or columns == slice(None):
            return None
        return tuple(range(*columns.indices(self._width_of(write))))

    def _width_of(self, write: Write) -> int:
        """Number of columns of the flattened field that is written."""
        if write.op == "state":
            if write.field == "row":
                return int(self._engine.rows.shape[1])
            columns = self._engine.component(write.field)
            return int(columns.stop - columns.start)
        value: Any = self._engine.model
        for attribute in write.field.split("."):
            value = getattr(value, attribute)
        return int(np.size(value))

    def encode_physics(self, event: PhysicsEvent) -> Recorded:
        """Encode the rows that physics steps have returned, or their hashes."""
        ids = None if event.env_ids is None else host_ids(event.env_ids)
        failed = event.failed
        rows = event.rows if ids is None else event.rows[ids]
        result: NDArray[Any] = self._moved.take(rows)
        if self._hashes:
            result = row_hashes(result)
        num_ids = None if ids is None else len(ids)
        num_failed = None if failed is None else len(failed)
        key = (event.nstep, num_ids, num_failed)
        kind = self._physics_kinds.get(key)
        if kind is None:
            kind = self._physics_kind(event, ids, result.shape)
            self._physics_kinds[key] = kind
        if ids is None and failed is None:
            return kind, (result,)
        arrays = [array for array in (ids, result, failed) if array is not None]
        return kind, tuple(np.ascontiguousarray(array) for array in arrays)

    def _physics_kind(
        self, event: PhysicsEvent, ids: EnvIds | None, shape: tuple[int, ...]
    ) -> CallKind:
        if self._hashes:
            result = ArrayKind("hashes", "<u8", shape)
        else:
            result = ArrayKind("rows", "<f8", shape)
        arrays = [
            *_id_arrays("env_ids", ids),
            result,
            *_id_arrays("failed", event.failed),
        ]
        return CallKind("physics", nstep=event.nstep, arrays=tuple(arrays))

    def encode_event(self, event: EventRecord) -> Recorded:
        """Encode that a term of the event manager fired, and the values that it drew."""
        ids = event.env_ids
        draws = [_float64_copy(values) for values in event.drawn.values()]
        shapes = tuple([values.shape for values in draws])
        num_ids = None if ids is None else len(ids)
        key = (event.term, event.mode, num_ids, *event.drawn, *shapes)
        kind = self._event_kinds.get(key)
        if kind is None:
            arrays = _id_arrays("env_ids", ids)
            for name, shape in zip(event.drawn, shapes, strict=True):
                arrays.append(ArrayKind(DRAWN + name, "<f8", shape))
            kind = CallKind("event", event.term, event.mode, arrays=tuple(arrays))
            self._event_kinds[key] = kind
        if ids is None:
            return kind, tuple(draws)
        return kind, (ids.copy(), *draws)

    def encode_step(self, step: StepRecord) -> Recorded:
        """Encode the end of a control step."""
        action = np.ascontiguousarray(step.action, np.float64)
        reward = np.ascontiguousarray(step.reward, np.float32)
        kind = self._step_kinds.get(action.shape)
        if kind is None:
            shape = reward.shape
            kinds = (
                ArrayKind("action", "<f8", action.shape),
                ArrayKind("reward", "<f4", shape),
                ArrayKind("terminated", "|b1", shape),
                ArrayKind("truncated", "|b1", shape),
                ArrayKind("episode_ids", "<i8", shape),
            )
            kind = CallKind("step", arrays=kinds)
            self._step_kinds[action.shape] = kind
        # A copy: the caller of `env.step` may write into the arrays that it received.
        arrays = (action, reward, step.terminated, step.truncated, step.episode_ids)
        return kind, b"".join([array.tobytes() for array in arrays])


def _float64_copy(values: Any) -> NDArray[np.float64]:
    if type(values) is np.ndarray and values.dtype == np.float64:
        return values.copy()  # a third of the time of the general case
    return np.array(values, np.float64, order="C")


def _id_arrays(name: str, ids: EnvIds | None) -> list[ArrayKind]:
    """The kind of an array of environment indices; an empty list if there is none."""
    if ids is None:
        return []
    return [ArrayKind(name, "<i8", ids.shape)]

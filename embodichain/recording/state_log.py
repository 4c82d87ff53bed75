"""The channels that replay reads: `/sim/state`, `step`, `physics`, `write` and `event`.

Physics calls are counted. Every one is preceded by the rows it receives (`/sim/state`) and followed
by a hash of the rows it returned. A write belongs before the call whose number it carries, so

    simulate(state of call c) = hash of call c
    result of call c, then the writes of call c + 1 = state of call c + 1

hold for every row, also when a reset event steps physics to let things settle. Normally there is
one call a control step, and its hash travels in `/sim/step`. Where rows follow from those before,
most states have only the columns that physics writes: controls and other inputs are as in the
state before, changed by the writes since. A state with inputs comes at least every `INPUTS_EVERY`
control steps, first in every file, and after whatever is no plain write to the state.

Between keyframes `/sim/state` has no rows, and only says where physics was called: writes and
calls give every row from the last keyframe on, and the hashes say whether they are right.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.observers import EventRecord
from embodichain.lab.sim.engine.base import F64, EnvIndex, Write, WriteOp
from embodichain.lab.sim.engine.model_fields import DERIVED_FIELDS
from embodichain.recording.columns import INPUTS_EVERY, Ranges
from embodichain.recording.hashing import RowHash
from embodichain.recording.known_rows import KnownRows
from embodichain.recording.mcap_file import Part
from embodichain.recording.messages import (
    START,
    Calls,
    encode_call,
    encode_event,
    encode_state,
    encode_step,
    encode_write,
    stamp,
    write_head,
)

__all__ = ["CHANNELS", "StateLog"]

CHANNELS = {
    "/sim/state": "embodichain.BatchedState",
    "/sim/step": "embodichain.Step",
    "/sim/physics": "embodichain.PhysicsCall",
    "/sim/write": "embodichain.Write",
    "/sim/event": "embodichain.Event",
}

Emit = Callable[[int, str, tuple[Part, ...]], None]
"""Takes a control step, a topic and the parts of a message."""


class StateLog:
    """Turns what an engine did into messages, in the process that writes them.

    The one that steps the simulation only copies what would change under it (`McapRecorder`).

    Args:
        model: What is recorded.
        layout: Component name to its columns within a row.
        substeps: Physics steps of an ordinary control step.
        derives: Whether rows are to be derived from calls and writes: `stepped` is called.
        emit: Called with a control step, a topic and the parts of a message.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        layout: Mapping[str, slice],
        substeps: int,
        derives: bool,
        emit: Emit,
    ) -> None:
        self._model = model
        self._layout = dict(layout)
        self._nstate: int = max(columns.stop for columns in self._layout.values())
        self._substeps = substeps
        self._emit = emit
        self._hash = RowHash(self._nstate)
        self._ranges: Ranges = [(0, self._nstate)]
        self.step = 0
        self.call = 0
        self._own: Calls | None = None  # the call whose hash `/sim/step` will carry
        self._after_physics = False
        self._stamp = stamp(0, 0)
        self._known = KnownRows(layout) if derives else None
        self._inputs_due = 0  # the control step whose state has inputs again
        self._places: dict[int, Write] = {}
        self._heads: dict[tuple[bool, int], tuple[bytes, bytes]] = {}

    def start(self, rows: F64, model_fields: Mapping[str, NDArray[Any]]) -> None:
        """Write what the simulation is before anything happens: model fields, then whole `rows`.

        Constants that MuJoCo derives are written as they are; `set_const` before them sets what
        follows from the fields and is none itself.
        """
        self._inputs_due = self.step
        for again in range(2 if DERIVED_FIELDS & model_fields.keys() else 1):
            if again:
                self._write("set_const", "", None)
            for field, values in model_fields.items():
                self._write("model", field, np.asarray(values, np.float64))
        self._write("state", "row", rows)

    def _write(self, op: str, field: str, values: NDArray[np.float64] | None) -> None:
        head = write_head(START, op, field, None)
        self._emit(self.step, "/sim/write", encode_write(self._stamp, head, None, values))

    def place(
        self, number: int, op: WriteOp, field: str, columns: NDArray[np.int64] | slice
    ) -> None:
        """Remember what writes with this number write, and where: the attributes of a `Write`."""
        kept = columns if isinstance(columns, slice) else columns.copy()
        self._places[number] = Write(op, field, None, kept, None)

    def place_of(self, number: int) -> Write:
        """What writes with this number write, and where."""
        return self._places[number]

    def on_write(self, place: int, env_ids: EnvIndex | None, values: F64 | None) -> None:
        """A write outside physics, to a place that was told."""
        head = self._head(self._after_physics, place, values is not None)
        self._emit(self.step, "/sim/write", encode_write(self._stamp, head, env_ids, values))
        if self._known is not None and values is not None:
            self._known.write(place, self._places[place], env_ids, values)

    def _head(self, after_physics: bool, place: int, values: bool) -> tuple[bytes, bytes]:
        """The `write_head` of writes to a place."""
        key = after_physics, place
        head = self._heads.get(key)
        if head is None:
            phase = "after_physics" if after_physics else "before_physics"
            write = self._places[place]
            columns = self._columns(write) if values else None
            head = self._heads[key] = write_head(phase, write.op, write.field, columns)
        return head

    def _columns(self, write: Write) -> NDArray[np.int64] | None:
        """Columns as indices; None for all of them."""
        if not isinstance(write.columns, slice):
            return write.columns
        if write.columns == slice(None):
            return None
        every: NDArray[np.int64] = np.arange(self._width_of(write), dtype=np.int64)
        return every[write.columns]

    def _width_of(self, write: Write) -> int:
        if write.op == "model":
            owner: Any = self._model
            *path, name = write.field.split(".")
            for part in path:
                owner = getattr(owner, part)
            return int(np.size(getattr(owner, name)))
        if write.field == "row":
            return self._nstate
        columns = self._layout[write.field]
        width: int = columns.stop - columns.start
        return width

    def before_physics(self, nstep: int, ids: EnvIndex | None, taken: F64 | None) -> None:
        """A call is about to begin, with these rows (n, width); None between keyframes."""
        self._emit(self.step, "/sim/state", encode_state(self.step, taken, self.call, nstep, ids))
        if self._known is not None and taken is not None and ids is None:
            self._known.take(taken)
            self._inputs_due = self.step + INPUTS_EVERY

    def stepped(
        self, nstep: int, ids: EnvIndex | None, failed: EnvIndex | None, taken: F64
    ) -> None:
        """A call began with the rows that calls and writes so far had left, and returned these.

        Nobody has to copy the former for that. Were something changed that no write told, physics
        would return other rows than those give, and the hashes would show it.

        Args:
            nstep: Physics steps of the call.
            ids: (n,) environments that stepped; None is all.
            failed: Environments in which the engine raised.
            taken: (n, width) rows; of all environments only the columns that physics may write.

        Raises:
            RuntimeError: If rows are not to be derived, or are not known.
        """
        known = self._known
        if known is None:
            raise RuntimeError("rows are not derived in this log")
        if ids is not None:
            rows = known.whole()[ids]
        elif self.step < self._inputs_due:
            rows = known.moved
        else:
            rows, self._inputs_due = known.whole(), self.step + INPUTS_EVERY
        self._emit(self.step, "/sim/state", encode_state(self.step, rows, self.call, nstep, ids))
        if ids is None:
            known.returned(taken)
            self._returned(nstep, ids, failed, known.hashes(self._hash))
        else:
            self.after_physics(nstep, ids, failed, taken)

    def rows_of(self, ids: NDArray[np.int64]) -> F64:
        """(n, nstate) rows of some environments, as calls and writes so far have left them.

        Raises:
            RuntimeError: If rows are not to be derived, or are not known.
        """
        if self._known is None:
            raise RuntimeError("rows are not derived in this log")
        return self._known.of(ids)

    def settle(self) -> None:
        """Copy what is not this log's own: the memory of arrays that were handed over goes."""
        if self._known is not None:
            self._known.settle()

    def columns(self, ranges: Ranges) -> None:
        """From here on these columns of rows are handed over."""
        self._ranges = ranges
        if self._known is not None:
            self._known.columns(ranges)
            self._inputs_due = self.step

    def after_physics(
        self, nstep: int, ids: EnvIndex | None, failed: EnvIndex | None, taken: F64
    ) -> None:
        """A call has returned these rows (n, width): hash them."""
        if self._known is not None:
            if ids is None:
                self._known.take(taken)
            else:
                self._known.returned_some(ids, taken)
        self._returned(nstep, ids, failed, self._hash.of_columns(taken, self._ranges))

    def _returned(
        self,
        nstep: int,
        ids: EnvIndex | None,
        failed: EnvIndex | None,
        hashes: NDArray[np.uint64],
    ) -> None:
        done = Calls(self.step, self.call, ids, hashes, failed)
        self.call += 1
        self._stamp = stamp(self.step, self.call)
        self._after_physics = True
        if self._own is None and ids is None and nstep == self._substeps:
            self._own = done
        else:
            self._emit(self.step, "/sim/physics", encode_call(done))

    def on_event(
        self, term: str, mode: str, env_ids: EnvIndex | None, drawn: Mapping[str, NDArray[Any]]
    ) -> None:
        """A term of the event manager fired: the attributes of an `EventRecord`."""
        event = EventRecord(term, mode, env_ids, drawn)
        self._emit(self.step, "/sim/event", encode_event(self._stamp, event))

    def on_step(
        self,
        action: F64,
        reward: NDArray[Any],
        terminated: NDArray[np.bool_],
        truncated: NDArray[np.bool_],
        episode_ids: NDArray[np.int64],
    ) -> None:
        """A control step ended."""
        parts = encode_step(
            self.step, action, reward, terminated, truncated, episode_ids, self._own
        )
        self._emit(self.step, "/sim/step", parts)
        self.skip()

    def skip(self) -> None:
        """A control step is over."""
        self._own = None
        self._after_physics = False
        self.step += 1
        self._stamp = stamp(self.step, self.call)

    def close(self, taken: F64) -> None:
        """Write the last rows; a step that was left in the middle keeps its hash."""
        if self._own is not None:
            self._emit(self.step, "/sim/physics", encode_call(self._own))
            self._own = None
        self._emit(self.step, "/sim/state", encode_state(self.step, taken, self.call, 0, None))

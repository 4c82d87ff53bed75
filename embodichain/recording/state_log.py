"""The channels that replay reads: `/sim/state`, `step`, `physics`, `write` and `event`.

Physics calls are counted. Every one is preceded by the rows it receives (`/sim/state`) and followed
by a hash of the rows it returned. A write belongs before the call whose number it carries, so

    simulate(state of call c) = hash of call c
    result of call c, then the writes of call c + 1 = state of call c + 1

hold for every row, also when a reset event steps physics to let things settle. Normally there is
one call a control step, and its hash travels in `/sim/step`.

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
from embodichain.recording.hashing import RowHash
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
Ranges = list[tuple[int, int]]


class StateLog:
    """Turns what an engine did into messages, in the process that writes them.

    The one that steps the simulation only copies what would change under it (`McapRecorder`).

    Args:
        model: What is recorded.
        layout: Component name to its columns within a row.
        substeps: Physics steps of an ordinary control step.
        emit: Called with a control step, a topic and the parts of a message.
    """

    def __init__(
        self, model: mujoco.MjModel, layout: Mapping[str, slice], substeps: int, emit: Emit
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
        self._rows: F64 | None = None  # (N, nstate) as they are, as far as that is known
        self._places: dict[int, Write] = {}
        self._heads: dict[tuple[bool, int], tuple[bytes, bytes]] = {}

    def start(self, rows: F64, model_fields: Mapping[str, NDArray[Any]]) -> None:
        """Write what the simulation is before anything happens: model fields, then whole `rows`.

        Constants that MuJoCo derives are written as they are; `set_const` before them sets what
        follows from the fields and is none itself.
        """
        for again in range(2 if DERIVED_FIELDS & model_fields.keys() else 1):
            if again:
                self._write("set_const", "", None)
            for field, values in model_fields.items():
                self._write("model", field, np.asarray(values, np.float64))
        self._write("state", "row", rows)
        self._rows = rows.copy()

    def _write(self, op: str, field: str, values: NDArray[np.float64] | None) -> None:
        head = write_head(START, op, field, None)
        self._emit(self.step, "/sim/write", encode_write(self._stamp, head, None, values))

    def place(
        self, number: int, op: WriteOp, field: str, columns: NDArray[np.int64] | slice
    ) -> None:
        """Remember what writes with this number write, and where: the attributes of a `Write`."""
        kept = columns if isinstance(columns, slice) else columns.copy()
        self._places[number] = Write(op, field, None, kept, None)

    def on_write(self, place: int, env_ids: EnvIndex | None, values: F64 | None) -> None:
        """A write outside physics, to a place that was told."""
        key = self._after_physics, place
        head = self._heads.get(key)
        if head is None:
            phase = "after_physics" if self._after_physics else "before_physics"
            write = self._places[place]
            columns = None if values is None else self._columns(write)
            head = self._heads[key] = write_head(phase, write.op, write.field, columns)
        self._emit(self.step, "/sim/write", encode_write(self._stamp, head, env_ids, values))
        write = self._places[place]
        if self._rows is not None and write.op == "state" and write.field != "row":
            component = self._rows[:, self._layout[write.field]]
            if env_ids is None:
                component[:, write.columns] = values
            elif isinstance(write.columns, slice):
                component[env_ids, write.columns] = values
            else:
                component[env_ids[:, None], write.columns] = values

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

    def before_physics(self, taken: F64 | None, nstep: int, ids: EnvIndex | None) -> None:
        """A call is about to begin, with these rows (n, width); None between keyframes."""
        self._emit(self.step, "/sim/state", encode_state(self.step, taken, self.call, nstep, ids))
        if taken is not None:
            self._keep(taken, ids)

    def as_written(self, nstep: int, ids: EnvIndex | None) -> None:
        """A call is about to begin, with the rows that calls and writes so far have left.

        Nobody has to copy them for that. Were something changed that no write told, physics would
        return other rows than these give, and the hashes would show it.

        Raises:
            RuntimeError: If the rows are not known.
        """
        if self._rows is None:
            raise RuntimeError("rows were not told before they are needed")
        rows = self._rows if ids is None else self._rows[ids]
        taken = np.concatenate([rows[:, start:stop] for start, stop in self._ranges], axis=1)
        self._emit(self.step, "/sim/state", encode_state(self.step, taken, self.call, nstep, ids))

    def _keep(self, taken: F64, ids: EnvIndex | None) -> None:
        """Remember rows (n, width)."""
        if self._rows is None:
            return
        at = 0
        for start, stop in self._ranges:
            part = taken[:, at : at + stop - start]
            if ids is None:
                self._rows[:, start:stop] = part
            else:
                self._rows[ids, start:stop] = part
            at += stop - start

    def columns(self, ranges: Ranges) -> None:
        """From here on these columns of rows are handed over, as half-open ranges."""
        self._ranges = ranges

    def after_physics(
        self, taken: F64, nstep: int, ids: EnvIndex | None, failed: EnvIndex | None
    ) -> None:
        """A call has returned these rows (n, width): hash them."""
        hashes = self._hash.of_columns(taken, self._ranges)
        self._keep(taken, ids)
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

"""States between the keyframes of a log, simulated again: the log as if all had been written.

Only what the file says is used; every hash in it is compared on the way, so what comes out is what
was recorded, or an error.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from embodichain.lab.sim.engine.base import EnvIndex
from embodichain.recording.chunks import ChunkFile, ChunkPlace, Found
from embodichain.recording.columns import RowColumns
from embodichain.recording.header import Header, LogError
from embodichain.recording.messages import State, WriteRecord, encode_state
from embodichain.recording.recorded_model import exact_model
from embodichain.recording.resimulate import Found as Difference
from embodichain.recording.resimulate import Resimulation
from embodichain.recording.wire import WireError
from embodichain.recording.with_inputs import blocks_with_inputs

__all__ = ["FilledFile"]


class FilledFile:
    """A log whose `/sim/state` has whole rows in every control step.

    Of a log that was recorded with `state: all` nothing is simulated.

    Args:
        file: The log; it knows of damage that is met.
        only: (n,) environments to simulate; the rows of others are NaN. None is all.

    Attributes:
        path: Where the log begins.
    """

    def __init__(self, file: ChunkFile, only: EnvIndex | None = None) -> None:
        self.path = file.path
        self._only = only
        self._file = file
        self.require_header, self.between = file.require_header, file.between

    def messages(self) -> Iterator[Found]:
        """All messages, in file order.

        Raises:
            LogError: If the log does not simulate to what it says.
        """
        file = self._file
        simulated = file.require_header().keyframe_every > 0
        for found in self.blocks(file.chunks) if simulated else blocks_with_inputs(file):
            yield from found

    def blocks(self, chunks: list[ChunkPlace]) -> Iterator[list[Found]]:
        """Messages of some chunks of a log with keyframes, a list for each.

        Raises:
            LogError: If the log does not simulate to what it says.
        """
        if not chunks:
            return
        file, every = self._file, self._file.chunks
        begins = every.index(chunks[0])
        filler = _Filler(file, self._only, chunks[0].start_ns)
        for number, found in enumerate(file.blocks(every[: every.index(chunks[-1]) + 1])):
            try:
                filled = filler.fill(found)
            except Difference as other:
                where = f"{self.path} does not simulate to what it says"
                raise LogError(f"{where}: {other.difference}") from other
            except WireError as error:
                raise LogError(f"{self.path}: a message is damaged: {error}") from error
            if number >= begins:
                yield filled


class _Filler:
    """Follows the messages from the last keyframe before what is wanted.

    Args:
        file: The log.
        only: Environments to simulate; None is all.
        start_ns: Log time of what is wanted first.
    """

    def __init__(self, file: ChunkFile, only: EnvIndex | None, start_ns: int) -> None:
        header = self._header = file.require_header()
        self._ids = np.arange(header.num_envs, dtype=np.int64) if only is None else only
        mask = np.ones(len(self._ids), np.bool_)
        model = _model(file, header)
        self._simulation = Resimulation(header, model, self._ids, lambda step: mask)
        self._columns = RowColumns(header.slices())
        step = (start_ns - header.start_ns) // header.period_ns
        self._key = step // header.keyframe_every * header.keyframe_every
        self._begun = self._key <= header.first_step
        if not self._begun:
            self._simulation.lose_track()

    def fill(self, found: list[Found]) -> list[Found]:
        """The same messages, with rows."""
        return [(topic, time_ns, self._one(topic, data)) for topic, time_ns, data in found]

    def _one(self, topic: str, data: memoryview) -> memoryview:
        simulation = self._simulation
        if topic == "/sim/state":
            return self._state(data)
        if topic == "/sim/write":
            # Before the keyframe only models are followed: its rows hold everything else.
            if self._begun or WriteRecord.decode(data).op in ("model", "set_const"):
                simulation.on_write(data)
        elif self._begun and topic == "/sim/step":
            simulation.on_step(data)
        elif self._begun and topic == "/sim/physics":
            simulation.on_call(data)
        return data

    def _state(self, data: memoryview) -> memoryview:
        state = State.decode(data)
        self._begun = self._begun or (state.rows.size > 0 and state.step >= self._key)
        if not self._begun:
            return data
        filled = data if state.rows.size else self._filled(state, data)
        self._simulation.on_state(data)
        return filled

    def _filled(self, state: State, data: memoryview) -> memoryview:
        """The message with rows; as it is, where it is of some and not everybody is simulated."""
        rows, columns, n = self._simulation.rows, self._columns, self._header.num_envs
        if state.env_ids is not None:
            if len(rows) < n or int(state.env_ids[-1]) >= n:
                return data
            rows = rows[state.env_ids]
        if not columns.whole and not columns.narrow_enough(rows):
            columns.widen()
        taken = np.empty((len(rows), columns.width))
        columns.take(rows, taken)
        if state.env_ids is None and len(rows) < n:
            mine, taken = taken, np.full((n, columns.width), np.nan)
            taken[self._ids] = mine
        parts = encode_state(state.step, taken, state.call, state.nstep, state.env_ids)
        return memoryview(b"".join(parts))  # type: ignore[arg-type]  # arrays are buffers


def _model(file: ChunkFile, header: Header) -> mujoco.MjModel:
    """The recorded model.

    Raises:
        LogError: If states cannot be simulated to the bit here.
    """
    where = f"{file.path}: states between keyframes"
    if header.mujoco_version != mujoco.__version__:
        need = f"need mujoco=={header.mujoco_version}, this is {mujoco.__version__}"
        raise LogError(f"{where} {need}; keyframes can be read without simulate")
    mjb = file.attachment("model.mjb")
    try:
        return exact_model(header, mjb)
    except LogError as error:
        raise LogError(f"{where}: {error}") from error

"""States of a log with all their columns, where the file has only those that physics writes.

Controls and other inputs are taken from the state before and the writes since: see `state_log`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from embodichain.lab.sim.engine.base import F64
from embodichain.recording.chunks import ChunkFile, ChunkPlace, Found
from embodichain.recording.columns import INPUTS_EVERY
from embodichain.recording.header import Header, LogError
from embodichain.recording.known_rows import KnownRows
from embodichain.recording.messages import State, WriteRecord, encode_state
from embodichain.recording.step_block import after_stamp
from embodichain.recording.wire import WireError

__all__ = ["InputFollower", "blocks_with_inputs", "chunks_before"]

_MOST_ALIKE = 64
"""Kinds of writes that are recognized by their first bytes."""


def blocks_with_inputs(file: ChunkFile) -> Iterator[list[Found]]:
    """All messages, a list for each chunk; states of all environments with inputs.

    Raises:
        LogError: If a message is damaged.
    """
    header = file.require_header()
    follower = InputFollower(header)
    for found in file.blocks():
        try:
            filled = [(t, at, full(follower, header, t, data)) for t, at, data in found]
        except (IndexError, ValueError) as error:  # a WireError is one
            raise LogError(f"{file.path}: a message is damaged: {error}") from error
        yield filled


def chunks_before(file: ChunkFile, wanted: list[ChunkPlace]) -> list[ChunkPlace]:
    """Chunks that tell the inputs with which some others begin."""
    if not wanted:
        return []
    earlier = file.chunks[: file.chunks.index(wanted[0])]
    start = wanted[0].start_ns - INPUTS_EVERY * file.require_header().period_ns
    return earlier[next((i for i, c in enumerate(earlier) if c.end_ns >= start), len(earlier)) :]


class InputFollower:
    """Follows states and writes, in file order.

    Args:
        header: The log's metadata.

    Attributes:
        known: Whether a state with inputs was met.
    """

    def __init__(self, header: Header) -> None:
        self._header = header
        self._rows = KnownRows(header.slices())
        self._width = -1  # of the last state with inputs
        self._places: dict[tuple[str, bytes], int] = {}
        self._alike: list[tuple[bytes, int, WriteRecord]] = []
        self.known = False

    def take(self, rows: F64) -> None:
        """A state of all environments with inputs, (N, width)."""
        width = rows.shape[1]
        if width != self._width:
            self._rows, self._width = KnownRows(self._header.slices()), width
            self._rows.columns(self._header.ranges_of(width))
            self._places.clear()
            self._alike.clear()
        self._rows.take(rows)
        self.known = True

    def write(self, data: memoryview) -> None:
        """A write.

        Raises:
            WireError: If it is damaged.
            ValueError: If it does not fit; so does `IndexError`.
        """
        if not self.known:
            return
        body = data[after_stamp(data) :]
        for head, place, write in self._alike:  # most are like one before, but for the values
            if body[: len(head)] == head:
                values = np.frombuffer(body, "<f8", offset=len(head))
                self._rows.write(place, write, None, values.reshape(self._header.num_envs, -1))
                return
        write = WriteRecord.decode(data)
        if write.op != "state" or write.field == "row":
            return  # the next state has inputs
        columns = write.columns
        span = b"" if isinstance(columns, slice) else columns.tobytes()
        place = self._places.setdefault((write.field, span), len(self._places))
        n = self._header.num_envs if write.env_ids is None else len(write.env_ids)
        self._rows.write(place, write, write.env_ids, write.values.reshape(n, -1))
        size = write.values.nbytes
        if write.env_ids is None and size and len(self._alike) < _MOST_ALIKE:
            self._alike.append((bytes(body[: len(body) - size]), place, write))

    @property
    def rows(self) -> KnownRows:
        """What is known; of the rows only the inputs are kept current.

        Raises:
            WireError: If no state has told them.
        """
        if not self.known:
            raise WireError("what inputs were before is not in the file")
        return self._rows

    def filled(self, state: State) -> F64:
        """(N, width) rows of a state without inputs.

        Raises:
            WireError: If no state has told them.
        """
        self.rows.returned(state.rows)
        return self._rows.whole()


def full(follower: InputFollower, header: Header, topic: str, data: memoryview) -> memoryview:
    """The same message, a state of all environments with its inputs.

    Raises:
        WireError: If it is damaged.
        ValueError: If it does not fit; so does `IndexError`.
    """
    if topic == "/sim/write":
        follower.write(data)
    if topic != "/sim/state":
        return data
    state = State.decode(data)
    if state.env_ids is not None or not state.rows.size:
        return data
    width = state.rows.shape[1]
    header.ranges_of(width)  # complains
    if len(state.rows) != header.num_envs:
        raise WireError(f"step {state.step}: {len(state.rows)} rows")
    if header.has_inputs(width):
        follower.take(state.rows)
        return data
    parts = encode_state(state.step, follower.filled(state), state.call, state.nstep, None)
    return memoryview(b"".join(parts))  # type: ignore[arg-type]  # arrays are buffers

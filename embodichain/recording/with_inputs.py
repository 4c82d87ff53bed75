"""States of a log with all their columns, where the file has only those that physics writes.

Controls and other inputs are taken from the state before and the writes since: see `state_log`.
"""

from __future__ import annotations

from collections.abc import Iterator

from embodichain.recording.chunks import ChunkFile, ChunkPlace, Found
from embodichain.recording.columns import INPUTS_EVERY
from embodichain.recording.header import Header, LogError
from embodichain.recording.known_rows import KnownRows
from embodichain.recording.messages import State, WriteRecord, encode_state
from embodichain.recording.wire import WireError

__all__ = ["WithInputs"]


class WithInputs:
    """A log whose `/sim/state` has inputs in every message of all environments.

    Args:
        file: The log; it knows of damage that is met.

    Attributes:
        path: Where the log begins.
    """

    def __init__(self, file: ChunkFile) -> None:
        self.path = file.path
        self._file = file
        self.require_header, self.between = file.require_header, file.between

    def messages(self) -> Iterator[Found]:
        """All messages, in file order."""
        for found in self.blocks():
            yield from found

    def blocks(self, chunks: list[ChunkPlace] | None = None) -> Iterator[list[Found]]:
        """Messages of some chunks, or of all, a list for each.

        Raises:
            LogError: If a message is damaged.
        """
        file, every = self._file, self._file.chunks
        wanted = every if chunks is None else chunks
        if not wanted:
            return
        header = file.require_header()
        start = wanted[0].start_ns - INPUTS_EVERY * header.period_ns
        earlier = every[: (begins := every.index(wanted[0]))]
        first = next((i for i, chunk in enumerate(earlier) if chunk.end_ns >= start), begins)
        follower = _Follower(header)
        span = every[first : every.index(wanted[-1]) + 1]
        for number, found in enumerate(file.blocks(span), first):
            try:
                full = [(topic, at, follower.full(topic, data)) for topic, at, data in found]
            except (WireError, IndexError, KeyError, ValueError) as error:
                raise LogError(f"{self.path}: a message is damaged: {error}") from error
            if number >= begins:
                yield full


class _Follower:
    """Follows states and writes, in file order."""

    def __init__(self, header: Header) -> None:
        self._header = header
        self._rows = KnownRows(header.slices())
        self._width = -1  # of the last state with inputs; before the first there is none
        self._places: dict[tuple[str, bytes], int] = {}

    def full(self, topic: str, data: memoryview) -> memoryview:
        """The same message, a state of all environments with its inputs."""
        if topic == "/sim/state":
            return self._state(data)
        if topic == "/sim/write" and self._width >= 0:
            self._write(WriteRecord.decode(data))
        return data

    def _state(self, data: memoryview) -> memoryview:
        state, header = State.decode(data), self._header
        if state.env_ids is not None or not state.rows.size:
            return data
        if len(state.rows) != header.num_envs:
            raise WireError(f"step {state.step}: {len(state.rows)} rows")
        width = state.rows.shape[1]
        ranges = header.ranges_of(width)
        if width in (header.nstate, header.width):
            if width != self._width:
                self._rows, self._width = KnownRows(header.slices()), width
                self._rows.columns(ranges)
                self._places.clear()
            self._rows.take(state.rows)
            return data
        if self._width < 0:
            raise WireError(f"step {state.step}: what its inputs were before is not in the file")
        self._rows.returned(state.rows)
        parts = encode_state(state.step, self._rows.whole(), state.call, state.nstep, None)
        return memoryview(b"".join(parts))  # type: ignore[arg-type]  # arrays are buffers

    def _write(self, write: WriteRecord) -> None:
        if write.op != "state" or write.field == "row":
            return  # the next state has inputs
        columns = write.columns
        span = b"" if isinstance(columns, slice) else columns.tobytes()
        place = self._places.setdefault((write.field, span), len(self._places))
        n = self._header.num_envs if write.env_ids is None else len(write.env_ids)
        self._rows.write(place, write, write.env_ids, write.values.reshape(n, -1))

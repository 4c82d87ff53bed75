"""Fills arrays from the messages of a log: states by component, and what steps gave.

One copy out of a chunk while it is in the cache, one into the result; nothing is parsed number by
number.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording import wire
from embodichain.recording.arrays import LogArrays
from embodichain.recording.chunks import ChunkFile, ChunkPlace, Found
from embodichain.recording.columns import width_of
from embodichain.recording.header import Header, LogError
from embodichain.recording.known_rows import KnownRows
from embodichain.recording.mcap_file import CHUNK_LIMIT
from embodichain.recording.messages import State
from embodichain.recording.model_columns import Column
from embodichain.recording.rebuild import FilledFile
from embodichain.recording.step_block import decode_steps
from embodichain.recording.with_inputs import InputFollower, chunks_before

__all__ = ["OUTCOMES", "Gatherer", "Steps", "first_step"]

OUTCOMES = {
    "actions": "action",
    "rewards": "reward",
    "terminated": "terminated",
    "truncated": "truncated",
    "episodes": "episode_ids",
}
"""Field to the attribute of `StepOutcome` it is."""


@dataclass(frozen=True, slots=True)
class Steps:
    """Control steps [start, stop); `stop` None is the end."""

    start: int = 0
    stop: int | None = None

    def last(self) -> int:
        """The last step that may be meant."""
        return sys.maxsize if self.stop is None else self.stop - 1

    def times(self, header: Header) -> tuple[int, int]:
        """Log times of the first and the last of them."""
        start, period = header.start_ns, header.period_ns
        return start + self.start * period, start + self.last() * period


@dataclass
class _Row:
    """Where a state lies."""

    step: int
    payload: memoryview
    offset: int
    width: int
    known: KnownRows | None = None
    """What knows the inputs' columns, where they are not in it."""
    inputs: NDArray[np.float64] | None = None
    """(N, k) those inputs."""


@dataclass
class Gatherer:
    """Reads some fields of some environments and steps.

    The row of a step is the one that its physics received, after every write: the first of all
    environments with the step's number of physics steps; before the first step, where a reset may
    let things settle, the last.

    Args:
        file: The log.
        components: State components to read.
        outcomes: Keys of `OUTCOMES` to read.
        env_ids: Environments, (n,).
        span: Steps.
    """

    file: ChunkFile | FilledFile
    components: Sequence[str]
    outcomes: Sequence[str]
    env_ids: NDArray[np.int64]
    span: Steps
    values: dict[str, NDArray[Any]] = field(default_factory=dict, init=False)
    steps: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64), init=False)

    def __post_init__(self) -> None:
        self._header: Header = self.file.require_header()
        n = self._header.num_envs
        self._all = len(self.env_ids) == n and bool((self.env_ids == np.arange(n)).all())
        self._tail = wire.uint(6, self._header.substeps)
        widths = {self._header.width, self._header.nstate, width_of(self._header.moved)} - {0}
        self._heads = {
            width: wire.uint(2, n) + wire.uint(3, width) + wire.packed(4, 8 * n * width)
            for width in widths
        }
        self._ranges = {width: self._header.ranges_of(width) for width in widths}
        self._pending: _Row | None = None
        self._inputs = [name for name in self.components if not self._header.is_moved(name)]
        self._follower: InputFollower | None = None
        if self._inputs and isinstance(self.file, ChunkFile):
            self._follower = InputFollower(self._header)

    def run(self) -> None:
        """Read, and set `steps` and `values`.

        Raises:
            LogError: If the file says what cannot be.
        """
        chunks = self.file.between(*self.span.times(self._header))
        self._make(self._bound(sum(min(c.size, CHUNK_LIMIT) for c in chunks)))
        rows, outcomes = 0, 0
        state_steps = np.empty(len(self.steps), np.int64)
        try:
            for block in self._blocks(chunks):
                states, steps = self._sort(block)
                state_steps = _fit(state_steps, rows + len(states))
                state_steps[rows : rows + len(states)] = [row.step for row in states]
                self._put_states(states, rows)
                rows += len(states)
                outcomes = self._put_outcomes(steps, outcomes)
        except LogError:  # says so itself
            raise
        except (IndexError, ValueError) as error:  # a WireError is one
            raise LogError(f"{self.file.path}: a message is damaged: {error}") from error
        self._trim(state_steps[:rows], self._in_order(self.steps[:outcomes]))

    def _blocks(self, chunks: list[ChunkPlace]) -> Iterator[list[Found]]:
        """Messages of some chunks; what tells the inputs before them was followed."""
        follower, file = self._follower, self.file
        before = chunks_before(file, chunks) if follower and isinstance(file, ChunkFile) else []
        for number, block in enumerate(file.blocks(before + chunks)):
            if number >= len(before):
                yield block
            else:
                for topic, _, payload in block:
                    if topic in ("/sim/state", "/sim/write"):
                        self._follow(topic, _first_uint(payload), payload)

    def _follow(self, topic: str, step: int, payload: memoryview) -> None:
        """Take in what tells inputs."""
        if self._follower is None:
            return
        if topic == "/sim/write":
            self._follower.write(payload)
            return
        width, offset = self._place(step, payload)
        if width and self._header.has_inputs(width):
            n = self._header.num_envs
            rows = np.frombuffer(payload, "<f8", n * width, offset)
            self._follower.take(rows.reshape(n, width))

    def arrays(self, columns: Mapping[str, list[Column]]) -> LogArrays:
        """What was read, states first."""
        dtypes = {"terminated": np.bool_, "truncated": np.bool_, "episodes": np.int64}
        empty = (0, len(self.env_ids))
        for name in self.outcomes:  # of no step at all
            shape = (*empty, len(columns[name])) if name == "actions" else empty
            self.values.setdefault(name, np.empty(shape, dtypes.get(name, np.float64)))
        wanted = [*self.components, *self.outcomes]
        return LogArrays(
            self.steps,
            self.env_ids,
            self._header.control_dt,
            {name: columns[name] for name in wanted},
            {name: self.values[name] for name in wanted},
        )

    def _bound(self, size: int) -> int:
        """At most so many steps are there: by times, and by the bytes a step takes at least."""
        chunks = self.file.between(*self.span.times(self._header))
        if not chunks:
            return 0
        start, period = self._header.start_ns, self._header.period_ns
        last = min(self.span.last(), (max(c.end_ns for c in chunks) - start) // period)
        by_bytes = size // (8 * self._header.num_envs + 31) + 1
        return max(0, min(last - self.span.start + 1, by_bytes))

    def _make(self, bound: int) -> None:
        n = len(self.env_ids)
        try:
            self.steps = np.empty(bound, np.int64)
            for name in self.components:
                a, b = self._header.layout[name]
                self.values[name] = np.empty((bound, n, b - a))
        except (MemoryError, ValueError) as error:
            raise LogError(f"{self.file.path}: {bound} steps of {n} rows: {error}") from error

    # -- messages of a chunk -----------------------------------------------------------------------

    def _sort(self, block: list[Found]) -> tuple[list[_Row], list[tuple[int, memoryview]]]:
        """Rows and steps that are wanted."""
        rows: list[_Row] = []
        steps: list[tuple[int, memoryview]] = []
        first, last = self.span.start, self.span.last()
        start, period = self._header.start_ns, self._header.period_ns
        for topic, time_ns, payload in block:
            if topic == "/sim/step":
                step = _first_uint(payload)
                if time_ns != start + step * period:
                    raise wire.WireError(f"step {step} has another's time, {time_ns} ns")
                if first <= step <= last:
                    if self._pending is not None and self._pending.step == step:
                        rows.append(self._pending)
                    self._pending = None
                    steps.append((step, payload))
            elif topic == "/sim/state" and self.components:
                step = _first_uint(payload)
                self._follow(topic, step, payload)
                if first <= step <= last:
                    self._consider(step, payload)
            elif topic == "/sim/write" and self._follower is not None:
                self._follower.write(payload)
        return rows, steps

    def _consider(self, step: int, payload: memoryview) -> None:
        """Take a message for the row of its step, if it is."""
        pending = self._pending
        if pending is not None and pending.step == step and step > 0:
            return
        row = self._row(step, payload)
        if row is not None:
            self._pending = row

    def _place(self, step: int, payload: memoryview) -> tuple[int, int]:
        """Width of the rows in a message of all environments, and where they begin; else 0."""
        begin = 1 + len(wire.varint(step)) if step else 0
        for width, head in self._heads.items():
            offset = begin + len(head)
            if payload[begin:offset] == head:
                return width, offset
        return 0, 0

    def _row(self, step: int, payload: memoryview) -> _Row | None:
        """Where the rows lie in a message of all environments; None for any other."""
        width, offset = self._place(step, payload)
        if width:
            tail = payload[offset + 8 * self._header.num_envs * width :]
            if len(tail) and tail[0] == 0x28:  # call
                at = 1
                while at < len(tail) and tail[at] & 0x80:
                    at += 1
                tail = tail[at + 1 :]
            if tail != self._tail:
                return None
            row = _Row(step, payload, offset, width)
            if self._follower is not None and not self._header.has_inputs(width):
                row.known = self._follower.rows
                row.inputs = row.known.inputs.copy()
            return row
        state = State.decode(payload)
        if state.env_ids is None and (state.rows.size or not self._header.keyframe_every):
            n, width = state.rows.shape
            raise wire.WireError(f"{n} rows of {width} are not what the metadata says")
        return None

    # -- into the result ---------------------------------------------------------------------------

    def _put_states(self, rows: list[_Row], at: int) -> None:
        """Copy rows that follow each other, as many at a time as have the same columns."""
        while rows:
            kind = rows[0].width, rows[0].known
            other = (i for i, row in enumerate(rows) if (row.width, row.known) != kind)
            same = next(other, len(rows))
            self._put_block(rows[:same], at)
            rows, at = rows[same:], at + same

    def _put_block(self, rows: list[_Row], at: int) -> None:
        n, width, count = self._header.num_envs, rows[0].width, len(rows)
        block = np.empty((count, n * width))
        for target, row in zip(block, rows, strict=True):
            target[:] = np.frombuffer(row.payload, "<f8", n * width, row.offset)
        shaped = block.reshape(count, n, width)
        known = rows[0].known
        inputs = shaped[..., :0] if known is None else np.stack([r.inputs for r in rows])  # type: ignore[misc]
        if not self._all:
            shaped, inputs = shaped[:, self.env_ids], inputs[:, self.env_ids]
        for name in self.components:
            target = self.values[name] = _fit(self.values[name], at + count)
            source, columns = shaped, self._within(name, width)
            if known is not None and name in self._inputs:
                source, columns = inputs, known.input_columns(name)
            target[at : at + count] = 0.0 if columns is None else source[..., columns]

    def _within(self, component: str, width: int) -> slice | None:
        """Columns of a component in rows of a width; None where they were left out."""
        start, stop = self._header.layout[component]
        at = 0
        for a, b in self._ranges[width]:
            if a <= start and stop <= b:
                return slice(at + start - a, at + stop - a)
            at += b - a
        return None

    def _put_outcomes(self, steps: list[tuple[int, memoryview]], at: int) -> int:
        end = at + len(steps)
        self.steps = _fit(self.steps, end)
        self.steps[at:end] = [step for step, _ in steps]
        if self.outcomes and steps:
            decoded = decode_steps([payload for _, payload in steps])
            for name in self.outcomes:
                stacked = decoded[OUTCOMES[name]][:, self.env_ids]
                if name not in self.values:
                    shape = (len(self.steps), *stacked.shape[1:])
                    self.values[name] = np.empty(shape, stacked.dtype)
                target = self.values[name] = _fit(self.values[name], end)
                target[at:end] = stacked
        return end

    def _in_order(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """The steps; with gaps only where `record.every` makes them."""
        ahead = np.diff(steps)
        wrong = np.flatnonzero(ahead < 1 if self._header.every > 1 else ahead != 1)
        if len(wrong):
            one, other = steps[wrong[0] : wrong[0] + 2].tolist()
            why = "is missing" if other > one else "was moved"
            raise LogError(f"{self.file.path}: a chunk {why}: step {other} follows step {one}")
        return steps

    def _trim(self, of_states: NDArray[np.int64], of_outcomes: NDArray[np.int64]) -> None:
        """Keep the steps of which everything is there."""
        rows, outcomes = len(of_states), len(of_outcomes)
        same = not self.components or np.array_equal(of_states, of_outcomes)
        self.steps = of_outcomes
        for name, values in self.values.items():
            self.values[name] = values[: rows if name in self.components else outcomes]
        if same:
            return
        keyframes = self._header.keyframe_every and isinstance(self.file, ChunkFile)
        missing = [] if keyframes else np.setdiff1d(of_outcomes, of_states).tolist()
        if missing:
            raise LogError(
                f"{self.file.path}: control step {missing[0]} has no state of"
                f" {self._header.substeps} physics steps"
            )
        both, left, right = np.intersect1d(of_states, of_outcomes, return_indices=True)
        self.steps = both
        for name, values in self.values.items():
            self.values[name] = values[left if name in self.components else right]


def first_step(file: ChunkFile, span: Steps) -> int | None:
    """Return the first of some steps that is in a log; None if none is.

    Raises:
        LogError: If a message is damaged.
    """
    try:
        for block in file.blocks(file.between(*span.times(file.require_header()))):
            for topic, _, payload in block:
                if topic == "/sim/step" and span.start <= _first_uint(payload) <= span.last():
                    return _first_uint(payload)
    except wire.WireError as error:
        raise LogError(f"{file.path}: a message is damaged: {error}") from error
    return None


def _first_uint(payload: memoryview) -> int:
    """Field 1 of a message, which begins with it unless it is 0."""
    if not len(payload) or payload[0] != 0x08:
        return 0
    value = shift = 0
    for byte in payload[1:11]:
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value
        shift += 7
    raise wire.WireError("a step number does not end")


def _fit(values: NDArray[Any], size: int) -> NDArray[Any]:
    """The array, or a larger copy where the file held more than its times say."""
    if size <= len(values):
        return values
    larger = np.empty((max(size, 2 * len(values)), *values.shape[1:]), values.dtype)
    larger[: len(values)] = values
    return larger

"""Follows a log: its runs of control steps in order, and the input rows of each step's physics.

`FollowedRows` takes every row from the log, so it needs no model. `simulation.Simulation` does the
same on an engine, which also has the model fields and can simulate the physics again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import F64
from embodichain.lab.sim.engine.cpu.cpu_engine import entries
from embodichain.recording.format.header import Header
from embodichain.recording.format.log_error import DamageError, LogError
from embodichain.recording.format.messages.block import Call, CallKind, Run, unpack_steps
from embodichain.recording.format.messages.columns import Moved
from embodichain.recording.format.messages.schema import START_TOPIC, STEPS_TOPIC
from embodichain.recording.read.chunks import ChunkPlace, LogReader
from embodichain.utils.array_types import EnvIds

__all__ = [
    "FollowedRows",
    "Span",
    "columns_of",
    "follow",
    "needed_chunks",
    "physics_call",
    "runs",
]


@dataclass(frozen=True, slots=True)
class Span:
    """A range of control steps, both ends included; `last` None is the end of the log."""

    first: int = 0
    last: int | None = None

    def __contains__(self, step: int) -> bool:
        """Whether a step is in the range."""
        return self.first <= step and not self.ends_before(step)

    def ends_before(self, step: int) -> bool:
        """Whether a step is after the range."""
        return self.last is not None and step > self.last


CallFilter = Callable[[CallKind], bool]
"""Whether a call is read."""


def outcomes(kind: CallKind) -> bool:
    """Whether a call has actions, rewards and flags of a step: only ``step`` has."""
    return kind.kind == "step"


def changes(kind: CallKind) -> bool:
    """Whether a call changes rows or model fields."""
    return kind.kind in ("write", "physics")


_ALL = Span()


def runs(reader: LogReader, span: Span = _ALL, is_read: CallFilter | None = None) -> Iterator[Run]:
    """Yield the starts and runs needed to follow some steps, from the last start before them.

    Args:
        reader: The log; its `damage` describes damage that is found.
        span: The control steps.
        is_read: Whether a call is read; None reads all. A ``start`` is always read; a ``step`` that
            is not read has no arrays.

    Raises:
        LogError: If a message is damaged, or a chunk is in the wrong place.
    """
    header = reader.require_header()
    next_step: int | None = None  # None before the first start

    def is_read_or_start(kind: CallKind) -> bool:
        return is_read is None or kind.kind == "start" or is_read(kind)

    for topic, time_ns, payload in reader.messages(needed_chunks(reader, span)):
        is_start = topic == START_TOPIC
        if not is_start and (topic != STEPS_TOPIC or next_step is None):
            continue
        try:
            message_runs = unpack_steps(
                payload,
                num_envs=header.num_envs,
                moved=header.moved_width,
                nstate=header.nstate,
                is_read=is_read_or_start,
            )
        except DamageError as error:
            raise LogError(f"{reader.path}: a message is damaged: {error}") from error
        for run in message_runs:
            error_text = _run_error(run, is_start, header)
            is_first = run is message_runs[0]
            if is_first and time_ns != header.start_ns + run.first * header.period_ns:
                error_text = f"step {run.first} has another's time"
            if error_text:
                raise LogError(f"{reader.path}: a message is damaged: {error_text}")
            if next_step is not None:
                # With `record.every`, recording pauses, and resumes with a start.
                may_skip_steps = is_start and header.every > 1
                _check_order(reader, run, next_step, may_skip_steps)
            yield run
            next_step = run.first + run.steps
            if span.ends_before(next_step):
                return


def _check_order(reader: LogReader, run: Run, next_step: int, may_skip_steps: bool) -> None:
    """Raise `LogError` if a run does not continue the steps before it."""
    if run.first == next_step or (may_skip_steps and run.first > next_step):
        return
    change = "is missing" if run.first > next_step else "was moved"
    raise LogError(
        f"{reader.path}: a chunk {change}: step {run.first} follows step {next_step - 1}"
    )


def _run_error(run: Run, is_start: bool, header: Header) -> str:
    """How a run is inconsistent with the rest of the log; empty if it is not."""
    if bool(run.of_kind("start")) != is_start:
        return "it belongs to another channel"
    if not header.keyframe_every and any("hashes" in call.arrays for call in run.calls):
        return f"step {run.first} has no rows"
    return ""


def needed_chunks(reader: LogReader, span: Span) -> list[ChunkPlace] | None:
    """The chunks from that of the last start before the steps; None for all chunks."""
    header = reader.require_header()
    chunks = reader.chunks
    time_ns = header.start_ns + span.first * header.period_ns
    last_chunk = max((i for i, c in enumerate(chunks) if c.start_ns <= time_ns), default=0)
    for index in range(last_chunk, 0, -1):
        for topic, message_ns, _ in reader.messages([chunks[index]]):
            if topic == START_TOPIC and message_ns <= time_ns:
                return chunks[index:]
    return None


def physics_call(reader: LogReader, run: Run) -> int:
    """Index of the call of a run with which the physics of the control step begins.

    It is the first physics call for all environments with `Header.call_steps` as its number of
    steps. In the first step of a file, where a reset may settle for as many steps, the last calls
    are those of the control step.

    Raises:
        LogError: If there is none.
    """
    header = reader.require_header()
    nstep = header.call_steps or header.substeps
    physics_calls = [
        index
        for index, call in enumerate(run.calls)
        if call.kind.kind == "physics" and call.kind.nstep == nstep and "env_ids" not in call.arrays
    ]
    num_calls = header.substeps // nstep
    if len(physics_calls) < num_calls:
        raise LogError(
            f"{reader.path}: control step {run.first} has no physics of {header.substeps} steps"
        )
    if run.first == header.first_step:
        return physics_calls[-num_calls]
    return physics_calls[0]


@lru_cache(maxsize=256)
def columns_of(columns: tuple[int, ...] | None) -> NDArray[np.int64] | slice:
    """Columns of a call as an index: a slice if they are adjacent, to get views, not copies."""
    if columns is None:
        return slice(None)
    indices = np.array(columns, np.int64)
    if len(indices) and (np.diff(indices) == 1).all():
        return slice(int(indices[0]), int(indices[-1]) + 1)
    return indices


class Selection(NamedTuple):
    """Which environments of a call are among the selected ones.

    Attributes:
        local: (n,) their numbers among the selected ones; None if these are all selected ones.
        positions: Where they are in the call's arrays.
    """

    local: EnvIds | None
    positions: EnvIds | slice


class FollowedRows:
    """The recorded rows of selected environments.

    Args:
        reader: The log.
        env_ids: (n,) environments, ascending; None is all.

    Attributes:
        header: The log's metadata.
        path: The log, for messages.
        env_ids: (n,) selected environments.
        rows_are_known: Whether `rows` are recorded ones; between keyframes they are not.
        next_step: The next control step.
        moved: The columns that physics writes.
    """

    def __init__(self, reader: LogReader, env_ids: EnvIds | None = None) -> None:
        self.header = reader.require_header()
        self.path = reader.path
        num_envs = self.header.num_envs
        self.env_ids = np.arange(num_envs, dtype=np.int64) if env_ids is None else env_ids
        self.rows_are_known = False
        self.next_step = -1
        self.moved = Moved(self.header.moved)
        self._all_are_selected = len(self.env_ids) == num_envs
        # Environment of the log to its number among the selected ones, or -1.
        self._local_ids = np.full(num_envs, -1, np.int64)
        self._local_ids[self.env_ids] = np.arange(len(self.env_ids))
        self._rows: F64 = np.zeros((len(self.env_ids), self.header.nstate))

    @property
    def rows(self) -> F64:
        """(n, nstate) current rows, not a copy. Do not write."""
        return self._rows

    def begin(self, run: Run) -> None:
        """Continue from a start of the log.

        Raises:
            LogError: If its shape is wrong.
        """
        positions = self.selection(None).positions
        self._rows[:] = run.calls[0].arrays["row"][0][positions]
        self.rows_are_known = True
        self.next_step = run.first

    def apply(self, step: int, call: Call, t: int) -> None:
        """Apply a call.

        Args:
            step: The control step.
            call: The call, with the values of every step of its run.
            t: Index of the step within the run.

        Raises:
            LogError: If it does not fit the log's rows.
        """
        kind = call.kind.kind
        if kind == "step":
            self.next_step = step + 1
        if kind not in ("write", "physics"):
            return
        arrays = call.arrays
        local, positions = self.selection(arrays["env_ids"][t] if "env_ids" in arrays else None)
        if local is not None and not len(local):
            return
        try:
            if kind == "write":
                values = arrays["values"][t][positions] if "values" in arrays else None
                self.write(step, call, local, values)
            else:
                self.physics(step, call, t, local, positions)
        except LogError:
            raise  # it is a ValueError
        except (KeyError, ValueError, IndexError) as error:
            label = "physics" if kind == "physics" else f"a write to {call.kind.name!r}"
            raise LogError(
                f"{self.path}: step {step}: {label} does not fit the model: {error}"
            ) from error

    def selection(self, ids: EnvIds | None) -> Selection:
        """Which of a call's environments (None: all of the log) are selected."""
        if ids is None:
            return Selection(None, slice(None) if self._all_are_selected else self.env_ids)
        local = self._local_ids[ids]
        if self._all_are_selected:
            return Selection(local, slice(None))
        positions = np.flatnonzero(local >= 0)
        local = local[positions]
        if len(local) == len(self.env_ids):
            return Selection(None, positions)
        return Selection(local, positions)

    def write(self, step: int, call: Call, local: EnvIds | None, values: F64 | None) -> None:
        """Apply a write outside physics."""
        if values is None or call.kind.mode == "model":
            return
        rows: Any = slice(None) if local is None else local
        if call.kind.mode == "reset":
            self._rows[rows] = values
            return
        if call.kind.name == "row":
            view = self._rows
        else:
            start, stop = self.header.layout[call.kind.name]
            view = self._rows[:, start:stop]
        view[entries(local, columns_of(call.kind.columns))] = values

    def physics(
        self, step: int, call: Call, t: int, local: EnvIds | None, positions: EnvIds | slice
    ) -> None:
        """Apply the recorded result of physics."""
        if "rows" not in call.arrays:
            self.rows_are_known = False
            return
        result = call.arrays["rows"][t]
        for row_columns, result_columns in self.moved.spans:
            # A view first, then the selected environments: this copies the fewest numbers.
            values = result[:, result_columns][positions]
            self._rows[entries(local, row_columns)] = values


def follow(
    reader: LogReader, rows: FollowedRows, span: Span = _ALL, is_read: CallFilter = changes
) -> Iterator[tuple[Run, int]]:
    """Yield each finished control step, while `rows` are the input of its physics.

    Steps with unknown rows are left out.

    Args:
        reader: The log.
        rows: The rows that are updated.
        span: The control steps.
        is_read: Which calls are read: at least those that change the needed columns of the rows.

    Returns:
        A run, and the index of the step within it.

    Raises:
        LogError: If a message is damaged.
    """
    for run in runs(reader, span, is_read):
        if run.of_kind("start"):
            rows.begin(run)
            continue
        for t in _steps_of(reader, rows, run, span):
            yield run, t


def _steps_of(reader: LogReader, rows: FollowedRows, run: Run, span: Span) -> Iterator[int]:
    """Like `follow`, for the steps of one run; yields indices within it."""
    physics_index = physics_call(reader, run) if run.steps else len(run.calls)
    for t in range(run.count):
        step = run.first + t
        for call in run.calls[:physics_index]:
            rows.apply(step, call, t)
        if span.first <= step and run.steps and rows.rows_are_known:
            yield t
        if step == span.last:
            return
        for call in run.calls[physics_index:]:
            rows.apply(step, call, t)

"""Follows a log: its runs of control steps in order, and the input rows of each step's physics.

`Rows` takes every row from the log, so it needs no model. `simulation.Simulation` does the same on
an engine, which also has the model fields and can simulate the physics again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import F64, EnvIndex
from embodichain.lab.sim.engine.cpu.cpu_engine import entries
from embodichain.recording.format.block import Call, CallKind, Run, unpack_steps
from embodichain.recording.format.columns import Moved
from embodichain.recording.format.header import Header
from embodichain.recording.format.log_error import DamageError, LogError
from embodichain.recording.format.schema import START_TOPIC, STEPS_TOPIC
from embodichain.recording.read.chunks import ChunkPlace, LogReader

__all__ = [
    "Rows",
    "Span",
    "columns_of",
    "follow",
    "own_physics",
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


Wanted = Callable[[CallKind], bool]


def outcomes(kind: CallKind) -> bool:
    """Whether a call has actions, rewards and flags of a step: only ``step`` has."""
    return kind.kind == "step"


def changes(kind: CallKind) -> bool:
    """Whether a call changes rows or model fields."""
    return kind.kind in ("write", "physics")


_ALL = Span()


def runs(reader: LogReader, span: Span = _ALL, wanted: Wanted | None = None) -> Iterator[Run]:
    """Yield the starts and runs needed to follow some steps, from the last start before them.

    Args:
        reader: The log; its `damage` describes damage that is found.
        span: The control steps.
        wanted: Whether a call is read; None reads all. A ``start`` is always read; a ``step`` that
            is not read has no arrays.

    Raises:
        LogError: If a message is damaged, or a chunk is in the wrong place.
    """
    header = reader.require_header()
    sizes = header.num_envs, header.moved_width, header.nstate
    expected: int | None = None

    def reads(kind: CallKind) -> bool:
        return wanted is None or kind.kind == "start" or wanted(kind)

    for topic, time_ns, payload in reader.messages(_needed(reader, span)):
        is_start = topic == START_TOPIC
        if not is_start and (topic != STEPS_TOPIC or expected is None):
            continue
        try:
            found = unpack_steps(payload, *sizes, reads)
        except DamageError as error:
            raise LogError(f"{reader.path}: a message is damaged: {error}") from error
        for run in found:
            why = _wrong(run, is_start, header)
            if run is found[0] and time_ns != header.start_ns + run.first * header.period_ns:
                why = f"step {run.first} has another's time"
            if why:
                raise LogError(f"{reader.path}: a message is damaged: {why}")
            gap = is_start and header.every > 1
            if expected is not None and (run.first < expected if gap else run.first != expected):
                why = "is missing" if run.first > expected else "was moved"
                raise LogError(
                    f"{reader.path}: a chunk {why}: step {run.first} follows step {expected - 1}"
                )
            yield run
            expected = run.first + run.steps
            if span.ends_before(expected):
                return


def _wrong(run: Run, is_start: bool, header: Header) -> str:
    """How a run is inconsistent with the rest of the log; empty if it is not."""
    if bool(run.of_kind("start")) != is_start:
        return "it belongs to another channel"
    if not header.keyframe_every and any("hashes" in call.arrays for call in run.calls):
        return f"step {run.first} has no rows"
    return ""


def _needed(reader: LogReader, span: Span) -> list[ChunkPlace] | None:
    """The chunks from that of the last start before the steps; None for all chunks."""
    header = reader.require_header()
    chunks = reader.chunks
    time_ns = header.start_ns + span.first * header.period_ns
    at = max((i for i, c in enumerate(chunks) if c.start_ns <= time_ns), default=0)
    while at > 0:
        found = reader.messages(chunks[at : at + 1])
        if any(topic == START_TOPIC and time <= time_ns for topic, time, _ in found):
            return chunks[at:]
        at -= 1
    return None


def own_physics(reader: LogReader, run: Run) -> int:
    """Index of the call of a run with which the physics of the control step begins.

    It is the first physics call for all environments with `Header.call_steps` as its number of
    steps. In the first step of a file, where a reset may settle for as many steps, the last calls
    are those of the control step.

    Raises:
        LogError: If there is none.
    """
    header = reader.require_header()
    nstep = header.call_steps or header.substeps
    found = [i for i, call in enumerate(run.calls) if _is_whole(call, nstep)]
    count = header.substeps // nstep
    if len(found) < count:
        why = f"control step {run.first} has no physics of {header.substeps} steps"
        raise LogError(f"{reader.path}: {why}")
    return found[-count if run.first == header.first_step else 0]


def _is_whole(call: Call, nstep: int) -> bool:
    """Whether a call is physics of all environments with this number of steps."""
    whole = call.kind.kind == "physics" and "env_ids" not in call.arrays
    return whole and call.kind.nstep == nstep


@lru_cache(maxsize=256)
def columns_of(columns: tuple[int, ...] | None) -> NDArray[np.int64] | slice:
    """Columns of a call as an index: a slice if they are adjacent, to get views, not copies."""
    if columns is None:
        return slice(None)
    found = np.array(columns, np.int64)
    if len(found) and (np.diff(found) == 1).all():
        return slice(int(found[0]), int(found[-1]) + 1)
    return found


class Rows:
    """The recorded rows of selected environments.

    Args:
        reader: The log.
        env_ids: (n,) environments, ascending; None is all.

    Attributes:
        header: The log's metadata.
        path: The log, for messages.
        env_ids: (n,) selected environments.
        known: Whether `rows` are recorded ones; between keyframes they are not.
        next_step: The next control step.
        moved: The columns that physics writes.
    """

    def __init__(self, reader: LogReader, env_ids: EnvIndex | None = None) -> None:
        self.header = header = reader.require_header()
        self.path = reader.path
        n = header.num_envs
        self.env_ids = np.arange(n, dtype=np.int64) if env_ids is None else env_ids
        self.known = False
        self.next_step = -1
        self._all = len(self.env_ids) == n
        self._local = np.full(n, -1, np.int64)
        self._local[self.env_ids] = np.arange(len(self.env_ids))
        self._rows: F64 = np.zeros((len(self.env_ids), header.nstate))
        self.moved = Moved(header.moved)

    @property
    def rows(self) -> F64:
        """(n, nstate) current rows, not a copy. Do not write."""
        return self._rows

    def begin(self, run: Run) -> None:
        """Continue from a start of the log.

        Raises:
            LogError: If its shape is wrong.
        """
        _, take = self.chosen(None)
        self._rows[:] = run.calls[0].arrays["row"][0][take]
        self.known = True
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
        local, take = self.chosen(arrays["env_ids"][t] if "env_ids" in arrays else None)
        if local is not None and not len(local):
            return
        try:
            if kind == "write":
                values = arrays["values"][t][take] if "values" in arrays else None
                self.write(step, call, local, values)
            else:
                self.physics(step, call, t, local, take)
        except LogError:
            raise  # it is a ValueError
        except (KeyError, ValueError, IndexError) as error:
            what = "physics" if kind == "physics" else f"a write to {call.kind.name!r}"
            raise LogError(
                f"{self.path}: step {step}: {what} does not fit the model: {error}"
            ) from error

    def chosen(self, ids: EnvIndex | None) -> tuple[EnvIndex | None, EnvIndex | slice]:
        """Indices of a call's environments in `rows` (None for all), and in the call's arrays."""
        if ids is None:
            return None, slice(None) if self._all else self.env_ids
        local = self._local[ids]
        if self._all:
            return local, slice(None)
        take = np.flatnonzero(local >= 0)
        local = local[take]
        return (None if len(local) == len(self.env_ids) else local), take

    def write(self, step: int, call: Call, local: EnvIndex | None, values: F64 | None) -> None:
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
        self, step: int, call: Call, t: int, local: EnvIndex | None, take: EnvIndex | slice
    ) -> None:
        """Apply the recorded result of physics."""
        if "rows" not in call.arrays:
            self.known = False
            return
        returned = call.arrays["rows"][t]
        rows = self._rows
        whole = isinstance(take, slice)
        for here, there in self.moved.spans:
            found = returned[:, there]
            rows[entries(local, here)] = found if whole else found[take]


def follow(
    reader: LogReader, rows: Rows, span: Span = _ALL, wanted: Wanted = changes
) -> Iterator[tuple[Run, int]]:
    """Yield each finished control step, while `rows` are the input of its physics.

    Steps with unknown rows are left out.

    Args:
        reader: The log.
        rows: The rows that are updated.
        span: The control steps.
        wanted: Which calls are read: at least those that change the needed columns of the rows.

    Returns:
        A run, and the index of the step within it.

    Raises:
        LogError: If a message is damaged.
    """
    for run in runs(reader, span, wanted):
        if run.of_kind("start"):
            rows.begin(run)
        else:
            yield from ((run, t) for t in _steps_of(reader, rows, run, span))


def _steps_of(reader: LogReader, rows: Rows, run: Run, span: Span) -> Iterator[int]:
    """Like `follow`, for the steps of one run; yields indices within it."""
    own = own_physics(reader, run) if run.steps else len(run.calls)
    for t in range(run.count):
        step = run.first + t
        for call in run.calls[:own]:
            rows.apply(step, call, t)
        if span.first <= step and run.steps and rows.known:
            yield t
        if step == span.last:
            return
        for call in run.calls[own:]:
            rows.apply(step, call, t)

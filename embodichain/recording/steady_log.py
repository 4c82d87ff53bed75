"""`SteadyLog`: a `StateLog` that takes control steps together that are made of the same calls.

Nearly all steps are: nothing is reset in them, and everything is written to all environments. Of
each call's arrays in all those steps one is made, so that what a step costs in Python is shared.
The messages are those that `StateLog` makes one by one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64
from embodichain.recording import wire
from embodichain.recording.batches import AlikeCalls, AlikeSteps
from embodichain.recording.columns import Ranges
from embodichain.recording.hashing import RowHash
from embodichain.recording.known_rows import KnownRows
from embodichain.recording.mcap_file import Piece
from embodichain.recording.messages import (
    drawn_head,
    event_head,
    shape_head,
    step_heads,
)
from embodichain.recording.state_log import StateLog

__all__ = ["SteadyLog", "SteadySteps", "StepKind"]

_ORDINARY = {"write", "event", "stepped", "step"}
"""Names of the calls that steps which are taken together are made of."""

Rows = list[NDArray[np.uint8]]


@dataclass(frozen=True, slots=True)
class StepKind:
    """What control steps are made of.

    Attributes:
        calls: Their calls.
        physics: Index of the one that steps physics.
        inputs: Index of each call that writes inputs, and the (k,) columns of a row it writes.
    """

    calls: tuple[AlikeCalls, ...]
    physics: int
    inputs: Mapping[int, NDArray[np.int64]]


class SteadyLog(StateLog):
    """See `StateLog`; derived rows are a condition for taking steps together."""

    @cached_property
    def _kinds(self) -> dict[tuple[AlikeCalls, ...], StepKind | None]:
        return {}

    def columns(self, ranges: Ranges) -> None:
        """From here on these columns of rows are handed over."""
        super().columns(ranges)
        self._kinds.clear()

    def kind_of(self, calls: tuple[AlikeCalls, ...]) -> StepKind | None:
        """The kind of steps that are made of these calls; None if they are taken one by one."""
        if calls not in self._kinds:
            self._kinds[calls] = self._new_kind(calls)
        return self._kinds[calls]

    def _new_kind(self, calls: tuple[AlikeCalls, ...]) -> StepKind | None:
        known, names = self._known, [call.name for call in calls]
        own = [index for index, name in enumerate(names) if name == "stepped"]
        if known is None or not _ORDINARY.issuperset(names) or len(own) != 1:
            return None
        if calls[own[0]].args != (self._substeps, None, None):
            return None
        inputs: dict[int, NDArray[np.int64]] = {}
        for index, call in enumerate(calls):
            if call.name != "write":
                continue
            columns = known.written_inputs(call.args[0], self._places[call.args[0]])
            if columns is None or any(np.isin(columns, other).any() for other in inputs.values()):
                return None
            inputs[index] = columns
        return StepKind(calls, own[0], inputs)

    def together(self, steps: AlikeSteps, kind: StepKind) -> SteadySteps | None:
        """Take steps together, up to the next state that has inputs; None if it is not time.

        They are taken when `SteadySteps.finish` is called.
        """
        known, count = self._known, min(steps.count, self._inputs_due - self.step)
        if known is None or not known.told or count < 2:
            return None
        if self._after_physics or self._own is not None:
            return None
        starts = wire.uints(1, self.step, count)
        calls = wire.uints(2, self.call, count)
        later = wire.uints(2, self.call + 1, count)
        tails = wire.uints(5, self.call, count)
        if starts is None or calls is None or later is None or tails is None:
            return None
        stamps, after = np.hstack([starts, calls]), np.hstack([starts, later])
        arrays = [steps.arrays(index, count) for index in range(len(kind.calls))]
        found = SteadySteps(self, known, kind, arrays, count)
        for index, (call, values) in enumerate(zip(kind.calls, arrays, strict=True)):
            when: Rows = [after if index > kind.physics else stamps]
            if index == kind.physics:
                (moved,) = values
                before = _bytes(known.moved[None], "<f8")
                rows: Rows = [before, _bytes(moved[:-1], "<f8")]
                pieces: list[Piece] = [[starts], shape_head(*moved.shape[1:]), rows]
                pieces += [[tails], wire.uint(6, self._substeps)]
                found.messages.append(("/sim/state", pieces))
            elif call.name == "write":
                head = self._head(index > kind.physics, call.args[0], values=True)
                data = _bytes(values[0], "<f8")
                start = b"".join(head) + wire.packed(8, data.shape[1])
                found.messages.append(("/sim/write", [when, start, [data]]))
            elif call.name == "event":
                term, mode, _, names = call.args
                pieces = [when, event_head(term, mode)]
                for name, drawn in zip(names, values, strict=True):
                    pieces += [drawn_head(name, drawn.shape[1:]), [_bytes(drawn, "<f8")]]
                found.messages.append(("/sim/event", pieces))
            else:
                found.messages.append(("/sim/step", self._step_pieces([stamps], values, found)))
        return found

    def _step_pieces(
        self, when: Rows, values: Sequence[NDArray[Any]], steps: SteadySteps
    ) -> list[Piece]:
        """`Step` as `encode_step` has it."""
        action, reward, episode_ids = values
        n = reward.shape[1]
        data: list[Piece] = [
            [_bytes(action, "<f8")],
            [_bytes(reward, "<f8")],
            nobody := bytes(n),  # is terminated or truncated in steps that are alike
            nobody,
            [_bytes(episode_ids, "<i8")],
            [_bytes(steps.hashes(self._hash), "<u8")],
        ]
        pieces: list[Piece] = [when]
        for head, column in zip(step_heads(n, action[0].size // n), data, strict=True):
            pieces += [head, column]
        return pieces

    def take(self, steps: SteadySteps) -> None:
        """Go on after these steps."""
        self.call += steps.count
        self.step += steps.count - 1
        self.skip()


class SteadySteps:
    """Control steps that are taken together.

    Args:
        log: Where they belong.
        known: The rows before the first of them.
        kind: What they are made of.
        arrays: Those of each call, (K, ...) each.
        count: K.

    Attributes:
        arrays: As above.
        count: As above.
        messages: Topic and pieces of what is written in each of them.
    """

    def __init__(
        self,
        log: SteadyLog,
        known: KnownRows,
        kind: StepKind,
        arrays: list[list[NDArray[Any]]],
        count: int,
    ) -> None:
        self._log, self._known, self._kind = log, known, kind
        self.arrays, self.count = arrays, count
        self.messages: list[tuple[str, list[Piece]]] = []

    def hashes(self, row_hash: RowHash) -> NDArray[np.uint64]:
        """(K, N) hashes of what physics returned."""
        physics = self._kind.physics
        written = [
            (columns, self.arrays[index][0], index < physics)
            for index, columns in self._kind.inputs.items()
        ]
        return self._known.hashes_together(row_hash, self.arrays[physics][0], written)

    def rows_at(self, steps: Sequence[int], ids: NDArray[np.int64]) -> F64:
        """(L, n, nstate) rows of some environments as physics received them in L of the steps.

        Args:
            steps: Which of the K steps, ascending.
            ids: (n,) the environments.
        """
        kind, known = self._kind, self._known
        rows, later = np.repeat(known.of(ids)[None], len(steps), 0), np.array(steps)
        begun = int(later[0] == 0)  # what is left in the step before is not there in the first

        def put(columns: NDArray[np.int64], values: F64, at: int, step: NDArray[np.int64]) -> None:
            rows[at:, :, columns] = values[step[at:, None], ids]

        put(known.moved_columns, self.arrays[kind.physics][0], begun, later - 1)
        for index, columns in kind.inputs.items():
            before = index < kind.physics
            at, step = (0, later) if before else (begun, later - 1)
            put(columns, self.arrays[index][0], at, step)
        return rows

    def finish(self) -> None:
        """The steps are over."""
        for index in self._kind.inputs:
            place = self._kind.calls[index].args[0]
            self._known.write(place, self._log.place_of(place), None, self.arrays[index][0][-1])
        self._known.returned(self.arrays[self._kind.physics][0][-1])
        self._log.take(self)


def _bytes(values: NDArray[Any], dtype: str) -> NDArray[np.uint8]:
    """(K, ...) numbers as (K, bytes), without a copy where they have this type."""
    return np.asarray(values, dtype).reshape(len(values), -1).view(np.uint8)

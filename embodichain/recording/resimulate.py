"""Follows a log with an engine of its own: writes are applied, physics is run, rows are compared.

One pass in file order, all environments at once, one chunk of the file in memory.
"""

from __future__ import annotations

from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import F64, EnvIndex
from embodichain.lab.sim.engine.cpu import CpuEngine
from embodichain.recording.columns import Ranges, column_name, spread
from embodichain.recording.hashing import RowHash
from embodichain.recording.header import Header, LogError
from embodichain.recording.messages import Calls, State, StepOutcome, WriteRecord
from embodichain.recording.verify_report import Difference
from embodichain.recording.wire import WireError

__all__ = ["ActiveSteps", "Found", "Resimulation"]

MOST_PHYSICS_STEPS = 1_000_000
"""A single call of more is not believed: nobody would see the end of it."""


class Found(Exception):
    """The first difference: ends the pass; it is a result, not an error."""

    def __init__(self, difference: Difference) -> None:
        super().__init__(str(difference))
        self.difference = difference


class ActiveSteps(Protocol):
    """Says which environments are compared in a step."""

    def __call__(self, step: int) -> NDArray[np.bool_]:
        """(n,) mask over the selected environments."""


class Resimulation:
    """An engine that does what a log says.

    Args:
        header: The log's metadata.
        model: The model to simulate.
        selected: (n,) environments to simulate, sorted.
        active: Which of them are compared in which step.
        exact: Compare bits; else measure errors, starting each step from the recorded row.
        num_threads: Physics threads; 0 is all cores.
    """

    def __init__(
        self,
        header: Header,
        model: mujoco.MjModel,
        selected: EnvIndex,
        active: ActiveSteps,
        exact: bool = True,
        num_threads: int = 0,
    ) -> None:
        self._header = header
        self._selected = selected
        self._active = active
        self._exact = exact
        self._engine = CpuEngine(model, len(selected), num_threads)
        self._hash = RowHash(header.nstate)
        self._layout = header.slices()
        self._ranges: Ranges = [(0, header.nstate)]  # columns in use: others are zero
        # Environments whose rows here are the log's.
        self._followed = self._simulated(header.first_step).copy()
        self._calls: dict[int, tuple[EnvIndex, NDArray[np.uint64]]] = {}
        self._suspect: Difference | None = None
        self.steps = 0
        self.last_step = header.first_step - 1
        self.largest_error: dict[str, float] = {}

    @property
    def rows(self) -> F64:
        """(n, nstate) live rows of the selected environments."""
        return self._engine.rows

    def lose_track(self) -> None:
        """Take the next rows that come, instead of comparing them."""
        self._followed = np.zeros_like(self._followed)

    def _simulated(self, step: int) -> NDArray[np.bool_]:
        """Environments to simulate in a step: between keyframes nobody can begin."""
        active = self._active(step)
        return np.ones_like(active) if self._header.keyframe_every else active

    def _local(self, env_ids: EnvIndex | None) -> tuple[EnvIndex, EnvIndex | slice]:
        """Indices into the selected environments, and of their rows in a message."""
        n = len(self._selected)
        if env_ids is None:
            if n == self._header.num_envs:
                return np.arange(n), slice(None)
            return np.arange(n), self._selected
        if int(env_ids[-1]) >= self._header.num_envs:
            raise LogError(f"a message names environment {env_ids[-1]}")
        _, local, rows = np.intersect1d(
            self._selected, env_ids, assume_unique=True, return_indices=True
        )
        return local, rows

    # -- writes ------------------------------------------------------------------------------------

    def on_write(self, data: bytes | memoryview) -> None:
        """Apply a recorded write.

        Raises:
            LogError: If it does not fit the model.
        """
        write = WriteRecord.decode(data)
        local, rows = self._local(write.env_ids)
        if not len(local):
            return
        try:
            self._apply(write, local, rows)
        except (KeyError, ValueError, IndexError) as error:
            raise LogError(
                f"step {write.step}: a write to {write.field!r} does not fit the model: {error}"
            ) from error

    def _apply(self, write: WriteRecord, local: EnvIndex, rows: EnvIndex | slice) -> None:
        engine = self._engine
        ids = None if len(local) == engine.num_envs else local
        if write.op == "reset":
            engine.reset(ids)
        elif write.op == "set_const":
            engine.set_const(ids)
        elif write.op in ("state", "model"):
            n = self._header.num_envs if write.env_ids is None else len(write.env_ids)
            values = write.values.reshape(n, -1)[rows]
            put = engine.write if write.op == "state" else engine.write_model
            put(write.field, values, ids, write.columns)
        else:
            raise ValueError(f"unknown operation {write.op!r}")

    # -- physics -----------------------------------------------------------------------------------

    def on_state(self, data: bytes | memoryview) -> None:
        """Compare rows as physics receives them, then run the physics that followed.

        Raises:
            Found: If a row is not what was simulated.
            LogError: If the rows do not fit the model.
        """
        state = State.decode(data)
        if not state.rows.size and self._header.keyframe_every and state.nstep:
            self._between(state)
            return
        try:
            ranges = self._header.ranges_of(state.rows.shape[1])
        except WireError as error:
            raise LogError(f"step {state.step}: {error}") from error
        if self._header.has_inputs(state.rows.shape[1]):
            self._ranges = ranges
        count = self._header.num_envs if state.env_ids is None else len(state.env_ids)
        if len(state.rows) != count:
            raise LogError(f"step {state.step}: {len(state.rows)} rows")
        local, rows = self._local(state.env_ids)
        active = self._simulated(state.step)
        compared = active & self._followed
        recorded = state.rows[rows]
        compare = (compared & self._active(state.step))[local]
        self._compare(state, local, recorded, compare, ranges)
        new = (active & ~compared)[local]
        if new.any() or not self._exact:
            take = active[local] if not self._exact else new
            self._engine.write("row", self._whole(recorded[take], local[take]), local[take])
        self._followed = active
        if state.nstep:
            self._step(state, local[active[local]])

    def _between(self, state: State) -> None:
        """Run physics whose rows were not written: those that are here are the log's."""
        if self._suspect is not None:
            raise Found(self._suspect)
        local, _ = self._local(state.env_ids)
        self._step(state, local[self._followed[local]])

    def _whole(self, recorded: F64, local: EnvIndex) -> F64:
        """Whole rows; inputs that were left out are those of the writes that were followed."""
        header, width = self._header, recorded.shape[1]
        if header.has_inputs(width):
            return spread(header.ranges_of(width), recorded, header.nstate)
        rows, at = self._engine.rows[local], 0
        for start, stop in header.moved:
            rows[:, start:stop] = recorded[:, at : at + stop - start]
            at += stop - start
        return rows

    def _compare(
        self,
        state: State,
        local: EnvIndex,
        recorded: F64,
        compared: NDArray[np.bool_],
        ranges: Ranges,
    ) -> None:
        rows = self._engine.rows
        if len(local) != len(rows):
            rows = rows[local]
        at = 0
        differs = np.zeros(len(local), np.bool_)
        for start, stop in ranges:
            here = rows[:, start:stop].view(np.uint64)
            there = recorded[:, at : at + stop - start].view(np.uint64)
            differs |= (here != there).any(axis=1)
            at += stop - start
        differs &= compared
        if not self._exact:
            self._measure(rows[compared], self._whole(recorded[compared], local[compared]))
        elif differs.any() or self._suspect is not None:
            self._report(state, local, rows, recorded, differs)

    def _report(
        self,
        state: State,
        local: EnvIndex,
        rows: F64,
        recorded: F64,
        differs: NDArray[np.bool_],
    ) -> None:
        """Name the field: of the environment whose hash was wrong, or of the first that differs."""
        suspect = self._suspect
        if suspect is not None:
            at = np.flatnonzero(self._selected[local] == suspect.env)
            if not len(at):
                return  # a physics call of others; its turn comes
            if not differs[at[0]]:
                raise Found(suspect)
            row, step = int(at[0]), suspect.step
        else:
            row, step = int(np.flatnonzero(differs)[0]), state.step
        there = self._whole(recorded[row : row + 1], local[row : row + 1])[0]
        here = rows[row]
        column = int(np.flatnonzero(here.view(np.uint64) != there.view(np.uint64))[0])
        env = int(self._selected[local[row]])
        name = column_name(self._layout, column)
        raise Found(Difference(step, env, name, float(there[column]), float(here[column])))

    def _measure(self, rows: F64, there: F64) -> None:
        if not len(rows):
            return
        for name in ("qpos", "qvel"):
            cols = self._layout[name]
            error = np.abs(rows[:, cols] - there[:, cols])
            largest = float(error.max()) if error.size else 0.0
            self.largest_error[name] = max(self.largest_error.get(name, 0.0), largest)

    def _step(self, state: State, ids: EnvIndex) -> None:
        if not len(ids):
            return
        if state.nstep > MOST_PHYSICS_STEPS:
            raise LogError(f"step {state.step}: {state.nstep} physics steps at once")
        everybody = len(ids) == self._engine.num_envs
        self._engine.step(state.nstep, None if everybody else ids)
        rows = self._engine.rows if everybody else self._engine.rows[ids]
        # Without rows nobody says which columns are in use.
        ranges = self._ranges if state.rows.size else [(0, self._header.nstate)]
        self._calls[state.call] = (ids, self._hash(rows, ranges))

    def on_step(self, data: bytes | memoryview) -> StepOutcome:
        """A control step ended: compare the hash of what its physics returned."""
        outcome = StepOutcome.decode(data)
        self.last_step = outcome.step
        if self._active(outcome.step).any():
            self.steps += 1
        self._check(outcome.physics)
        return outcome

    def on_call(self, data: bytes | memoryview) -> None:
        """Another physics call ended."""
        self._check(Calls.decode(data))

    def _check(self, calls: Calls) -> None:
        done = self._calls.pop(calls.call, None)
        if done is None or not self._exact or not len(calls.hashes) or self._suspect is not None:
            return
        ids, hashes = done
        everywhere = calls.env_ids if calls.env_ids is not None else None
        envs = self._selected[ids]
        if everywhere is None:
            at = envs
        elif np.isin(envs, everywhere).all():
            at = np.searchsorted(everywhere, envs)
        else:
            raise LogError(f"step {calls.step}: physics ran in other environments than it ended in")
        if len(calls.hashes) <= int(at[-1]):
            raise LogError(f"step {calls.step}: {len(calls.hashes)} hashes")
        recorded = calls.hashes[at]
        compared = self._active(calls.step)[ids]
        wrong = np.flatnonzero((recorded != hashes) & compared)
        if len(wrong):
            first = int(wrong[0])
            self._suspect = Difference(
                calls.step, int(envs[first]), "hash", int(recorded[first]), int(hashes[first])
            )

    def finish(self) -> None:
        """The log ended.

        Raises:
            Found: If a hash was wrong and no later row told the field.
        """
        if self._suspect is not None:
            raise Found(self._suspect)

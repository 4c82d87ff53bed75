"""`Simulation`: follows a log on an engine; simulates its physics again and compares it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import F64, EnvIndex
from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine
from embodichain.lab.sim.engine.fields import DERIVED_FIELDS
from embodichain.recording.format.attachments import check_rows
from embodichain.recording.format.block import Call, Run
from embodichain.recording.format.columns import column_name
from embodichain.recording.format.hashing import row_hashes
from embodichain.recording.format.log_error import LogError
from embodichain.recording.read.chunks import LogReader
from embodichain.recording.read.trajectory import Rows, columns_of

__all__ = ["TOLERANCE", "Active", "Difference", "DifferenceFound", "Simulation", "always", "never"]

TOLERANCE = {"qpos": 1e-3, "qvel": 0.1}
"""Largest differences of one control step between engines: m or rad, m/s or rad/s."""
Active = Callable[[int], NDArray[np.bool_]]
"""Control step to an (n,) mask of the selected environments that are compared in it."""


@dataclass(frozen=True, slots=True)
class Difference:
    """The first difference between the log and the simulation.

    Attributes:
        step: Control step, from 0.
        env: The environment.
        field: Component and index, ``qpos[3]``; ``hash`` if the log has only a hash of the result
            of physics.
        recorded: The value in the log.
        simulated: The simulated value.
    """

    step: int
    env: int
    field: str
    recorded: float | int
    simulated: float | int

    def __str__(self) -> str:
        """Return one line."""
        if self.field == "hash":
            values = f"recorded {self.recorded:#018x}, simulated {self.simulated:#018x}"
        else:
            values = f"recorded {self.recorded!r}, simulated {self.simulated!r}"
        return f"step {self.step}, environment {self.env}, {self.field}: {values}"


class DifferenceFound(LogError):
    """Simulating a log does not give the recorded states.

    Args:
        path: The log.
        difference: The first difference.
    """

    def __init__(self, path: Path, difference: Difference) -> None:
        super().__init__(f"{path} does not simulate to what it says: {difference}")
        self.difference = difference


def always(n: int) -> Active:
    """All of n environments, in every step."""
    mask = np.ones(n, np.bool_)
    return lambda step: mask


def never(n: int) -> Active:
    """None of n environments: all results of physics are taken from the log."""
    mask = np.zeros(n, np.bool_)
    return lambda step: mask


class Simulation(Rows):
    """Selected environments of a log on a separate engine.

    Physics is simulated where it is compared, or where the log has no states; otherwise its result
    is taken from the log.

    Args:
        reader: The log.
        model: The model.
        env_ids: (n,) environments, ascending; None is all.
        active: Which environments are compared in which step; None is all.
        exact: Compare bit for bit; else measure errors, and continue from the recorded states.
        repeats: Whether physics is that of the log's engine; else only its results are measured.
        num_threads: Physics threads; 0 is all cores.

    Attributes:
        engine: The engine; its environment i is the i-th selected one.
        changes: Number of writes to model fields.
        largest_error: If not `exact`: component to largest absolute difference.
        measured: Number of states of environments that were measured.
        outside: Number of these that differ by more than `TOLERANCE`.

    Raises:
        LogError: If the log's rows do not match the model.
    """

    def __init__(
        self,
        reader: LogReader,
        model: mujoco.MjModel,
        env_ids: EnvIndex | None = None,
        active: Active | None = None,
        exact: bool = True,
        num_threads: int = 0,
        repeats: bool = True,
    ) -> None:
        super().__init__(reader, env_ids)
        header = self.header
        check_rows(header, model)
        n = len(self.env_ids)
        self.engine = CpuEngine(model, n, num_threads)
        self.changes = 0
        self.largest_error: dict[str, float] = {}
        self.measured = self.outside = 0
        self._rows = self.engine.rows
        self._layout = header.slices()
        self._active = active or always(n)
        self._exact = exact
        self._repeats = exact and repeats

    def begin(self, run: Run) -> None:
        """Continue from a start of the log; compare it if the preceding steps were simulated.

        Raises:
            DifferenceFound: If the simulated state differs from the start.
            LogError: If the start does not match the model.
        """
        _, take_rows = self.chosen(None)
        fields = {name: values[0][take_rows] for name, values in run.calls[0].arrays.items()}
        row = fields.pop("row")
        if self.known and run.first == self.next_step:
            self._compare(run.first, None, row, slice(None), self._exact)
            if self._exact:
                return
        try:
            self._put_fields(fields)
            self.engine.write("row", row)
        except (KeyError, ValueError, IndexError) as error:
            raise LogError(
                f"{self.path}: step {run.first}: a start does not fit the model: {error}"
            ) from error
        self.known = True
        self.next_step = run.first

    def _put_fields(self, fields: dict[str, F64]) -> None:
        for again in range(2 if DERIVED_FIELDS & fields.keys() else bool(fields)):
            if again:
                self.engine.set_const()
            for name, values in fields.items():
                self.engine.write_model(name, values)
        self.changes += bool(fields)

    def write(self, step: int, call: Call, local: EnvIndex | None, values: F64 | None) -> None:
        """Apply a write outside physics.

        Raises:
            DifferenceFound: If a reset gives other rows than recorded.
        """
        engine = self.engine
        mode = call.kind.mode
        if mode == "set_const":
            engine.set_const(local)
        elif mode == "reset":
            engine.reset(local)
            if values is not None and not self.header.has_writes:
                engine.write("row", values, local)  # after the reset's events, too
            elif values is not None:
                self._settle(step, local, values, slice(None), self._exact)
        else:
            put = engine.write_model if mode == "model" else engine.write
            put(call.kind.name, values, local, columns_of(call.kind.columns))
        self.changes += mode in ("model", "set_const")

    def physics(
        self, step: int, call: Call, t: int, local: EnvIndex | None, take: EnvIndex | slice
    ) -> None:
        """Step physics and compare the result.

        Raises:
            DifferenceFound: If it differs from the recorded one.
        """
        engine = self.engine
        nstep = call.kind.nstep
        if "hashes" in call.arrays:
            engine.step(nstep, local)
            if self._repeats:
                self._compare_hashes(step, local, call.arrays["hashes"][t][take])
            return
        recorded = call.arrays["rows"][t][take]
        active = self._active(step)
        active = active if local is None else active[local]
        if active.any():
            ids = np.arange(len(active)) if local is None else local
            engine.step(nstep, None if local is None and active.all() else ids[active])
        self._settle(step, local, recorded, self.moved.columns, self._repeats)

    def _settle(
        self,
        step: int,
        local: EnvIndex | None,
        recorded: F64,
        columns: NDArray[np.int64] | slice,
        exact: bool,
    ) -> None:
        """Compare rows with the recorded ones; copy the recorded ones if not all are compared."""
        self._compare(step, local, recorded, columns, exact)
        active = self._active(step)
        if not exact or not active.all():
            self.engine.write("row", recorded, local, columns)

    def _compare(
        self,
        step: int,
        local: EnvIndex | None,
        recorded: F64,
        columns: NDArray[np.int64] | slice,
        exact: bool,
    ) -> None:
        active = self._active(step)
        active = active if local is None else active[local]
        if not active.any():
            return
        here = self._taken(local, columns)
        if not exact:
            self._measure(here[active], recorded[active], columns)
            return
        there = np.ascontiguousarray(recorded).view(np.uint64)
        differs = here.view(np.uint64) != there
        differs &= active[:, None]
        if not differs.any():
            return
        row, at = divmod(int(np.flatnonzero(differs)[0]), differs.shape[1])
        column = int(np.arange(self.header.nstate)[columns][at])
        name = column_name(self._layout, column)
        self._differ(step, local, row, name, float(recorded[row, at]), float(here[row, at]))

    def _taken(self, local: EnvIndex | None, columns: NDArray[np.int64] | slice) -> F64:
        """(n, k) columns of the simulated rows, contiguous."""
        rows = self.rows if local is None else self.rows[local]
        if isinstance(columns, slice):
            return np.ascontiguousarray(rows[:, columns])
        return self.moved.take(rows)

    def _compare_hashes(
        self, step: int, local: EnvIndex | None, recorded: NDArray[np.uint64]
    ) -> None:
        active = self._active(step)
        hashes = row_hashes(self.moved.take(self.rows if local is None else self.rows[local]))
        wrong = np.flatnonzero((hashes != recorded) & (active if local is None else active[local]))
        if len(wrong):
            row = int(wrong[0])
            self._differ(step, local, row, "hash", int(recorded[row]), int(hashes[row]))

    def _differ(
        self, step: int, local: EnvIndex | None, row: int, field: str, *values: float
    ) -> NoReturn:
        env = int(self.env_ids[row if local is None else local[row]])
        raise DifferenceFound(self.path, Difference(step, env, field, *values))

    def _measure(self, here: F64, there: F64, columns: NDArray[np.int64] | slice) -> None:
        """Update the largest errors of positions and velocities, and count large ones."""
        index = np.arange(self.header.nstate)[columns]
        outside = np.zeros(len(here), np.bool_)
        for name in ("qpos", "qvel"):
            component = self._layout[name]
            mine = (index >= component.start) & (index < component.stop)
            error = np.abs(here[:, mine] - there[:, mine])
            largest = float(error.max()) if error.size else 0.0
            self.largest_error[name] = max(self.largest_error.get(name, 0.0), largest)
            outside |= ~(error <= TOLERANCE[name]).all(axis=1)
        self.measured += len(here)
        self.outside += int(outside.sum())

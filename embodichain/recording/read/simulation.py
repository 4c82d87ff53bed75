"""`Simulation`: follows a log on an engine; simulates its physics again and compares it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import F64
from embodichain.lab.sim.engine.cpu.cpu_engine import CpuEngine
from embodichain.lab.sim.engine.fields import DERIVED_FIELDS
from embodichain.recording.format.attachments import check_rows
from embodichain.recording.format.log_error import LogError
from embodichain.recording.format.messages.block import Call, Run
from embodichain.recording.format.messages.columns import column_name
from embodichain.recording.format.messages.hashing import row_hashes
from embodichain.recording.read.chunks import LogReader
from embodichain.recording.read.trajectory import FollowedRows, columns_of
from embodichain.utils.array_types import EnvIds

__all__ = ["TOLERANCE", "Active", "Difference", "DifferenceFound", "Simulation", "always", "never"]

TOLERANCE = {"qpos": 1e-3, "qvel": 0.1}
"""Largest differences of one control step between engines: m or rad, m/s or rad/s."""
Active = Callable[[int], NDArray[np.bool_]]
"""Control step -> (n,) mask of the selected environments that are compared in it."""


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
        super().__init__(f"{path} does not give the recorded states when simulated: {difference}")
        self.difference = difference


def always(n: int) -> Active:
    """All of n environments, in every step."""
    mask = np.ones(n, np.bool_)
    return lambda step: mask


def never(n: int) -> Active:
    """None of n environments: all results of physics are taken from the log."""
    mask = np.zeros(n, np.bool_)
    return lambda step: mask


class Simulation(FollowedRows):
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
        largest_error: If not `exact`: component -> largest absolute difference.
        measured: Number of states of environments that were measured.
        outside: Number of these that differ by more than `TOLERANCE`.

    Raises:
        LogError: If the log's rows do not match the model.
    """

    def __init__(
        self,
        reader: LogReader,
        model: mujoco.MjModel,
        env_ids: EnvIds | None = None,
        active: Active | None = None,
        exact: bool = True,
        num_threads: int = 0,
        repeats: bool = True,
    ) -> None:
        super().__init__(reader, env_ids)
        check_rows(self.header, model)
        num_envs = len(self.env_ids)
        self.engine = CpuEngine(model, num_envs, num_threads)
        self.changes = 0
        self.largest_error: dict[str, float] = {}
        self.measured = 0
        self.outside = 0
        self._rows = self.engine.rows
        self._layout = self.header.slices()
        self._active = active or always(num_envs)
        self._exact = exact
        self._exact_physics = exact and repeats

    def is_compared(self, step: int) -> bool:
        """Whether any environment is compared in a control step."""
        return bool(self._active(step).any())

    def _active_of(self, step: int, local: EnvIds | None) -> NDArray[np.bool_]:
        """Which of some environments (None: all) are compared in a control step."""
        active = self._active(step)
        if local is None:
            return active
        return active[local]

    def begin(self, run: Run) -> None:
        """Continue from a start of the log; compare it if the preceding steps were simulated.

        Raises:
            DifferenceFound: If the simulated state differs from the start.
            LogError: If the start does not match the model.
        """
        positions = self.selection(None).positions
        fields = {name: values[0][positions] for name, values in run.calls[0].arrays.items()}
        row = fields.pop("row")
        if self.rows_are_known and run.first == self.next_step:
            # The steps before this start were followed, so their result can be compared with it.
            self._compare(run.first, None, recorded=row, columns=slice(None), exact=self._exact)
            if self._exact:
                return
        try:
            self._write_fields(fields)
            self.engine.write("row", row)
        except (KeyError, ValueError, IndexError) as error:
            raise LogError(
                f"{self.path}: step {run.first}: a start does not fit the model: {error}"
            ) from error
        self.rows_are_known = True
        self.next_step = run.first

    def _write_fields(self, fields: dict[str, F64]) -> None:
        """Write model fields of every environment."""
        if not fields:
            return
        for name, values in fields.items():
            self.engine.write_model(name, values)
        if DERIVED_FIELDS & fields.keys():
            # `set_const` computes derived fields from all others. A derived field may have been
            # written directly, too: then its recorded value is another one.
            self.engine.set_const()
            for name, values in fields.items():
                self.engine.write_model(name, values)
        self.changes += 1

    def write(self, step: int, call: Call, local: EnvIds | None, values: F64 | None) -> None:
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
                # These rows have what the reset's events wrote too, so they cannot be compared.
                engine.write("row", values, local)
            elif values is not None:
                self._compare_or_copy(
                    step, local, recorded=values, columns=slice(None), exact=self._exact
                )
        elif mode == "model":
            engine.write_model(call.kind.name, values, local, columns_of(call.kind.columns))
        else:
            engine.write(call.kind.name, values, local, columns_of(call.kind.columns))
        self.changes += mode in ("model", "set_const")

    def physics(
        self, step: int, call: Call, t: int, local: EnvIds | None, positions: EnvIds | slice
    ) -> None:
        """Step physics and compare the result.

        Raises:
            DifferenceFound: If it differs from the recorded one.
        """
        nstep = call.kind.nstep
        if "hashes" in call.arrays:
            # The log has no states to continue from: all environments are simulated.
            self.engine.step(nstep, local)
            if self._exact_physics:
                self._compare_hashes(step, local, call.arrays["hashes"][t][positions])
            return
        recorded = call.arrays["rows"][t][positions]
        active = self._active_of(step, local)
        if local is None and active.all():
            self.engine.step(nstep, None)
        elif active.any():
            env_ids = np.arange(len(active)) if local is None else local
            self.engine.step(nstep, env_ids[active])
        self._compare_or_copy(
            step, local, recorded, columns=self.moved.columns, exact=self._exact_physics
        )

    def _compare_or_copy(
        self,
        step: int,
        local: EnvIds | None,
        recorded: F64,
        columns: NDArray[np.int64] | slice,
        exact: bool,
    ) -> None:
        """Compare rows with the recorded ones; copy the recorded ones if not all are compared."""
        self._compare(step, local, recorded=recorded, columns=columns, exact=exact)
        if not exact or not self._active(step).all():
            self.engine.write("row", recorded, local, columns)

    def _compare(
        self,
        step: int,
        local: EnvIds | None,
        recorded: F64,
        columns: NDArray[np.int64] | slice,
        exact: bool,
    ) -> None:
        """Compare simulated rows with the recorded ones, where environments are compared.

        Args:
            step: The control step.
            local: (n,) environments of the engine; None is all.
            recorded: (n, k) recorded columns of their rows.
            columns: The k columns.
            exact: Raise at the first bit that differs; else measure the errors.
        """
        active = self._active_of(step, local)
        if not active.any():
            return
        simulated = self._simulated(local, columns)
        if not exact:
            self._measure(simulated[active], recorded[active], columns)
            return
        recorded_bits = np.ascontiguousarray(recorded).view(np.uint64)
        differs = simulated.view(np.uint64) != recorded_bits
        differs &= active[:, None]
        if not differs.any():
            return
        row, index = divmod(int(np.flatnonzero(differs)[0]), differs.shape[1])
        column = int(np.arange(self.header.nstate)[columns][index])
        raise self._difference(
            step,
            env=self._env_of(local, row),
            field=column_name(self._layout, column),
            recorded=float(recorded[row, index]),
            simulated=float(simulated[row, index]),
        )

    def _simulated(self, local: EnvIds | None, columns: NDArray[np.int64] | slice) -> F64:
        """(n, k) columns of the simulated rows, contiguous."""
        rows = self.rows if local is None else self.rows[local]
        if isinstance(columns, slice):
            return np.ascontiguousarray(rows[:, columns])
        return self.moved.take(rows)

    def _compare_hashes(
        self, step: int, local: EnvIds | None, recorded: NDArray[np.uint64]
    ) -> None:
        rows = self.rows if local is None else self.rows[local]
        hashes = row_hashes(self.moved.take(rows))
        differs = np.flatnonzero((hashes != recorded) & self._active_of(step, local))
        if len(differs):
            row = int(differs[0])
            raise self._difference(
                step,
                env=self._env_of(local, row),
                field="hash",
                recorded=int(recorded[row]),
                simulated=int(hashes[row]),
            )

    def _env_of(self, local: EnvIds | None, row: int) -> int:
        """The log's number of the environment of a row of a call."""
        index = row if local is None else int(local[row])
        return int(self.env_ids[index])

    def _difference(
        self, step: int, env: int, field: str, recorded: float, simulated: float
    ) -> DifferenceFound:
        return DifferenceFound(self.path, Difference(step, env, field, recorded, simulated))

    def _measure(self, simulated: F64, recorded: F64, columns: NDArray[np.int64] | slice) -> None:
        """Update the largest errors of positions and velocities, and count large ones."""
        column_ids = np.arange(self.header.nstate)[columns]
        outside = np.zeros(len(simulated), np.bool_)
        for name in ("qpos", "qvel"):
            component = self._layout[name]
            is_component = (column_ids >= component.start) & (column_ids < component.stop)
            error = np.abs(simulated[:, is_component] - recorded[:, is_component])
            largest = float(error.max()) if error.size else 0.0
            self.largest_error[name] = max(self.largest_error.get(name, 0.0), largest)
            # Written so that NaN is outside too.
            outside |= ~(error <= TOLERANCE[name]).all(axis=1)
        self.measured += len(simulated)
        self.outside += int(outside.sum())

"""`Playback`: one environment of a log, step after step, on an engine of its own.

Nothing is simulated: recorded rows are shown as they are, on the model as the environment had it.
Who draws them, and at which speed, is known elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from embodichain.lab.sim.engine.base import F64
from embodichain.lab.sim.engine.cpu import CpuEngine
from embodichain.recording import wire
from embodichain.recording.api import Log
from embodichain.recording.columns import spread
from embodichain.recording.header import LogError
from embodichain.recording.messages import State, WriteRecord
from embodichain.utils.errors import ConfigError

__all__ = ["Playback", "Span", "span_of"]


@dataclass(frozen=True, slots=True)
class Span:
    """Control steps, both included; `last` None is the end of the log."""

    first: int = 0
    last: int | None = None

    def __contains__(self, step: int) -> bool:
        """Whether a step is one of them."""
        return self.first <= step and not self.ends_before(step)

    def ends_before(self, step: int) -> bool:
        """Whether a step comes after the last."""
        return self.last is not None and step > self.last


def span_of(
    log: Log,
    env: int,
    episode: int | None = None,
    first: int | None = None,
    last: int | None = None,
) -> Span:
    """The control steps that are meant.

    Args:
        log: The log.
        env: The environment.
        episode: One of its episodes; None is all.
        first: First control step, counted from the start of the log; None is the first.
        last: Last control step, included; None is the last.

    Raises:
        ConfigError: If the environment or the episode does not exist, or the range is none.
    """
    if not 0 <= env < log.num_envs:
        there = f"there are 0 to {log.num_envs - 1}"
        raise ConfigError(f"no environment {env} in the log: {there}")
    start, end = first or 0, last
    if episode is not None:
        mine = {e.episode: e for e in log.episodes if e.env == env}
        if episode not in mine:
            there = f"there are {min(mine)} to {max(mine)}" if mine else "there is none"
            raise ConfigError(f"no episode {episode} of environment {env} in the log: {there}")
        found = mine[episode]
        start = max(start, found.first_step)
        end = found.last_step if end is None else min(end, found.last_step)
    if start < 0 or (end is not None and end < start):
        raise ConfigError(f"no control steps from {start} to {end}")
    return Span(start, end)


class Playback:
    """One environment as it was recorded.

    Args:
        log: The log; it must have states.
        env: The environment.

    Attributes:
        engine: Holds the state of the step that was last reached: one environment, number 0.
        changes: How often the environment's model was written to so far.

    Raises:
        ConfigError: If there is no such environment.
        LogError: If the log has no states, or its model cannot be loaded.
    """

    def __init__(self, log: Log, env: int) -> None:
        if not 0 <= env < log.num_envs:
            there = f"there are 0 to {log.num_envs - 1}"
            raise ConfigError(f"no environment {env} in the log: {there}")
        log.header.require_states(log.path)
        self.log = log
        self.env = env
        self.engine = CpuEngine(log.model, 1, num_threads=1)
        self.changes = 0
        self._row: F64 | None = None  # of the step being read, as physics received it
        self._later: list[WriteRecord] = []  # writes to the model after that

    def steps(self, span: Span, every: int = 1) -> Iterator[int]:
        """Yield control steps; the engine then holds what physics received in them.

        Can be called once.

        Args:
            span: Which steps.
            every: 2 leaves out every second, and so on; the first is always there.

        Raises:
            LogError: If a message is damaged, or does not fit the model.
        """
        step = -1
        for topic, _, payload in self.log.full_messages(self.env):
            try:
                if topic == "/sim/write":
                    self._on_write(WriteRecord.decode(payload))
                elif topic == "/sim/state":
                    step = self._on_state(State.decode(payload))
                elif topic == "/sim/step" and self._row is not None:
                    if step in span and not (step - span.first) % every:
                        self.engine.write("row", self._row)
                        yield step
                    if span.last is not None and step >= span.last:
                        return
                    self._next()
            except (wire.WireError, IndexError, KeyError, ValueError) as error:
                raise LogError(f"{self.log.path}: a message is damaged: {error}") from error

    def _on_state(self, state: State) -> int:
        """Keep the row of a step: of all environments, with the step's number of physics steps."""
        header = self.log.header
        own = state.env_ids is None and state.nstep == header.substeps
        if own and (self._row is None or state.step == 0):
            self._next()  # before step 0 things may settle: its last row counts
            row = state.rows[self.env : self.env + 1]
            self._row = spread(header.columns, row, header.nstate)
        return state.step

    def _on_write(self, write: WriteRecord) -> None:
        if write.op not in ("model", "set_const"):
            return  # rows hold what was written to the state
        if self._row is None:
            self._apply(write)
        else:
            self._later.append(write)

    def _next(self) -> None:
        """What was written to the model since the row belongs to the next one."""
        for write in self._later:
            self._apply(write)
        self._later.clear()
        self._row = None

    def _apply(self, write: WriteRecord) -> None:
        ids = np.arange(self.log.num_envs) if write.env_ids is None else write.env_ids
        found = np.flatnonzero(ids == self.env)
        if not len(found):
            return
        self.changes += 1
        if write.op == "set_const":
            self.engine.set_const()
        else:
            values = write.values.reshape(len(ids), -1)[found]
            self.engine.write_model(write.field, values, None, write.columns)

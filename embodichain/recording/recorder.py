"""`McapRecorder`: watches an environment and writes its log.

It only collects and hands over to another process (`writer`): what replay needs is `state_log`,
what people look at is `foxglove.views`, both come together in `log_builder`.
"""

from __future__ import annotations

import atexit
import json
import time
import weakref
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.observers import EventRecord, StepObserver, StepRecord
from embodichain.lab.sim.engine.base import EnvIndex, PhysicsEvent, Write
from embodichain.lab.sim.engine.layout import row_layout
from embodichain.recording.attachments import attachments_of, model_bytes
from embodichain.recording.columns import NEEDS_HEED, RowColumns
from embodichain.recording.episode_gate import EpisodeGate
from embodichain.recording.episode_log import Ends
from embodichain.recording.foxglove.layout import foxglove_layout
from embodichain.recording.foxglove.views import Views
from embodichain.recording.header import check_keyframes
from embodichain.recording.log_head import LogHead, RecordStats, header_of
from embodichain.recording.options import (
    RecordLike,
    RecordOptions,
    check_options,
)
from embodichain.recording.seen_together import VIEW
from embodichain.recording.writer import LogWriter

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv

__all__ = ["McapRecorder", "RecordStats"]


class McapRecorder(StepObserver):
    """Records an environment from now on; attach it with `env.add_observer` at once.

    Build it before the first `env.reset()`. The simulation's state at that moment, its randomized
    model fields included, is written first, so a log that starts later verifies as well.

    Args:
        path: A new file. Its folder must exist; ``foxglove_layout.json`` is put beside it.
        env: The environment.
        config: The resolved config as YAML text.
        overrides: The command line's overrides.
        options: What to record.
        task: The task's name.

    Raises:
        ConfigError: If an option is not allowed.
        FileExistsError: If `path` exists.
    """

    def __init__(
        self,
        path: str | Path,
        env: ObservedEnv,
        config: str = "",
        overrides: str | Sequence[str] = (),
        options: RecordLike | None = None,
        task: str = "",
    ) -> None:
        options = RecordOptions() if options is None else options
        check_options(options, env.num_envs)
        engine = env.sim.engine
        check_keyframes(options, engine.model)
        self._columns = RowColumns(row_layout(engine.model))
        self._period_ns = round(env.step_dt * 1e9)
        self._start_ns = time.time_ns()
        self._step = 0
        self._closed = False
        self._keeps_state = options.state != "none"
        self._gate = EpisodeGate(options.every, next(iter(options.view_envs), 0))
        self._substeps = int(env.sim_steps_per_control)
        self._keyframe_every = options.keyframe_every if options.state == "keyframes" else 0
        # What is reset in the middle of a step, or changed by a plugin, no write tells.
        self._derives = not (self._keyframe_every or engine.steps_write_inputs)
        self._keyframe_due = True
        self._keyframe = -1  # control step of the newest one
        self._view_envs = [int(i) for i in options.view_envs]
        self._engine = engine
        self._max_bytes = 0.0 if options.max_mb is None else options.max_mb * 1e6
        self._places: dict[object, int] = {}
        self._known = False  # whether the writer can tell every row from calls and writes
        self._as_written = False  # whether physics is at it, with rows that the writer can tell
        self._told = 0  # width of the rows that the writer knows of
        self._parts = 0  # files that were asked for after the first
        known = self._derives and self._keeps_state
        self._views = Views(env, options, self._push, self._now, rows_known=known)
        make_head = self._head(env, options, config, overrides, task)
        # A slab holds the rows of two steps, and half as much again of the rest.
        step_bytes = 3 * 8 * env.num_envs * self._columns.width
        self._file = LogWriter(Path(path), options.compression, make_head, step_bytes)
        if not self._columns.narrow_enough(engine.rows):
            self._columns.widen()
        self._tell_columns()
        model_fields = engine.state_dict()["model"]
        self._write_start(model_fields)
        self._views.start(model_fields)
        # A program that fails without closing still leaves a whole log.
        self._at_exit = partial(_close_if_alive, weakref.ref(self))
        atexit.register(self._at_exit)

    def _head(
        self,
        env: ObservedEnv,
        options: RecordLike,
        config: str,
        overrides: str | Sequence[str],
        task: str,
    ) -> Callable[[], LogHead]:
        """What makes the head of the log, on another thread: packing a scene takes a while."""
        model, spec = env.sim.engine.model, env.sim.scene.spec
        layout = foxglove_layout(env, options.view_envs)
        mjb = model_bytes(model)
        header = header_of(env, options, self._columns, mjb, task, self._start_ns)
        views, rolls = self._views.spec, bool(self._max_bytes)

        def make() -> LogHead:
            attachments = attachments_of(mjb, spec, config, overrides, layout)
            return LogHead(header, attachments, views, json.dumps(layout, indent=1), rolls)

        return make

    def _write_start(self, model_fields: dict[str, NDArray[Any]]) -> None:
        """Say what the simulation is now: a file begins."""
        if self._keeps_state:
            fields = {name: np.array(values) for name, values in model_fields.items()}
            self._file.call("start", self._engine.rows.copy(), fields)
        self._file.call("began")

    def _roll(self) -> None:
        """Go on in another file, from the state that the simulation has right now."""
        self._parts += 1
        self._file.call("roll", self._step)
        self._write_start(self._engine.model_fields())
        self._views.show(self._view_envs)
        self._keyframe_due = True

    @property
    def _full(self) -> bool:
        """Whether the file in progress has reached its size.

        A file holds at least as much of the run as it has attachments.
        """
        if self._file.ahead > self._max_bytes / 4:
            self._file.catch_up()
        written = self._file.counters
        here = written.part == self._parts and written.head_bytes > 0
        return here and written.size > max(self._max_bytes, 2 * written.head_bytes)

    def _push(self, method: str, *args: object) -> None:
        """Called by the views."""
        self._file.call(VIEW + method, *args)

    def _now(self) -> int:
        return self._start_ns + self._step * self._period_ns

    @property
    def stats(self) -> RecordStats:
        """What has been written so far."""
        return RecordStats(self._file.path, self._step, self._file.counters.nbytes)

    @property
    def writer_pid(self) -> int:
        """The process that writes the file."""
        return self._file.worker_pid

    def on_write(self, env: ObservedEnv, write: Write) -> None:
        """Something outside physics was written to the simulation."""
        ids, values = write.env_ids, write.values
        if self._keeps_state and write.op != "forward" and (ids is None or len(ids)):
            if write.op != "state" or write.field == "row":
                self._known = False
            if write.field in NEEDS_HEED:
                self._columns.heed(write)
                self._tell_columns()
            if self._gate.open or write.op in ("model", "set_const"):
                place = self._place(write)
                if ids is None and values is not None:
                    self._file.call_alike("write", (place, None), values)
                else:
                    self._file.call("write", place, ids, values)
        if write.op == "model":
            self._views.on_model_write(write)

    def _place(self, write: Write) -> int:
        """Number of what is written and where, which is told once."""
        columns = write.columns
        if isinstance(columns, slice):
            span: object = (columns.start, columns.stop, columns.step)
        else:
            span = columns.tobytes()
        key = write.op, write.field, span
        number = self._places.get(key)
        if number is None:
            number = self._places[key] = len(self._places)
            self._file.call("place", number, write.op, write.field, columns)
        return number

    def _tell_columns(self) -> None:
        """Say which columns are handed over from now on, if that has changed."""
        if self._told != self._columns.width:
            self._told = self._columns.width
            self._file.call("columns", self._columns.ranges)

    def on_physics(self, env: ObservedEnv, event: PhysicsEvent) -> None:
        """Physics is about to step, or has just stepped."""
        ids = event.env_ids
        before = event.phase == "before"
        if before and ids is None and event.nstep == self._substeps:
            self._gate.on_physics()
        if not self._gate.open:
            self._known = False
            return
        if before and ids is None:  # first: what is shown is shown with these rows
            self._views.on_rows(self._step, event.rows)
        if self._keeps_state:
            if before:
                self._before(event)
            else:
                method, self._as_written = "stepped" if self._as_written else "after", False
                self._take(method, (event.nstep, ids, event.failed), event)

    def _before(self, event: PhysicsEvent) -> None:
        """Hand over the rows that physics receives, unless they follow from what was before."""
        nstep, ids = event.nstep, event.env_ids
        self._as_written = False
        if self._keyframe_every and not self._is_keyframe(event):
            self._file.call("before", nstep, ids, None)
        elif self._known:
            self._as_written = True  # said together with what physics returns
        else:
            self._take("before", (nstep, ids), event)
            self._known = ids is None and self._derives

    def _take(self, method: str, args: tuple[object, ...], event: PhysicsEvent) -> None:
        """Hand over the rows of a physics call."""
        columns, rows = self._columns, event.rows
        width, take = columns.width, columns.take
        if event.env_ids is not None:
            rows = rows[event.env_ids]
        elif method == "stepped":
            width, take = columns.moved_width, columns.take_moved
        alike = event.env_ids is None and event.failed is None
        self._file.call_with(method, args, (len(rows), width), partial(take, rows), alike)

    def _is_keyframe(self, event: PhysicsEvent) -> bool:
        """Whether this call's rows are written: the first of a step's own physics, when due.

        Before the first step things may settle for as long: there each such call's are, since the
        last one is the step's own.
        """
        step = self._step
        due = self._keyframe_due or step % self._keyframe_every == 0
        own = event.env_ids is None and event.nstep == self._substeps
        if not own or not due or (step > 0 and self._keyframe == step):
            return False
        self._keyframe, self._keyframe_due = step, False
        return True

    def on_event(self, env: ObservedEnv, event: EventRecord) -> None:
        """A term of the event manager fired."""
        if not self._gate.open:
            self._gate.hold(event)
            return
        ids, drawn = event.env_ids, event.drawn.values()
        if ids is None:
            what = event.term, event.mode, None, tuple(event.drawn)
            self._file.call_alike("event", what, *drawn)
        else:
            self._file.call("event", event.term, event.mode, ids, tuple(event.drawn), *drawn)

    def on_reset(self, env: ObservedEnv, env_ids: EnvIndex) -> None:
        """Environments were reset."""
        if self._gate.open:
            self._views.on_reset(env_ids)
        self._go_on(env, self._gate.on_reset(env_ids))

    def _go_on(self, env: ObservedEnv, held: list[EventRecord] | None, skip: bool = False) -> None:
        """Between two steps: record again if the gate has just opened, from the state right now.

        Args:
            env: The environment.
            held: The events that led there; None if it has not.
            skip: Whether the step that ended is not in the log.
        """
        for event in held or ():
            self.on_event(env, event)
        if skip:
            self._file.call("skip")
        if held is not None:
            self.on_write(env, Write("state", "row", None, slice(None), self._engine.rows))
            self._keyframe_due = True
            self._views.show(self._view_envs)

    def on_step(self, env: ObservedEnv, step: StepRecord) -> None:
        """A control step ended."""
        ends = Ends.of(step, env.termination_manager.values)
        recorded = self._gate.open
        # Copies: the caller of `step` may write into what it was handed.
        if not recorded:
            reward, ids = step.reward.copy(), step.episode_ids.copy()
            self._file.call("unseen_step", ends, reward, ids)
        else:
            what = step.action, step.reward, step.episode_ids
            if ends is None:
                self._file.call_alike("step", (None,), *what)
            else:
                over = step.terminated, step.truncated
                self._file.call("step", ends, *(array.copy() for array in (*what, *over)))
            self._views.on_step(self._step, step, ended=ends is not None)
        held = self._gate.switch()
        if held is not None or not recorded:
            self._go_on(env, held, skip=not recorded)
        self._step += 1
        if self._max_bytes and self._full:
            self._roll()
        self._file.hand_over_when_due()

    def on_close(self, env: ObservedEnv) -> None:
        """The environment closes."""
        self.close()

    def flush(self) -> None:
        """Wait until everything recorded so far is in the file, where readers find it.

        Nobody has to call this: the file is flushed within a second. After `close` it does nothing.

        Raises:
            OSError: If the file could not be written.
        """
        if not self._closed:
            self._file.flush()

    def close(self) -> None:
        """Write the last rows and finish the file. A second call does nothing.

        Raises:
            OSError: If the file could not be written, and no step said so before.
        """
        if self._closed:
            return
        self._closed = True
        atexit.unregister(self._at_exit)
        if self._file.lost:
            self._file.close()
            return
        try:
            if self._keeps_state and self._gate.open:
                rows, columns = self._engine.rows, self._columns
                shape = len(rows), columns.width
                self._file.call_with("end", (), shape, partial(columns.take, rows))
            self._views.close(self._step, self._engine.rows)
            self._file.call("finish", self._step)
        finally:
            self._file.close()


def _close_if_alive(recorder: weakref.ref[McapRecorder]) -> None:
    found = recorder()
    if found is not None:
        found.close()

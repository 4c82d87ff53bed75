"""`McapRecorder`: observes an environment and writes its log.

It collects the calls of each control step, and writes several steps at a time.
"""

from __future__ import annotations

import atexit
import time
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.observers import EventRecord, StepObserver, StepRecord
from embodichain.lab.sim.engine.api import EnvIndex, PhysicsEvent, Write
from embodichain.recording.format.attachments import attachments_of, model_bytes, model_digest
from embodichain.recording.format.block import DRAWN, ArrayKind, CallKind, Recorded
from embodichain.recording.format.columns import Moved
from embodichain.recording.format.hashing import row_hashes
from embodichain.recording.format.header import check_keyframes, header_of
from embodichain.recording.format.options import RecordOptions, check_options
from embodichain.recording.format.parts import LogPlace
from embodichain.recording.read.episodes import Ends
from embodichain.recording.views.layout import foxglove_layout
from embodichain.recording.views.views import Views
from embodichain.recording.write.episode_gate import EpisodeGate
from embodichain.recording.write.log_writer import LogWriter, Queue
from embodichain.recording.write.writing import Writing

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv
    from embodichain.recording.views.images import Images
    from embodichain.recording.views.pictures import FirstPictures

__all__ = ["McapRecorder", "RecordStats"]

MOST_STEPS, MOST_BYTES, MOST_SECONDS = 256, 2**20, 0.25
"""Steps are written when they are this many, have about this many bytes, or this age."""
FLUSH_SECONDS = 0.5
"""Interval between flushes. With `MOST_SECONDS` and the timer's interval, at most one second is
lost when the process is killed."""
START_SHARE = 128
"""A start is written after other data of this many times its size."""


@dataclass(frozen=True, slots=True)
class RecordStats:
    """What a recorder has written.

    Attributes:
        path: The file; the first one if the log has several.
        steps: Number of control steps.
        nbytes: Size of the log so far.
    """

    path: Path
    steps: int
    nbytes: int


class McapRecorder(StepObserver):
    """Records an environment; attach it with `env.add_observer` right after it is built.

    Build it before the first `env.reset()`. The current state of the simulation, including
    randomized model fields, is written first, so a log that starts later can be verified too. With
    arrays on a device the log has states instead of writes (`Header.writes`).

    Args:
        path: A new file in an existing folder; ``foxglove_layout.json`` is written next to it.
        env: The environment.
        config: The resolved config as YAML text.
        overrides: The command line's overrides.
        options: What to record.
        task: The task's name.
        policy: The source of the actions, for the header.
        place: Where to continue a log that another recorder began (`begin_part`).
        quota: (N,) how many episodes of each environment count, its first ones; None if that is
            not known.
        lists_counted: Whether `count` lists the episodes that count.

    Raises:
        ConfigError: If an option is not allowed.
        FileExistsError: If `path` exists.
    """

    may_lag = True

    def __init__(
        self,
        path: str | Path,
        env: ObservedEnv,
        config: str = "",
        overrides: str | Sequence[str] = (),
        options: RecordOptions | None = None,
        task: str = "",
        policy: str = "",
        place: LogPlace | None = None,
        quota: Sequence[int] | None = None,
        lists_counted: bool = False,
    ) -> None:
        options = RecordOptions() if options is None else options
        check_options(options, env.num_envs)
        env = getattr(env, "observed", env)  # other classes have no device
        self._engine = env.sim.engine
        check_keyframes(options, self._engine)
        self._catch_up: Callable[[], None] = getattr(env, "catch_up", lambda: None)
        self._path = Path(path)
        self._start_ns = time.time_ns() if place is None else place.start_ns
        mjb = model_bytes(self._engine.model)
        header = header_of(env, options, model_digest(mjb), task, policy, self._start_ns)
        firsts = () if quota is None else tuple(int(count) for count in quota)
        if len(firsts) not in (0, env.num_envs):
            raise ValueError(f"quota has {len(firsts)} numbers for {env.num_envs} environments")
        header = replace(header, quota=firsts, lists_counted=lists_counted)
        self.lists_counted = lists_counted
        """Whether `count` lists the episodes that count."""
        self._moved, self._period_ns = Moved(header.moved), header.period_ns
        self._substeps, self._keyframe_every = header.substeps, header.keyframe_every
        self._call_steps = header.call_steps or header.substeps
        self._keeps_state = options.state != "none"
        self._gate = EpisodeGate(options.every, next(iter(options.view_envs), 0))
        self._max_bytes = (options.max_mb or 0.0) * 1e6
        self._view_envs = header.view_envs
        self._step = 0 if place is None else place.step
        self._since_start = self._start_bytes = 0
        self._calls: list[Recorded] = []  # since the last control step
        self._steps: list[list[Recorded]] = []  # finished, not written yet
        self._first = 0  # number of the first of these
        self._begun = 0.0  # when it was added, on the monotonic clock
        self._most = 1  # number of steps that are written together
        self._kinds: dict[object, CallKind] = {}
        self._flushed, self._closed = time.monotonic(), False
        images: list[str] = []
        if options.images is not None:
            from embodichain.recording.views.images import image_topics

            images = image_topics(env, options.images)
        layout = foxglove_layout(env, options.view_envs, images)
        attachments = attachments_of(mjb, env.sim.scene.spec, config, overrides, layout)
        self._log = LogWriter(self._path, options.compression, header, attachments, layout, place)
        self._views = Views(env, options, self._log.views, self._now)
        self._views.say("recording begins")
        self._drawing = _drawing(env, options, self._log.views, self._now)
        self._write_start()
        self._log.began()
        file = self._log.file
        self._writing = Writing(self._path, lambda: file.where_it_ends, self._tick)
        # A program that exits without closing the recorder still leaves a complete log.
        self._at_exit = partial(_close_if_alive, weakref.ref(self))
        atexit.register(self._at_exit)

    def _now(self) -> int:
        return self._start_ns + self._step * self._period_ns

    @property
    def stats(self) -> RecordStats:
        """What has been recorded so far."""
        return RecordStats(self._path, self._step, self._log.file.nbytes)

    # -- callbacks of the environment --------------------------------------------------------------

    def on_write(self, env: ObservedEnv, write: Write) -> None:
        """Record a write outside physics; for a reset, the resulting rows."""
        op, field, ids, columns, values = write
        if op == "model":
            self._views.on_model_write(write)
        if op == "forward" or not self._records(ids):
            return
        if op == "reset":
            values = self._engine.rows if ids is None else self._engine.rows[ids]
        shape = None if values is None else values.shape
        if isinstance(columns, slice):
            span: object = (columns.start, columns.stop, columns.step)
        else:
            span = columns.tobytes()
        key = op, field, span, shape, None if ids is None else len(ids)
        kind = self._kinds.get(key)
        if kind is None:
            kind = self._kinds[key] = self._kind_of(write, shape)
        arrays: tuple[NDArray[Any], ...] = ()
        if values is not None:
            arrays = (np.array(values, np.float64, order="C"),)
        self._calls.append((kind, arrays if ids is None else (ids.copy(), *arrays)))

    def _kind_of(self, write: Write, shape: tuple[int, ...] | None) -> CallKind:
        columns, named = write.columns, None
        if not isinstance(columns, slice):
            named = tuple(columns.tolist())
        elif write.op in ("state", "model") and columns != slice(None):
            named = tuple(range(*columns.indices(self._width_of(write))))
        values = () if shape is None else (ArrayKind("values", "<f8", shape),)
        return CallKind("write", write.field, write.op, 0, named, _of(write.env_ids) + values)

    def _width_of(self, write: Write) -> int:
        """Number of columns of the flattened field that is written."""
        if write.op == "state":
            if write.field == "row":
                return int(self._engine.rows.shape[1])
            columns = self._engine.component(write.field)
            return int(columns.stop - columns.start)
        owner: Any = self._engine.model
        for part in write.field.split("."):
            owner = getattr(owner, part)
        return int(np.size(owner))

    def _records(self, ids: EnvIndex | None) -> bool:
        """Whether calls for these environments are recorded."""
        return self._gate.open and self._keeps_state and (ids is None or len(ids) > 0)

    def on_physics(self, env: ObservedEnv, event: PhysicsEvent) -> None:
        """Pass the rows before physics to the views; record the rows after it."""
        phase, nstep, ids, rows, failed = event
        if phase == "before":
            if ids is None:
                again = nstep == self._call_steps < self._substeps and self._gate.in_step
                if nstep == self._call_steps:
                    self._gate.on_physics()
                if self._gate.open and not again:
                    self._views.on_rows(self._step, rows)
                    for part in self._drawing:
                        part.on_rows(self._step, rows)
            return
        if not self._records(ids):
            return
        result: NDArray[Any] = self._moved.take(rows if ids is None else rows[ids])
        if self._keyframe_every:
            result = row_hashes(result)
        failures = None if failed is None else len(failed)
        key = "physics", nstep, None if ids is None else len(ids), failures
        kind = self._kinds.get(key)
        if kind is None:
            name, dtype = ("hashes", "<u8") if self._keyframe_every else ("rows", "<f8")
            arrays = (*_of(ids), ArrayKind(name, dtype, result.shape))
            kind = CallKind("physics", nstep=nstep, arrays=arrays + _of(failed, "failed"))
            self._kinds[key] = kind
        if ids is None and failed is None:
            self._calls.append((kind, (result,)))
        else:
            more = [a for a in (ids, result, failed) if a is not None]
            self._calls.append((kind, tuple(np.ascontiguousarray(a) for a in more)))

    def on_event(self, env: ObservedEnv, event: EventRecord) -> None:
        """Record that a term of the event manager fired, and the values it drew."""
        if not self._gate.open:
            self._gate.hold(event)
            return
        self._views.on_event(event)
        if self._records(event.env_ids):
            term, mode, ids, drawn = event
            values = [np.array(v, np.float64, order="C") for v in drawn.values()]
            shapes = tuple(value.shape for value in values)
            key = "event", term, mode, None if ids is None else len(ids), (*drawn, *shapes)
            kind = self._kinds.get(key)
            if kind is None:
                named = zip(drawn, shapes, strict=True)
                arrays = tuple(ArrayKind(DRAWN + name, "<f8", shape) for name, shape in named)
                kind = self._kinds[key] = CallKind("event", term, mode, arrays=_of(ids) + arrays)
            self._calls.append((kind, tuple(values if ids is None else (ids.copy(), *values))))

    def on_reset(self, env: ObservedEnv, env_ids: EnvIndex) -> None:
        """Update the views after a reset; start or pause recording (`record.every`)."""
        for part in self._drawing:
            part.on_reset(env_ids)
        if self._gate.open:
            self._views.on_reset(env_ids)
        was_open = self._gate.open
        self._switched(env, was_open, self._gate.on_reset(env_ids))

    def on_step(self, env: ObservedEnv, step: StepRecord) -> None:
        """Record the end of a control step.

        Raises:
            LogWriteError: If the log could not be written; recording has stopped.
        """
        self._writing.check()
        number = self._step
        ends = Ends.of(step, env.termination_manager.values, judged=env.judges_success)
        if ends is not None:
            self._log.end_episodes(number, ends)
        was_open = self._gate.open
        if was_open:
            self._views.on_step(number, step, ended=ends is not None)
            # Copies: the caller of `step` may write into the arrays it received.
            arrays = (
                np.array(step.action, np.float64, order="C"),
                np.array(step.reward, np.float32, order="C"),
                step.terminated.copy(),
                step.truncated.copy(),
                step.episode_ids.copy(),
            )
            kind = self._kinds.get(arrays[0].shape)
            if kind is None:
                kind = self._kinds[arrays[0].shape] = _step_kind(arrays)
            self._calls.append((kind, arrays))
            self._add_step()
        else:
            with self._writing.writes():
                self._log.skip(number, step.reward, step.episode_ids)
        self._step = number + 1
        self._switched(env, was_open, self._gate.switch())
        if self._gate.open:
            self._write_when_due()

    def _switched(self, env: ObservedEnv, was_open: bool, held: list[EventRecord] | None) -> None:
        """Between two steps: apply a pause or a resumption of recording.

        Args:
            env: The environment.
            was_open: Whether it was recorded before.
            held: If recording resumes, the deferred events of this step; else None.
        """
        if was_open and not self._gate.open:
            with self._writing.writes():
                self._write_steps()
                self._write_rest()
        if held is not None:
            with self._writing.writes():
                self._write_start()
            self._show_again()
            for event in held:
                self.on_event(env, event)

    # -- writing -----------------------------------------------------------------------------------

    def _add_step(self) -> None:
        """Add the finished step to those that are written next."""
        with self._writing.lock:
            if not self._steps:
                size = sum(array.nbytes for _, arrays in self._calls for array in arrays)
                self._most = min(MOST_STEPS, 1 + MOST_BYTES // size)
                self._first, self._begun = self._step, time.monotonic()
            # A single statement adds the step, so an interrupt neither loses nor repeats it.
            self._steps.append(self._calls)
        self._calls = []

    def _write_when_due(self) -> None:
        """Write the steps if they are many or old; then start the next file, or write a start."""
        now, every = time.monotonic(), self._keyframe_every
        keyframe = every > 0 and self._step % every == 0
        many = len(self._steps) >= self._most or (self._steps and now - self._begun > MOST_SECONDS)
        full = self._max_bytes > 0 and self._log.is_full(self._max_bytes)
        if not (many or keyframe or full):
            return
        with self._writing.writes():
            self._write_steps()
            if full:
                self._roll()
            elif keyframe or (not every and self._since_start > START_SHARE * self._start_bytes):
                self._write_start()
            if now - self._flushed > FLUSH_SECONDS:
                self._flush()

    def _roll(self) -> None:
        self._log.roll(self._step)
        self._write_start()
        self._log.began()
        self._show_again()

    def begin_part(self) -> LogPlace:
        """Between two steps: write everything, continue in a new file, and return its place."""
        self._catch_up()
        with self._writing.writes():
            self._write_steps()
            self._roll()
        return self._log.place(self._step)

    def _show_again(self) -> None:
        """Write scenes and pictures that need nothing before them, in the next step."""
        self._views.show(self._view_envs)
        for part in self._drawing:
            part.restart()

    def _write_steps(self) -> None:
        steps, self._steps = self._steps, []
        self._since_start += self._log.write(self._first, steps)

    def _write_rest(self) -> None:
        """Write the calls after the last control step."""
        calls, self._calls = self._calls, []
        if calls:
            self._log.write(self._step, [calls])

    def _write_start(self) -> None:
        if self._keeps_state:
            fields = self._engine.model_fields()
            self._start_bytes = self._log.start(self._step, self._engine.rows, fields)
            self._since_start = 0

    def _flush(self) -> None:
        self._flushed = time.monotonic()
        self._log.flush()

    def _tick(self) -> None:
        """On the timer's thread: write and flush data that is waiting while no steps are made."""
        if time.monotonic() - self._flushed >= FLUSH_SECONDS:
            self._write_steps()
            self._flush()

    # -- the end -----------------------------------------------------------------------------------

    def on_close(self, env: ObservedEnv) -> None:
        """Close the log with the environment."""
        self.close()

    def flush(self) -> None:
        """Write everything recorded so far to the file, so that readers find it.

        The recorder does this itself at least once a second. After `close` it does nothing.

        Raises:
            LogWriteError: If the file could not be written.
        """
        if not self._closed:
            self._catch_up()
            with self._writing.writes():
                self._write_steps()
                self._flush()

    def count(self, env_ids: Sequence[int], episodes: Sequence[int]) -> None:
        """List episodes that ended, and count: those of the results. After `close` nothing is done.

        Args:
            env_ids: The environment of each.
            episodes: The id of each within its environment.

        Raises:
            ValueError: The recorder was built without `lists_counted`.
            LogWriteError: If the file could not be written.
        """
        if not self.lists_counted:
            raise ValueError("this log lists no counted episodes: build it with lists_counted=True")
        if self._closed or not env_ids:
            return
        self._catch_up()
        with self._writing.writes():
            self._write_steps()  # their ends come first
            self._log.count(max(self._step - 1, 0), env_ids, episodes)

    def close(self) -> None:
        """Write the last rows and finish the file. A second call does nothing.

        Raises:
            LogWriteError: If the file could not be written and no step has raised this error yet.
        """
        if self._closed:
            return
        self._catch_up()
        self._closed = True
        atexit.unregister(self._at_exit)
        self._writing.stop()
        if self._writing.told:
            return
        with self._writing.writes():
            if self._steps:
                if self._calls is self._steps[-1]:
                    self._calls = []  # an interrupt came right after the step was added
                self._step = max(self._step, self._first + len(self._steps))
            self._write_steps()
            if self._gate.open:
                self._write_rest()
            self._views.close(self._step, self._engine.rows)
            self._log.finish(self._step)


def _of(ids: EnvIndex | None, name: str = "env_ids") -> tuple[ArrayKind, ...]:
    """The kind of an array of environment indices; empty if `ids` is None."""
    return () if ids is None else (ArrayKind(name, "<i8", ids.shape),)


def _step_kind(arrays: Sequence[NDArray[Any]]) -> CallKind:
    names = ("action", "reward", "terminated", "truncated", "episode_ids")
    named = zip(names, arrays, strict=True)
    return CallKind("step", arrays=tuple(ArrayKind(n, a.dtype.str, a.shape) for n, a in named))


def _drawing(
    env: ObservedEnv, options: RecordOptions, sink: Queue, now: Callable[[], int]
) -> list[FirstPictures | Images]:
    """What draws pictures for the log; empty if there are no cameras to draw."""
    found: list[FirstPictures | Images] = []
    sensors = getattr(env.sim, "sensors", {})  # other classes may have none
    if options.state != "none" and any(s.cfg.reads_images for s in sensors.values()):
        from embodichain.recording.views.pictures import FirstPictures

        found.append(FirstPictures(env, sink, now))
    if options.images is not None:
        from embodichain.recording.views.images import Images

        found.append(Images(env, options.images, sink, now))
    return found


def _close_if_alive(recorder: weakref.ref[McapRecorder]) -> None:
    found = recorder()
    if found is not None:
        found.close()

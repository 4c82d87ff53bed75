"""`McapRecorder`: observes an environment and writes its log.

It collects the calls of each control step, and writes several steps at a time.
"""

from __future__ import annotations

import atexit
import time
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from gymnasium.vector import AutoresetMode

from embodichain.lab.gym.envs.observers import EventRecord, StepObserver, StepRecord
from embodichain.lab.sim.engine.api import PhysicsEvent, Write
from embodichain.recording.format.attachments import attachments_of, model_bytes, model_digest
from embodichain.recording.format.draws import Drawn, EpisodeDraws
from embodichain.recording.format.header import check_keyframes, header_of
from embodichain.recording.format.messages.columns import Moved
from embodichain.recording.format.messages.episodes import Ends
from embodichain.recording.format.options import RecordOptions, check_options
from embodichain.recording.format.parts import LogPlace
from embodichain.recording.views.layout import foxglove_layout
from embodichain.recording.write.calls import CallEncoder
from embodichain.recording.write.episode_gate import EpisodeGate
from embodichain.recording.write.log_views import LogViews
from embodichain.recording.write.log_writer import LogWriter
from embodichain.recording.write.step_buffer import StepBuffer
from embodichain.recording.write.writing import Writing, delayed_signals
from embodichain.utils.array_types import EnvIds, EnvIndex, host_ids
from embodichain.utils.short_repr import short_repr

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv

__all__ = ["McapRecorder", "RecordStats"]

FLUSH_SECONDS = 0.5
"""Interval between flushes. With the age at which steps are written (`step_buffer.MOST_SECONDS`)
and the timer's interval, at most one second is lost when the process is killed."""
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


@dataclass(slots=True)
class _LogClock:
    """Converts control steps to log time.

    Attributes:
        start_ns: Time of control step 0.
        period_ns: Simulated time of a control step.
        buffer: Knows the current control step.
    """

    start_ns: int
    period_ns: int
    buffer: StepBuffer

    def now_ns(self) -> int:
        """Log time at which the current control step begins."""
        return self.start_ns + self.buffer.number * self.period_ns


@dataclass(slots=True)
class _StartSchedule:
    """When the whole state is written again, so that reading can begin there.

    Attributes:
        keyframe_every: Number of control steps between starts; 0 leaves it to the size of the log.
        start_bytes: Size of the last start.
        bytes_since: Size of the steps after it.
    """

    keyframe_every: int
    start_bytes: int = 0
    bytes_since: int = 0

    def is_keyframe(self, step: int) -> bool:
        """Whether a start is written before this control step, whatever the log's size."""
        return self.keyframe_every > 0 and step % self.keyframe_every == 0

    def is_cheap(self) -> bool:
        """Whether there are no keyframes, and a start would add little to the log's size."""
        return not self.keyframe_every and self.bytes_since > START_SHARE * self.start_bytes


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
        # With arrays on a device, `env` lags behind the environment that it observes. Any other
        # environment is observed directly and has nothing to catch up with.
        self._catch_up = getattr(env, "catch_up", _do_nothing)
        env = getattr(env, "observed", env)
        engine = env.sim.engine
        check_keyframes(options, engine)
        mjb = model_bytes(engine.model)
        header = header_of(
            env,
            options,
            model_digest=model_digest(mjb),
            task=task,
            policy=policy,
            start_ns=time.time_ns() if place is None else place.start_ns,
        )
        header = replace(
            header,
            quota=_checked_quota(quota, env.num_envs),
            lists_counted=lists_counted,
        )
        self.lists_counted = lists_counted
        """Whether `count` lists the episodes that count."""
        self._engine = engine
        self._path = Path(path)
        self._options = options
        self._records_calls = options.state != "none"
        self._physics_steps_per_call = header.call_steps or header.substeps
        self._has_several_calls = self._physics_steps_per_call < header.substeps
        self._buffer = StepBuffer(0 if place is None else place.step)
        clock = _LogClock(header.start_ns, header.period_ns, self._buffer)
        self._gate = EpisodeGate(options.every, counted_env=next(iter(options.view_envs), 0))
        self._encoder = CallEncoder(engine, Moved(header.moved), hashes=header.keyframe_every > 0)
        self._starts = _StartSchedule(header.keyframe_every)
        if place is not None and place.draws is not None:
            self._draws = place.draws.copy()
        else:
            # Startup events act before observers are attached; other classes may have none.
            self._draws = EpisodeDraws(env.num_envs, getattr(env, "startup_draws", None))

        layout = foxglove_layout(env, options.view_envs, _image_topics(env, options))
        attachments = attachments_of(
            mjb,
            env.sim.scene.spec,
            config=config,
            overrides=overrides,
            layout=layout,
            varied=_varied_keys(env),
        )
        self._log = LogWriter(
            self._path,
            compression=options.compression,
            header=header,
            attachments=attachments,
            layout=layout,
            place=place,
        )
        self._views = LogViews(env, options, self._log.views, clock.now_ns)
        self._flushed = time.monotonic()
        self._closed = False
        self._write_start()
        self._log.began()
        # The timer of `Writing` starts here, so everything that `_tick` uses is set before.
        log_file = self._log.file
        self._writing = Writing(self._path, lambda: log_file.where_it_ends, self._tick)
        # A program that exits without closing the recorder still leaves a complete log.
        self._at_exit = partial(_close_if_alive, weakref.ref(self))
        atexit.register(self._at_exit)

    def __repr__(self) -> str:
        """Return the file and what is recorded, in one line."""
        options = self._options
        return short_repr(self, str(self._path), state=options.state, every=options.every)

    @property
    def stats(self) -> RecordStats:
        """What has been recorded so far."""
        return RecordStats(self._path, steps=self._buffer.number, nbytes=self._log.file.nbytes)

    # -- callbacks of the environment --------------------------------------------------------------

    def on_write(self, env: ObservedEnv, write: Write) -> None:
        """Record a write outside physics; for a reset, the resulting rows."""
        if write.op == "model":
            self._views.scenes.on_model_write(write)
        # `forward` computes what follows from the state; a replay does so too.
        if write.op != "forward" and self._records(write.env_ids):
            self._buffer.add(self._encoder.encode_write(write))

    def _records(self, env_ids: EnvIndex | None) -> bool:
        """Whether calls for these environments are recorded."""
        if not (self._records_calls and self._gate.open):
            return False
        return env_ids is None or len(host_ids(env_ids)) > 0

    def on_physics(self, env: ObservedEnv, event: PhysicsEvent) -> None:
        """Pass the rows before physics to the views; record the rows after it."""
        if event.phase == "after":
            if self._records(event.env_ids):
                self._buffer.add(self._encoder.encode_physics(event))
        elif event.env_ids is None:
            self._before_physics(event)

    def _before_physics(self, event: PhysicsEvent) -> None:
        """Before physics of all environments: sample their rows once in a control step."""
        # An action term may act between physics steps: then a control step has several calls.
        # Physics that a user steps outside of control steps has other numbers of steps.
        gate = self._gate
        is_later_call = False
        if event.nstep == self._physics_steps_per_call:
            is_later_call = self._has_several_calls and gate.in_step
            gate.on_physics()
        if gate.open and not is_later_call:
            self._views.on_rows(self._buffer.number, event.rows)

    def on_event(self, env: ObservedEnv, event: EventRecord) -> None:
        """Record that a term of the event manager fired, and the values it drew."""
        self._draws.add(event)
        self._record_event(event)

    def _record_event(self, event: EventRecord) -> None:
        """Record an event now, or when recording resumes."""
        if not self._gate.open:
            self._gate.defer(event)
            return
        self._views.scenes.on_event(event)
        # A delay is drawn by no event: it stands in the message about the episode's end only.
        if event.mode != "delay" and self._records(event.env_ids):
            self._buffer.add(self._encoder.encode_event(event))

    def on_reset(self, env: ObservedEnv, env_ids: EnvIds) -> None:
        """Update the views after a reset; start or pause recording (`record.every`)."""
        self._draws.end_reset()
        was_open = self._gate.open
        self._views.on_reset(env_ids, recorded=was_open)
        if self._options.every == 1:  # the gate is never closed
            return
        with delayed_signals():
            deferred = self._gate.on_reset(env_ids)
            self._pause_or_resume(env, was_open, deferred)

    def on_step(self, env: ObservedEnv, step: StepRecord) -> None:
        """Record the end of a control step.

        Raises:
            LogWriteError: If the log could not be written; recording has stopped.
        """
        self._writing.check()
        ends = None
        # Most steps end no episode. Searching the bytes is 10 times faster than `any`.
        if 1 in step.terminated.tobytes() or 1 in step.truncated.tobytes():
            ends = self._ends_of(env, step)
        if self._options.every == 1:
            self._record_step(step, ends)
            self._gate.in_step = False
        else:
            with delayed_signals():
                self._record_or_skip_step(env, step, ends)
        if self._gate.open:
            self._write_when_due()

    def _ends_of(self, env: ObservedEnv, step: StepRecord) -> Ends | None:
        """The episodes that end in a step; None if there is none."""

        def draws(env_ids: EnvIds) -> Drawn:
            return self._draws.of_ended(env_ids, were_reset=_resets_in_step(env))

        terms = env.termination_manager.values
        return Ends.of(step, terms, judged=env.judges_success, draws=draws)

    def _record_step(self, step: StepRecord, ends: Ends | None) -> None:
        number = self._buffer.number
        self._views.scenes.on_step(number, step, ended=ends is not None)
        self._buffer.finish_step(self._encoder.encode_step(step), ends)

    def _record_or_skip_step(self, env: ObservedEnv, step: StepRecord, ends: Ends | None) -> None:
        """With `record.every`: record a step, or only the ends of its episodes."""
        was_open = self._gate.open
        if was_open:
            self._record_step(step, ends)
        else:
            with self._writing.writes():
                number = self._buffer.number
                self._log.add_rewards(number, step.reward[None], step.episode_ids, ends)
                self._buffer.skip_step()
        deferred = self._gate.switch()
        self._pause_or_resume(env, was_open, deferred)

    def _pause_or_resume(
        self, env: ObservedEnv, was_open: bool, deferred: list[EventRecord] | None
    ) -> None:
        """Between two steps: write what a pause or a resumption of recording needs.

        Args:
            env: The environment.
            was_open: Whether it was recorded before.
            deferred: If recording resumes, the deferred events of this step; else None.
        """
        if was_open and not self._gate.open:
            with self._writing.writes():
                self._write_steps()
                self._write_unfinished_step()
        if deferred is not None:
            with self._writing.writes():
                self._write_start()
            self._views.show_again()
            for event in deferred:
                self._record_event(event)

    # -- writing -----------------------------------------------------------------------------------

    def _write_when_due(self) -> None:
        """Write the steps if they are many or old; then start the next file, or write a start."""
        now = time.monotonic()
        max_mb = self._options.max_mb
        is_keyframe = self._starts.is_keyframe(self._buffer.number)
        is_full = max_mb is not None and self._log.is_full(max_mb * 1e6)
        if not (is_keyframe or is_full or self._buffer.is_due(now)):
            return
        with self._writing.writes():
            self._write_steps()
            if is_full:
                self._roll()
            elif is_keyframe or self._starts.is_cheap():
                self._write_start()
            if now - self._flushed > FLUSH_SECONDS:
                self._flush()

    def _roll(self) -> None:
        """Continue in a new file."""
        self._log.roll(self._buffer.number)
        self._write_start()
        self._log.began()
        self._views.show_again()

    def begin_part(self) -> LogPlace:
        """Between two steps: write everything, continue in a new file, and return its place."""
        self._catch_up()
        with self._writing.writes():
            self._write_steps()
            self._roll()
        return replace(self._log.place(self._buffer.number), draws=self._draws.copy())

    def _write_steps(self) -> None:
        self._starts.bytes_since += self._log.write(self._buffer.take_steps())

    def _write_unfinished_step(self) -> None:
        """Write the calls after the last control step."""
        calls = self._buffer.take_calls()
        if calls:
            self._log.write_unfinished(self._buffer.number, calls)

    def _write_start(self) -> None:
        """Write the state of the simulation, so that reading can begin here."""
        if self._options.state == "none":
            return
        fields = self._engine.model_fields()
        self._starts.start_bytes = self._log.start(self._buffer.number, self._engine.rows, fields)
        self._starts.bytes_since = 0

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
        """List ended episodes that count as results. After `close` it does nothing.

        Args:
            env_ids: The environment of each.
            episodes: The id of each within its environment.

        Raises:
            ValueError: If the recorder was built without `lists_counted`.
            LogWriteError: If the file could not be written.
        """
        if not self.lists_counted:
            raise ValueError("this log lists no counted episodes: build it with lists_counted=True")
        if self._closed or not env_ids:
            return
        self._catch_up()
        with self._writing.writes():
            self._write_steps()  # a reader meets the end of an episode before it is counted
            self._log.count(max(self._buffer.number - 1, 0), env_ids, episodes)

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
        if self._writing.error_was_raised:
            return
        with self._writing.writes():
            self._write_steps()
            if self._gate.open:
                self._write_unfinished_step()
            self._views.scenes.close(self._buffer.number, self._engine.rows)
            self._log.finish(self._buffer.number)


def _do_nothing() -> None:
    pass


def _resets_in_step(env: ObservedEnv) -> bool:
    """Whether an environment is reset in the step that ends its episode, as by default."""
    metadata = getattr(env, "metadata", {})
    mode = metadata.get("autoreset_mode", AutoresetMode.SAME_STEP)
    return mode is AutoresetMode.SAME_STEP


def _checked_quota(quota: Sequence[int] | None, num_envs: int) -> tuple[int, ...]:
    """The header's quota; empty if it is not known."""
    if quota is None:
        return ()
    if len(quota) not in (0, num_envs):
        raise ValueError(f"quota has {len(quota)} numbers for {num_envs} environments")
    return tuple(int(count) for count in quota)


def _varied_keys(env: ObservedEnv) -> frozenset[str]:
    """Key paths of the task that variations have set; none where a class made the config itself."""
    sources = getattr(getattr(env, "cfg", None), "key_sources", None)
    return frozenset() if sources is None else sources.varied


def _image_topics(env: ObservedEnv, options: RecordOptions) -> list[str]:
    """Topics of the pictures in the log."""
    if options.images is None:
        return []
    from embodichain.recording.views.images import image_topics

    return image_topics(env, options.images)


def _close_if_alive(recorder_ref: weakref.ref[McapRecorder]) -> None:
    recorder = recorder_ref()
    if recorder is not None:
        recorder.close()

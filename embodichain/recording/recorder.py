"""`McapRecorder`: watches an environment and writes its log.

It only collects and hands over: what replay needs is `state_log`, what people look at is
`foxglove.views`, the file is `writer`.
"""

from __future__ import annotations

import atexit
import json
import threading
import time
import weakref
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.observers import EventRecord, StepObserver, StepRecord
from embodichain.lab.sim.engine.base import EnvIndex, PhysicsEvent, Write
from embodichain.lab.sim.engine.layout import row_layout
from embodichain.recording import state_log
from embodichain.recording.attachments import attachments_of, model_bytes
from embodichain.recording.columns import RowColumns
from embodichain.recording.episode_gate import EpisodeGate
from embodichain.recording.episode_log import TOPIC as EPISODE_TOPIC
from embodichain.recording.episode_log import Ends, EpisodeLog
from embodichain.recording.foxglove.layout import foxglove_layout
from embodichain.recording.foxglove.view_encoder import ViewEncoder
from embodichain.recording.foxglove.views import Views
from embodichain.recording.header import (
    METADATA_END,
    check_keyframes,
)
from embodichain.recording.log_head import LogHead, RecordStats, Rolling, header_of
from embodichain.recording.mcap_file import Part
from embodichain.recording.options import (
    RecordLike,
    RecordOptions,
    check_options,
)
from embodichain.recording.writer import Batch, LogWriteError, McapThread

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["McapRecorder", "RecordStats"]

BATCH_STEPS, BATCH_SECONDS = 16, 0.05
"""Small steps are handed over in batches: waking the other thread costs more than writing them."""
BATCH_BYTES = 2**19
QUEUE_BYTES = 64 * 2**20
"""About how much may wait for the disk before the simulation waits too."""


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
        env: BaseEnv,
        config: str = "",
        overrides: str | Sequence[str] = (),
        options: RecordLike | None = None,
        task: str = "",
    ) -> None:
        options = RecordOptions() if options is None else options
        check_options(options, env.num_envs)
        engine = env.sim.engine
        check_keyframes(options, engine.model)
        columns = RowColumns(row_layout(engine.model))
        self._period_ns = round(env.step_dt * 1e9)
        self._start_ns = time.time_ns()
        self._pending: Batch = []
        self._step = 0
        step_bytes = 8 * env.num_envs * columns.nstate
        self._batch_steps = max(1, min(BATCH_STEPS, BATCH_BYTES // step_bytes))
        self._handed_over = (0, time.monotonic())
        depth = max(4, min(256, QUEUE_BYTES // (3 * step_bytes * self._batch_steps)))
        self._lock = threading.Lock()  # whoever holds it may take what is pending
        collect = partial(_collected, weakref.ref(self))
        self._file = McapThread(Path(path), options.compression, depth, collect, _ends)
        self._closed = False
        self._columns = columns
        self._log = (
            state_log.StateLog(engine, columns, env.sim_steps_per_control, self._write_state)
            if options.state != "none"
            else None
        )
        self._episodes = EpisodeLog(env.num_envs)
        self._gate = EpisodeGate(options.every, next(iter(options.view_envs), 0))
        self._substeps = int(env.sim_steps_per_control)
        self._keyframe_every = options.keyframe_every if options.state == "keyframes" else 0
        self._keyframe_due = True
        self._keyframe = -1  # control step of the newest one
        self._views = Views(env, options, self._push_view, self._now)
        self._encoder = ViewEncoder(engine.model, self._views.spec, self._file)
        self._view_envs = [int(i) for i in options.view_envs]
        self._engine = engine
        self._begin(env, options, columns, config, overrides, task)
        # A program that fails without closing still leaves a whole log.
        self._at_exit = partial(_close_if_alive, weakref.ref(self))
        atexit.register(self._at_exit)

    def _begin(
        self,
        env: BaseEnv,
        options: RecordLike,
        columns: RowColumns,
        config: str,
        overrides: str | Sequence[str],
        task: str,
    ) -> None:
        """Queue attachments and metadata, then what the simulation is now."""
        model, spec, start_ns = env.sim.engine.model, env.sim.scene.spec, self._start_ns
        layout_file = Path(self._file.path).with_name("foxglove_layout.json")
        layout = foxglove_layout(env, options.view_envs)
        mjb = model_bytes(model)
        header = header_of(env, options, columns, mjb, task, start_ns)
        channels = dict(state_log.CHANNELS) if self._log else {}
        channels |= {EPISODE_TOPIC: "embodichain.Episodes"} | self._views.spec.channels
        rolls = options.max_mb is not None
        head = LogHead(
            header, lambda: attachments_of(mjb, spec, config, overrides, layout), again=rolls
        )
        self._rolling = Rolling(self._file, head, options.max_mb * 1e6) if options.max_mb else None

        def write_head(file: McapThread) -> None:
            head.write(file)
            for topic, schema in channels.items():
                file.channel(topic, schema)
            if not layout_file.exists():
                _write_json(layout_file, layout)

        self._pending.append(write_head)
        model_fields = self._engine.state_dict()["model"]
        if not columns.narrow_enough(self._engine.rows):
            columns.widen()
        self._write_start(model_fields)
        self._views.start(model_fields)
        self._hand_over()

    def _write_start(self, model_fields: dict[str, NDArray[Any]]) -> None:
        """Queue what the simulation is now: a file begins."""
        if self._log is not None:
            self._later(self._log.start, model_fields, self._engine.rows.copy())
        if self._rolling is not None:
            self._pending.append(self._rolling.began)

    def _roll(self, rolling: Rolling) -> None:
        """Go on in another file, from the state that the simulation has right now."""
        self._pending.append(rolling.job(self._step))
        self._write_start(self._engine.model_fields())
        self._views.show(self._view_envs)
        self._keyframe_due = True
        self._hand_over()

    def _now(self) -> int:
        return self._start_ns + self._step * self._period_ns

    def _later(self, encode: Callable[..., None], *args: object) -> None:
        """Have the background thread build a message, in order; it owns the arguments from here."""
        self._pending.append((encode, args))

    def _push_view(self, method: str, *args: object) -> None:
        """Called by the views, for what people look at."""
        self._later(getattr(self._encoder, method), *args)

    def _write_state(self, step: int, topic: str, parts: tuple[Part, ...]) -> None:
        """Called by the state log, on the background thread."""
        self._file.write(topic, self._start_ns + step * self._period_ns, parts)

    def _hand_over_when_due(self) -> None:
        step, when = self._handed_over
        if self._step - step >= self._batch_steps or time.monotonic() - when > BATCH_SECONDS:
            self._hand_over()

    def _hand_over(self) -> None:
        self._handed_over = self._step, time.monotonic()
        with self._lock:
            batch = self._pending[:]
            self._pending.clear()
            self._file.put(batch)

    def _collect(self, file: McapThread) -> Batch:
        """What nobody handed over, because no step came: a killed process must not lose it.

        Called on the background thread, which never waits for the simulation here. Nothing may
        be in the queue: that would come later in the file than what follows it.
        """
        if not self._lock.acquire(blocking=False):
            return []
        try:
            batch = self._pending[:] if file.idle else []
            del self._pending[: len(batch)]
        finally:
            self._lock.release()
        return batch

    @property
    def stats(self) -> RecordStats:
        """What has been written so far."""
        return RecordStats(self._file.path, self._step, self._file.nbytes)

    def on_write(self, env: BaseEnv, write: Write) -> None:
        """Something outside physics was written to the simulation."""
        nobody = write.env_ids is not None and not len(write.env_ids)
        if self._log is not None and write.op != "forward" and not nobody:
            self._columns.heed(write)
            if self._gate.open or write.op in ("model", "set_const"):
                self._later(self._log.on_write, write)
        if write.op == "model":
            self._views.on_model_write(write)

    def on_physics(self, env: BaseEnv, event: PhysicsEvent) -> None:
        """Physics is about to step, or has just stepped."""
        log, ids = self._log, event.env_ids
        before = event.phase == "before"
        if before and ids is None and event.nstep == self._substeps:
            self._gate.on_physics()
        if not self._gate.open:
            return
        if log is not None:
            taken = None
            if not before or not self._keyframe_every or self._is_keyframe(event):
                taken = self._columns.take(event.rows if ids is None else event.rows[ids])
            if before:
                self._later(log.before_physics, taken, event.nstep, ids)
            else:
                self._later(log.after_physics, taken, self._columns.ranges, event)
        if before and ids is None:
            self._views.on_rows(self._step, event.rows)

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

    def on_event(self, env: BaseEnv, event: EventRecord) -> None:
        """A term of the event manager fired."""
        if not self._gate.open:
            self._gate.hold(event)
            return
        if self._log is not None:
            self._later(self._log.on_event, event)
        self._views.on_event(event)

    def on_reset(self, env: BaseEnv, env_ids: EnvIndex) -> None:
        """Environments were reset."""
        if self._gate.open:
            self._views.on_reset(env_ids)
        self._go_on(env, self._gate.on_reset(env_ids))

    def _go_on(self, env: BaseEnv, held: list[EventRecord] | None, skip: bool = False) -> None:
        """Between two steps: record again if the gate has just opened, from the state right now.

        Args:
            env: The environment.
            held: The events that led there; None if it has not.
            skip: Whether the step that ended is not in the log.
        """
        for event in held or ():
            self.on_event(env, event)
        if self._log is not None and skip:
            self._later(self._log.skip)
        if held is not None:
            self.on_write(env, Write("state", "row", None, slice(None), self._engine.rows.copy()))
            self._keyframe_due = True
            self._views.show(self._view_envs)

    def on_step(self, env: BaseEnv, step: StepRecord) -> None:
        """A control step ended."""
        # Copies: the caller of `step` may write into what it was handed.
        reward, ids = step.reward.copy(), step.episode_ids.copy()
        recorded = self._gate.open
        if self._log is not None and recorded:
            flags = step.terminated.copy(), step.truncated.copy()
            self._later(self._log.on_step, step.action.copy(), reward, *flags, ids)
        ends = Ends.of(step, env.termination_manager.values)
        self._later(self._add_episodes, self._step, reward, ids, ends)
        if recorded:
            self._views.on_step(self._step, step)
        self._go_on(env, self._gate.switch(), skip=not recorded)
        self._step += 1
        if self._rolling is not None and self._rolling.due:
            self._roll(self._rolling)
        self._hand_over_when_due()

    def _add_episodes(
        self, step: int, reward: NDArray[Any], ids: NDArray[np.int64], ends: Ends | None
    ) -> None:
        """Called on the background thread."""
        parts = self._episodes.add(step, reward, ids, ends)
        if parts is not None:
            self._write_state(step, EPISODE_TOPIC, parts)

    def on_close(self, env: BaseEnv) -> None:
        """The environment closes."""
        self.close()

    def flush(self) -> None:
        """Wait until everything recorded so far is in the file, where readers find it.

        Nobody has to call this: the file is flushed every second. After `close` it does nothing.

        Raises:
            OSError: If the file could not be written.
        """
        if not self._closed:
            self._hand_over()
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
            with suppress(LogWriteError):  # once is enough: it may end what runs already
                self._file.close()
            return
        if self._log is not None and self._gate.open:
            self._later(self._log.close, self._columns.take(self._engine.rows))
        self._views.close(self._step, self._engine.rows)
        steps = str(self._step)
        self._pending.append(lambda file: file.metadata(METADATA_END, {"steps": steps}))
        if self._rolling is not None:
            self._pending.append(self._rolling.finish(self._step))
        try:
            self._hand_over()
        finally:
            self._file.close()


def _close_if_alive(recorder: weakref.ref[McapRecorder]) -> None:
    found = recorder()
    if found is not None:
        found.close()


def _collected(recorder: weakref.ref[McapRecorder], file: McapThread) -> Batch:
    found = recorder()
    return found._collect(file) if found is not None else []


def _ends(file: McapThread) -> str:
    steps = file.written("/sim/step")
    return f"it ends after control step {steps - 1}" if steps else "no control step is in it"


def _write_json(path: Path, content: object) -> None:
    with path.open("x") as stream:
        json.dump(content, stream, indent=1)

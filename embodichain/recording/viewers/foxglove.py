"""`FoxgloveView`: a run's channels for people, live, over Foxglove's WebSocket protocol.

Foxglove and Lichtblick connect to it. The channels are the log's (`foxglove.views`), the server is
`foxglove_server`; here it is decided when something is shown.
"""

from __future__ import annotations

import queue
import re
import threading
import time
import weakref
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from embodichain.lab.gym.envs.observers import EventRecord, StepObserver, StepRecord
from embodichain.lab.sim.engine.base import EnvIndex, Write
from embodichain.recording.foxglove.view_encoder import ViewEncoder
from embodichain.recording.foxglove.views import SEEN, Views
from embodichain.recording.options import RecordOptions, check_options
from embodichain.recording.viewers.foxglove_server import DEFAULT_PORT, FoxgloveServer

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv

__all__ = ["FoxgloveView"]

_ENV = re.compile(r"/env_(\d+)/")
_EVERY_STEP = 1e9
"""Hz of simulated time: here the wall clock decides what is sampled."""

Job = tuple[str, tuple[object, ...]]
"""A method of `ViewEncoder`, and its arguments."""


class FoxgloveView(StepObserver):
    """Shows environments to everybody who connects; attach it with `env.add_observer`.

    While nobody looks it does nothing. A scene comes again whenever somebody subscribes to it.
    Messages that the other thread cannot make in time are left out, so nobody waits for a viewer.

    Args:
        env: The environment.
        host: The address to listen on; nobody who reaches it is asked for a password.
        port: None is 8765, 0 a free one.
        env_id: An environment to show.
        view_envs: More of them.
        fps: Pictures a second of wall-clock time, at most.
        realtime: Whether steps keep to the wall clock while somebody looks.

    Raises:
        ConfigError: If foxglove-sdk is not installed, the address cannot be listened on, or an
            environment does not exist.
    """

    def __init__(
        self,
        env: ObservedEnv,
        host: str = "127.0.0.1",
        port: int | None = None,
        env_id: int = 0,
        view_envs: Sequence[int] = (),
        fps: float = 30.0,
        realtime: bool = False,
    ) -> None:
        shown = sorted({env_id, *view_envs})
        options = RecordOptions(view_envs=shown, view_hz=_EVERY_STEP)
        check_options(options, env.num_envs)
        self._server = FoxgloveServer(host, DEFAULT_PORT if port is None else port)
        self._envs = shown
        self._interval = 1.0 / fps
        self._step_dt = float(env.step_dt)
        self._realtime = realtime
        self._period_ns, self._start_ns = round(self._step_dt * 1e9), time.time_ns()
        self._step = 0
        self._shown = self._stepped = 0.0
        self._looking = False
        self._unseen: set[str] = set(env.sim.engine.state_dict()["model"])
        self._views = Views(env, options, self._push, self._now)
        for topic, schema in self._views.spec.channels.items():
            self._server.channel(topic, schema)
        self._thread = _Thread(ViewEncoder(env.sim.engine.model, self._views.spec, self._server))
        self._close = partial(_close, self._thread, self._server)
        weakref.finalize(self, self._close)  # also when Python ends: the thread is in native code

    @property
    def url(self) -> str:
        """What Foxglove and Lichtblick open: *Open connection*, Foxglove WebSocket."""
        return self._server.url

    @property
    def port(self) -> int:
        """The port that is listened on."""
        return self._server.port

    def _now(self) -> int:
        return self._start_ns + self._step * self._period_ns

    def _push(self, method: str, *args: object) -> None:
        self._thread.put((method, args))

    def on_write(self, env: ObservedEnv, write: Write) -> None:
        """Remember which looks changed; what they are now is read when somebody looks."""
        if write.op == "model" and write.field.startswith(SEEN):
            self._unseen.add(write.field)

    def on_event(self, env: ObservedEnv, event: EventRecord) -> None:
        """Tell those who look that a term of the event manager fired."""
        if self._looking:
            self._views.on_event(event)

    def on_reset(self, env: ObservedEnv, env_ids: EnvIndex) -> None:
        """Show viewed environments' scenes again."""
        if self._looking:
            self._views.on_reset(env_ids)

    def on_step(self, env: ObservedEnv, step: StepRecord) -> None:
        """Show the new state, if somebody looks and a picture is due; keep to the clock."""
        self._views.declare(step)
        self._step += 1
        self._looking = self._server.wanted
        if not self._looking:
            return
        now = time.monotonic()
        newcomers = self._server.newcomers()
        if newcomers:
            self._welcome(newcomers)
        if (now - self._shown >= self._interval or newcomers) and self._thread.ready:
            self._shown = now
            engine, fields = env.sim.engine, self._unseen
            self._unseen = set()
            self._views.take_over({name: engine.model_field(name) for name in fields})
            self._views.on_rows(self._step, engine.rows)
            self._views.on_step(self._step, step)
        if self._realtime:
            ahead = self._step_dt - (time.monotonic() - self._stepped)
            time.sleep(max(0.0, ahead))
            self._stepped = time.monotonic()

    def _welcome(self, topics: set[str]) -> None:
        """Somebody subscribed to these topics: show what stands still, which nobody kept."""
        found = (_ENV.match(topic) for topic in topics)
        shown = {int(match[1]) for match in found if match}
        self._views.show(shown or self._envs)

    def on_close(self, env: ObservedEnv) -> None:
        """Say goodbye to everybody who looks."""
        self._close()


class _Thread:
    """One background thread that makes messages; the simulation never waits for it."""

    def __init__(self, encoder: ViewEncoder) -> None:
        self._encoder = encoder
        self._queue: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="foxglove-view", daemon=True)
        self._thread.start()

    @property
    def ready(self) -> bool:
        """Whether everything handed over is done, or nearly.

        Raises:
            RuntimeError: If the thread failed.
        """
        if self._error is not None:
            raise RuntimeError("the live view failed") from self._error
        return self._queue.empty()

    def put(self, job: Job) -> None:
        """Hand over work."""
        self._queue.put(job)

    def close(self) -> None:
        """Finish what was handed over. A second call does nothing."""
        self._queue.put(None)
        self._thread.join()

    def _run(self) -> None:
        try:
            while (job := self._queue.get()) is not None:
                method, args = job
                getattr(self._encoder, method)(*args)
        except BaseException as error:  # noqa: BLE001 - raised again by `ready`
            self._error = error


def _close(thread: _Thread, server: FoxgloveServer) -> None:
    thread.close()
    server.close()

"""`FoxgloveView`: an environment's channels for viewers, live, over Foxglove's WebSocket protocol.

Foxglove and Lichtblick connect to it. The channels are the log's (`recording.views`), the server
is `foxglove_server`; this module decides when something is sent.
"""

from __future__ import annotations

import re
import time
import weakref
from collections.abc import Sequence
from typing import TYPE_CHECKING

from embodichain.lab.gym.envs.observers import EventRecord, StepObserver, StepRecord
from embodichain.lab.sim.engine.api import EnvIndex, Write
from embodichain.recording.options import RecordOptions, check_options
from embodichain.recording.viewers.foxglove_server import DEFAULT_PORT, FoxgloveServer
from embodichain.recording.views.views import Views

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv

__all__ = ["FoxgloveView"]

_ENV = re.compile(r"/env_(\d+)/")
_EVERY_STEP = 1e9
"""Hz of simulated time: here the wall clock decides what is sampled."""


class FoxgloveView(StepObserver):
    """Shows environments to every viewer that connects; attach it with `env.add_observer`.

    Without subscriptions no message is made. A scene comes again with every subscription to it.
    The server sends on threads of its own and leaves out what a viewer does not take in time.

    Args:
        env: The environment.
        host: The address to listen on; there is no password.
        port: None is 8765, 0 a free one.
        env_id: An environment to show.
        view_envs: More of them.
        fps: Pictures a second of wall-clock time, at most.
        realtime: Whether steps keep to the wall clock while anything is subscribed to.

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
        self._views = Views(env, options, self._server, self._now)
        weakref.finalize(self, self._server.close)  # also when Python ends: it has native threads

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

    def on_write(self, env: ObservedEnv, write: Write) -> None:
        """Note which looks changed; they are read when they are shown."""
        if write.op == "model":
            self._views.on_model_write(write)

    def on_event(self, env: ObservedEnv, event: EventRecord) -> None:
        """Send a line of what a term of the event manager drew."""
        if self._looking:
            self._views.on_event(event)

    def on_reset(self, env: ObservedEnv, env_ids: EnvIndex) -> None:
        """Show viewed environments' scenes again if they changed."""
        if self._looking:
            self._views.on_reset(env_ids)

    def on_step(self, env: ObservedEnv, step: StepRecord) -> None:
        """Show the new state if a picture is due; keep to the clock."""
        self._views.declare(step)
        self._step += 1
        self._looking = self._server.wanted
        if not self._looking:
            return
        now = time.monotonic()
        newcomers = self._server.newcomers()
        if newcomers:
            self._welcome(newcomers)
        if now - self._shown >= self._interval or newcomers:
            self._shown = now
            self._views.on_rows(self._step, env.sim.engine.rows)
            self._views.on_step(self._step, step)
        if self._realtime:
            ahead = self._step_dt - (time.monotonic() - self._stepped)
            time.sleep(max(0.0, ahead))
            self._stepped = time.monotonic()

    def _welcome(self, topics: set[str]) -> None:
        """Show the scenes of these topics' environments, of which the server keeps nothing."""
        found = (_ENV.match(topic) for topic in topics)
        shown = {int(match[1]) for match in found if match}
        self._views.show(shown or self._envs)

    def on_close(self, env: ObservedEnv) -> None:
        """Close the server and its connections."""
        self._server.close()

"""The log's channels for viewers over Foxglove's WebSocket protocol.

Foxglove and Lichtblick connect to a `FoxgloveServer`. `FoxgloveView` serves a running environment,
`stream_log` a recorded log. Needs foxglove-sdk.
"""

from __future__ import annotations

import logging
import re
import threading
import time
import weakref
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.lab.gym.envs.observers import EventRecord, StepObserver, StepRecord
from embodichain.lab.sim.engine.api import EnvIndex, Write
from embodichain.recording.chunks import LogReader
from embodichain.recording.options import ImageOptions, RecordOptions, check_options
from embodichain.recording.pictures import camera_sensors
from embodichain.recording.schema import descriptor_set
from embodichain.recording.views.images import Images
from embodichain.recording.views.views import Views
from embodichain.utils.errors import ConfigError, Problem, RenderError

if TYPE_CHECKING:
    from foxglove import Channel
    from foxglove.websocket import ChannelView, Client

    from embodichain.lab.gym.envs.observers import ObservedEnv

__all__ = ["FoxgloveServer", "FoxgloveView", "declare_channels", "need_sdk", "stream_log"]

_PORT = 8765  # Foxglove's default
_ENV = re.compile(r"/env_(\d+)/")
_EVERY_STEP = 1e9
"""Sampling rate in Hz of simulated time; a live view is limited by the wall clock instead."""
_NAP = 0.02
_log = logging.getLogger(__name__)


def need_sdk() -> Any:
    """Return the package `foxglove`; ConfigError names the extra if it is not installed."""
    try:
        import foxglove
    except ImportError as error:
        message, hint = "needs the package foxglove-sdk", "pip install 'embodichain[foxglove]'"
        raise ConfigError([Problem("viewer.name", message, hint)]) from error
    return foxglove


class FoxgloveServer:
    """Serves messages to viewers, read-only; a channel without subscribers costs nothing.

    Args:
        host: The address to listen on.
        port: None is 8765, 0 a free one.

    Attributes:
        port: The port.
        url: Address for viewers: *Open connection*, Foxglove WebSocket.

    Raises:
        ConfigError: If foxglove-sdk is not installed, or the address cannot be listened on.
    """

    def __init__(self, host: str, port: int | None = None) -> None:
        foxglove = self._sdk = need_sdk()
        self._context = foxglove.Context()
        self._channels: dict[str, Channel] = {}
        self._schemas: dict[str, Any] = {}
        self._lock = threading.Lock()
        self._new: set[str] = set()
        self._subscriptions: set[tuple[int, int]] = set()  # client, channel
        port = _PORT if port is None else port
        try:
            self._server = foxglove.start_server(
                name="embodichain",
                host=host,
                port=port,
                server_listener=self,
                context=self._context,
            )
        except RuntimeError as error:
            message, hint = f"cannot listen on {host}:{port}: {error}", "viewer.port=N is another"
            raise ConfigError([Problem("viewer.port", message, hint)]) from error
        self.port = int(self._server.port)
        self.url = f"ws://[{host}]:{self.port}" if ":" in host else f"ws://{host}:{self.port}"

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Add a subscription; called on the server's threads."""
        with self._lock:
            self._subscriptions.add((client.id, channel.id))
            self._new.add(channel.topic)

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        """Remove a subscription; also called when a client has disconnected."""
        with self._lock:
            self._subscriptions.discard((client.id, channel.id))

    @property
    def wanted(self) -> bool:
        """Whether any channel has a subscriber."""
        return bool(self._subscriptions)

    def is_wanted(self, topic: str) -> bool:
        """Whether a channel has a subscriber; KeyError if it was not declared."""
        return bool(self._channels[topic].has_sinks())

    def newcomers(self) -> set[str]:
        """Return topics with new subscriptions since the last call."""
        if not self._new:
            return set()
        with self._lock:
            found, self._new = self._new, set()
        return found

    def channel(self, topic: str, schema: str, data: bytes | None = None) -> None:
        """Declare a channel; a second call does nothing.

        Args:
            topic: Its name.
            schema: ``embodichain.NAME`` or ``foxglove.NAME``.
            data: The schema's FileDescriptorSet if it is specific to this run.
        """
        if topic in self._channels:
            return
        if schema not in self._schemas:
            content = descriptor_set(schema) if data is None else data
            self._schemas[schema] = self._sdk.Schema(name=schema, encoding="protobuf", data=content)
        self._channels[topic] = self._sdk.Channel(
            topic,
            message_encoding="protobuf",
            schema=self._schemas[schema],
            context=self._context,
        )

    def send(self, time_ns: int, messages: Iterable[tuple[str, bytes]]) -> None:
        """Send messages to their subscribers; KeyError if a channel was not declared."""
        for topic, data in messages:
            if self.is_wanted(topic):
                self._channels[topic].log(data, log_time=time_ns)

    def restart(self) -> None:
        """Signal that time starts again: clients drop their data and stay subscribed."""
        self._server.clear_session()

    def close(self) -> None:
        """Close all connections. A second call does nothing."""
        self._server.stop()
        for channel in self._channels.values():
            channel.close()
        self._channels.clear()


class FoxgloveView(StepObserver):
    """Shows environments to every viewer that connects; attach it with `env.add_observer`.

    Without subscriptions no messages are encoded. A scene is sent again with every subscription to
    it. The server sends on its own threads and drops messages for viewers that are too slow.

    Pictures of cameras are drawn while something is subscribed to them. If they cannot be drawn
    here, a warning and a line of ``/log`` give the reason, and the other channels continue.

    Args:
        env: The environment.
        host: The address to listen on; there is no password.
        port: None is 8765, 0 a free one.
        view_envs: Environments to show.
        fps: Maximum sampling rate in 1/s of wall-clock time.
        realtime: Whether steps run in real time while there are subscriptions.
        images: Pictures; `rate` is their maximum in 1/s of wall-clock time. None: of all camera
            sensors in `view_envs`, as JPEG.

    Attributes:
        server: The server, with its address: `url`, `port`.

    Raises:
        ConfigError: If foxglove-sdk is not installed, the address cannot be listened on, or an
            environment or a camera does not exist.
    """

    def __init__(
        self,
        env: ObservedEnv,
        host: str = "127.0.0.1",
        port: int | None = None,
        view_envs: Sequence[int] = (0,),
        fps: float = 30.0,
        realtime: bool = False,
        images: ImageOptions | None = None,
    ) -> None:
        if images is None and camera_sensors(env):
            images = ImageOptions(envs=view_envs, format="jpeg")
        options = RecordOptions(view_envs=view_envs, view_hz=_EVERY_STEP, images=images)
        check_options(options, env.num_envs)
        self.server = FoxgloveServer(host, port)
        weakref.finalize(self, self.server.close)  # also when Python exits: it has native threads
        self._envs = view_envs
        self._interval, self._realtime = 1.0 / fps, realtime
        self._step_dt = float(env.step_dt)
        self._period_ns, self._start_ns = round(self._step_dt * 1e9), time.time_ns()
        self._step = 0
        self._shown = self._drawn = self._stepped = 0.0
        self._active = False
        self._views = Views(env, options, self.server, self._now)
        self._images: Images | None = None
        if images is not None:
            wanted = self.server.is_wanted
            self._images = Images(env, images, self.server, self._now, wanted)
            self._image_interval = max(self._interval, 1.0 / images.rate)

    def _now(self) -> int:
        return self._start_ns + self._step * self._period_ns

    def on_write(self, env: ObservedEnv, write: Write) -> None:
        """Note which model fields changed; they are read when they are shown."""
        if write.op == "model":
            self._views.on_model_write(write)

    def on_event(self, env: ObservedEnv, event: EventRecord) -> None:
        """Send a line with the values that a term of the event manager drew."""
        if self._active:
            self._views.on_event(event)

    def on_reset(self, env: ObservedEnv, env_ids: EnvIndex) -> None:
        """Show viewed environments' scenes again if they changed."""
        if self._active:
            self._views.on_reset(env_ids)

    def on_step(self, env: ObservedEnv, step: StepRecord) -> None:
        """Send the new state if a sample is due; wait for real time."""
        self._views.declare(step)
        self._step += 1
        self._active = self.server.wanted
        if not self._active:
            return
        now = time.monotonic()
        newcomers = self.server.newcomers()
        if newcomers:  # send their environments' scenes, which the server does not keep
            found = (_ENV.match(topic) for topic in newcomers)
            self._views.show({int(match[1]) for match in found if match} or self._envs)
        if now - self._shown >= self._interval or newcomers:
            self._shown = now
            self._views.on_rows(self._step, env.sim.engine.rows)
            self._views.on_step(self._step, step)
        if self._images is not None:
            self._draw(self._images, env, now, newcomers)
        if self._realtime:
            ahead = self._step_dt - (time.monotonic() - self._stepped)
            time.sleep(max(0.0, ahead))
            self._stepped = time.monotonic()

    def _draw(self, images: Images, env: ObservedEnv, now: float, newcomers: set[str]) -> None:
        """Send pictures if they are due, or have a new subscriber."""
        new = any("/camera/" in topic for topic in newcomers)
        if not new and now - self._drawn < self._image_interval:
            return
        if new:
            images.restart()  # a subscriber can decode only what begins with an IDR picture
        try:
            images.send(env.sim.engine.rows)
            self._drawn = time.monotonic()  # after drawing: slow pictures leave time for steps
        except RenderError as error:
            self._images = None
            _log.warning("viewer: no pictures of cameras: %s", error)
            self._views.say(f"no pictures of cameras: {error}", "ERROR")

    def on_close(self, env: ObservedEnv) -> None:
        """Close the server and its connections."""
        self.server.close()


def declare_channels(path: Path, server: FoxgloveServer) -> list[str]:
    """Declare the log's channels for viewers, and return their topics.

    Raises:
        ConfigError: If the file is missing, empty or not MCAP.
        LogError: If it is not an embodichain log.
    """
    topics = []
    with LogReader(path) as reader:
        for _ in reader.messages():
            pass  # the channels of a damaged log are known from its messages only
        for channel in reader.channels.values():
            schema = reader.schemas.get(channel.schema_id)
            if schema is not None and _is_viewed(channel.topic):
                server.channel(channel.topic, schema.name, schema.data)
                topics.append(channel.topic)
    return topics


def stream_log(
    path: Path, server: FoxgloveServer, stopped: Callable[[], bool], speed: float = 1.0
) -> None:
    """Play a log in a loop; its channels must be declared. Wait while there are no subscriptions.

    A damaged log is played up to the first damage.

    Args:
        path: The log.
        server: The server that sends it.
        stopped: Called often; True ends playing.
        speed: Multiple of simulated time.
    """
    while not stopped():
        scenes: dict[str, tuple[int, bytes]] = {}  # the latest ones, since they are rarely sent
        offset: float | None = None  # wall clock minus log time; None while waiting
        reached = 0.0
        with LogReader(path) as reader:
            for topic, time_ns, payload in reader.messages():
                if not _is_viewed(topic):
                    continue
                data, due = bytes(payload), time_ns / 1e9 / speed
                while not stopped():
                    if not server.wanted:
                        offset = None
                    else:
                        if offset is None:
                            offset = time.monotonic() - max(due, reached)
                        reached = time.monotonic() - offset
                        if reached >= due:
                            break
                    time.sleep(_NAP)
                if stopped():
                    return
                for new in server.newcomers() & scenes.keys():
                    shown_ns, scene = scenes[new]
                    server.send(shown_ns, [(new, scene)])
                if topic.endswith("/scene"):
                    scenes[topic] = time_ns, data
                server.send(time_ns, [(topic, data)])
        server.restart()


def _is_viewed(topic: str) -> bool:
    return not topic.startswith(("/sim/", "/episode"))

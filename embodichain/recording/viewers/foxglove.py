"""The log's channels for viewers over Foxglove's WebSocket protocol.

Foxglove and Lichtblick connect to a `FoxgloveServer`. `FoxgloveView` serves a running environment,
`stream_log` a recorded log.
"""

from __future__ import annotations

import logging
import re
import time
import weakref
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.lab.gym.envs.observers import EventRecord, StepObserver, StepRecord
from embodichain.lab.sim.engine.api import Write
from embodichain.recording.format.options import ImageOptions, RecordOptions, check_options
from embodichain.recording.read.chunks import LogReader
from embodichain.recording.viewers.foxglove_server import FoxgloveServer
from embodichain.recording.views.images import Images
from embodichain.recording.views.pictures import camera_sensors
from embodichain.recording.views.views import Views
from embodichain.utils.array_types import EnvIds
from embodichain.utils.errors import RenderError
from embodichain.utils.system.access import Access

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv

__all__ = ["FoxgloveServer", "FoxgloveView", "declare_channels", "stream_log"]

_ENV = re.compile(r"/env_(\d+)/")
_EVERY_STEP = 1e9
"""Sampling rate in Hz of simulated time; a live view is limited by the wall clock instead."""
_POLL_SECONDS = 0.02
_log = logging.getLogger(__name__)


class FoxgloveView(StepObserver):
    """Shows environments to every viewer that connects; attach it with `env.add_observer`.

    Without subscriptions no messages are encoded. A scene is sent again with every subscription to
    it. The server sends on its own thread and drops messages for viewers that are too slow.

    Pictures of cameras are drawn while something is subscribed to them. If they cannot be drawn
    here, a warning and a line of ``/log`` give the reason, and the other channels continue.

    Args:
        env: The environment.
        host: The address to listen on.
        port: None is 8765, 0 a free one.
        view_envs: Environments to show.
        fps: Maximum sampling rate in 1/s of wall-clock time.
        realtime: Whether steps run in real time while a viewer is connected.
        images: Pictures; `rate` is their maximum in 1/s of wall-clock time. None: of all camera
            sensors in `view_envs`, as JPEG.
        access: Who may connect: a drawn token by default.
        title: Name of the server, which viewers show.

    Attributes:
        server: The server, with its address: `url`, which has the token, and `port`.

    Raises:
        ConfigError: If the address cannot be listened on, `access` does not fit it, or an
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
        access: Access | None = None,
        title: str = "embodichain",
    ) -> None:
        if images is None and camera_sensors(env):
            images = ImageOptions(envs=view_envs, format="jpeg")
        options = RecordOptions(view_envs=view_envs, view_hz=_EVERY_STEP, images=images)
        check_options(options, env.num_envs)
        self.server = FoxgloveServer(host, port, access, title)
        weakref.finalize(self, self.server.close)  # also when Python exits
        self._envs = view_envs
        self._interval = 1.0 / fps
        self._realtime = realtime
        self._step_dt = float(env.step_dt)
        self._period_ns = round(self._step_dt * 1e9)
        self._start_ns = time.time_ns()
        self._step = 0
        self._refreshes = 0
        # When a state and pictures were sent last, and a step ended; seconds, monotonic clock.
        self._last_state = 0.0
        self._last_pictures = 0.0
        self._last_step = 0.0
        self._active = False
        self._views = Views(env, options, self.server, self._now)
        self._images: Images | None = None
        if images is not None:
            self._images = Images(env, images, self.server, self._now, self.server.is_wanted)
            self._image_interval = max(self._interval, 1.0 / images.rate)

    def _now(self) -> int:
        """Simulated time of the present step in ns, from when the view began."""
        return self._start_ns + self._step * self._period_ns

    @property
    def watched(self) -> bool:
        """Whether a viewer is connected."""
        return self.server.connected

    def refresh(self, env: ObservedEnv) -> None:
        """Show the present state to viewers that have subscribed since the last call."""
        self._active = self.server.wanted
        newcomers = self.server.newcomers()
        if newcomers:
            self._show_scenes(newcomers)
            # Numbers below 0 are no control steps: a sample of the same step is not sent twice.
            self._refreshes += 1
            self._views.on_rows(-1 - self._refreshes, env.sim.engine.rows)

    def finish(self) -> None:
        """Say on ``/log`` that the run is over."""
        self._views.say("the run is over: this is its last state")

    def on_write(self, env: ObservedEnv, write: Write) -> None:
        """Note which model fields changed; they are read when they are shown."""
        if write.op == "model":
            self._views.on_model_write(write)

    def on_event(self, env: ObservedEnv, event: EventRecord) -> None:
        """Send a line with the values that a term of the event manager drew."""
        if self._active:
            self._views.on_event(event)

    def on_reset(self, env: ObservedEnv, env_ids: EnvIds) -> None:
        """Show viewed environments' scenes again if they changed."""
        if self._active:
            self._views.on_reset(env_ids)

    def on_step(self, env: ObservedEnv, step: StepRecord) -> None:
        """Send the new state if a sample is due; wait for real time."""
        self._views.declare(step)
        self._step += 1
        self._active = self.server.wanted
        if self._active:
            self._show(env, step)
        if self._realtime and self.server.connected:
            elapsed = time.monotonic() - self._last_step
            time.sleep(max(0.0, self._step_dt - elapsed))
            self._last_step = time.monotonic()

    def _show(self, env: ObservedEnv, step: StepRecord) -> None:
        """Send the new state, and pictures, if they are due or have a new subscriber."""
        now = time.monotonic()
        newcomers = self.server.newcomers()
        if newcomers:
            self._show_scenes(newcomers)
        if now - self._last_state >= self._interval or newcomers:
            self._last_state = now
            self._views.on_rows(self._step, env.sim.engine.rows)
            self._views.on_step(self._step, step)
        if self._images is not None:
            self._draw(self._images, env, now, newcomers)

    def _show_scenes(self, topics: set[str]) -> None:
        """Send the scenes of the topics' environments, which the server does not store."""
        matches = [_ENV.match(topic) for topic in topics]
        env_ids = {int(match[1]) for match in matches if match is not None}
        self._views.show(env_ids or self._envs)

    def _draw(self, images: Images, env: ObservedEnv, now: float, newcomers: set[str]) -> None:
        """Send pictures if they are due, or have a new subscriber."""
        has_newcomer = any("/camera/" in topic for topic in newcomers)
        if not has_newcomer and now - self._last_pictures < self._image_interval:
            return
        if has_newcomer:
            images.restart()  # a subscriber can decode only what begins with an IDR picture
        try:
            images.send(env.sim.engine.rows)
            self._last_pictures = (
                time.monotonic()
            )  # after drawing: slow pictures leave time for steps
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
                data = bytes(payload)
                due = time_ns / 1e9 / speed
                while not stopped():
                    if not server.wanted:
                        offset = None
                    else:
                        if offset is None:
                            offset = time.monotonic() - max(due, reached)
                        reached = time.monotonic() - offset
                        if reached >= due:
                            break
                    time.sleep(_POLL_SECONDS)
                if stopped():
                    return
                for scene_topic in server.newcomers() & scenes.keys():
                    scene_ns, scene = scenes[scene_topic]
                    server.send(scene_ns, [(scene_topic, scene)])
                if topic.endswith("/scene"):
                    scenes[topic] = (time_ns, data)
                server.send(time_ns, [(topic, data)])
        server.restart()


def _is_viewed(topic: str) -> bool:
    return not topic.startswith(("/sim/", "/episode"))

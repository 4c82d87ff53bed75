"""Plays the channels for viewers of a log through a `FoxgloveServer`, in real time.

A damaged log is played up to where it can be read.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

from embodichain.recording.chunks import LogReader
from embodichain.recording.viewers.foxglove_server import FoxgloveServer

__all__ = ["declare_channels", "play_log"]

_PROGRAMS = ("/sim/", "/episode")
_PAUSE = 0.02


def declare_channels(path: Path, server: FoxgloveServer) -> list[str]:
    """Declare the log's channels for viewers, and return their topics.

    Raises:
        ConfigError: If the file is missing, empty or not MCAP.
        LogError: If it is not a log of embodichain's.
    """
    topics = []
    with LogReader(path) as reader:
        for _ in reader.messages():
            pass
        for channel in reader.channels.values():
            schema = reader.schemas.get(channel.schema_id)
            if schema is not None and _is_viewed(channel.topic):
                server.channel(channel.topic, schema.name, schema.data)
                topics.append(channel.topic)
    return topics


def play_log(
    path: Path,
    server: FoxgloveServer,
    stopped: Callable[[], bool],
    *,
    speed: float = 1.0,
    again: bool = True,
) -> None:
    """Play a log whose channels are declared; it waits while nothing is subscribed to.

    Args:
        path: The log.
        server: Where it is shown.
        stopped: Asked often; ends it.
        speed: 2 is twice as fast as it happened.
        again: Whether to begin anew at the end.
    """
    while not stopped():
        clock = _Clock(speed)
        still: dict[str, tuple[int, bytes]] = {}  # the newest scenes: they come seldom
        for topic, log_time, data in _viewed(path):
            while not stopped() and not (server.wanted and clock.due(log_time)):
                if not server.wanted:
                    clock.stop()
                time.sleep(_PAUSE)
            if stopped():
                return
            for new in server.newcomers() & still.keys():
                time_ns, scene = still[new]
                server.send(time_ns, [(new, scene)])
            if topic.endswith("/scene"):
                still[topic] = log_time, data
            server.send(log_time, [(topic, data)])
        if not again:
            return
        server.begin_anew()


def _viewed(path: Path) -> Iterator[tuple[str, int, bytes]]:
    with LogReader(path) as reader:
        for topic, log_time, data in reader.messages_in_time(_is_viewed):
            yield topic, log_time, bytes(data)


def _is_viewed(topic: str) -> bool:
    return not topic.startswith(_PROGRAMS)


class _Clock:
    """Log time that passes with the wall clock, and can stand still."""

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._offset: float | None = None
        self._last = 0.0

    def due(self, time_ns: int) -> bool:
        """Whether this moment of the log has come."""
        wanted = time_ns / 1e9 / self._speed
        now = time.monotonic()
        if self._offset is None:
            self._offset = now - max(wanted, self._last)
        self._last = now - self._offset
        return self._last >= wanted

    def stop(self) -> None:
        """Stand still until it is asked again."""
        self._offset = None

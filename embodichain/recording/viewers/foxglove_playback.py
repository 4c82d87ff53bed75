"""Plays a log through a `FoxgloveServer`: what people look at, at the speed at which it happened.

The log may be broken: it is played up to where it can be read.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

from mcap.records import Message

from embodichain.recording.reader import LogReader
from embodichain.recording.viewers.foxglove_server import FoxgloveServer

__all__ = ["declare_channels", "play_log"]

_NOT_FOR_PEOPLE = ("/sim/", "/episode")
_PAUSE = 0.02


def declare_channels(path: Path, server: FoxgloveServer) -> list[str]:
    """Declare the log's channels for people, and return their topics.

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
            if schema is not None and not channel.topic.startswith(_NOT_FOR_PEOPLE):
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
    """Play a log whose channels are declared; it waits while nobody looks.

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
        for topic, message in _for_people(path):
            while not stopped() and not (server.wanted and clock.due(message.log_time)):
                if not server.wanted:
                    clock.stop()
                time.sleep(_PAUSE)
            if stopped():
                return
            for new in server.newcomers() & still.keys():
                time_ns, data = still[new]
                server.send(time_ns, [(new, data)])
            if topic.endswith("/scene"):
                still[topic] = message.log_time, message.data
            server.send(message.log_time, [(topic, bytes(message.data))])
        if not again:
            return
        server.begin_anew()


def _for_people(path: Path) -> Iterator[tuple[str, Message]]:
    with LogReader(path) as reader:
        for topic, message in reader.messages():
            if not topic.startswith(_NOT_FOR_PEOPLE):
                yield topic, message


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

"""Plays the channels for viewers of a log through a `FoxgloveServer`, in real time.

A damaged log is played up to where it can be read.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from embodichain.recording.chunks import LogReader
from embodichain.recording.viewers.foxglove_server import FoxgloveServer

__all__ = ["declare_channels", "play_log"]

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
            pass  # the channels of a damaged log are known by its messages only
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
        speed: 2 is twice as fast as it was simulated.
        again: Whether to start again at the end.
    """
    while not stopped():
        scenes: dict[str, tuple[int, bytes]] = {}  # the newest ones: they come rarely
        offset: float | None = None  # of the wall clock to the log's; None: it stands still
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
                    time.sleep(_PAUSE)
                if stopped():
                    return
                for new in server.newcomers() & scenes.keys():
                    shown_ns, scene = scenes[new]
                    server.send(shown_ns, [(new, scene)])
                if topic.endswith("/scene"):
                    scenes[topic] = time_ns, data
                server.send(time_ns, [(topic, data)])
        if not again:
            return
        server.restart()


def _is_viewed(topic: str) -> bool:
    return not topic.startswith(("/sim/", "/episode"))

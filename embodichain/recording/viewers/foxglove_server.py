"""`FoxgloveServer`: channels of a log over Foxglove's WebSocket protocol, read-only.

It knows topics, schemas and who looks; what is shown is decided elsewhere. Needs foxglove-sdk.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from embodichain.recording.schema import descriptor_set
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from foxglove import Channel
    from foxglove.websocket import ChannelView, Client

__all__ = ["DEFAULT_PORT", "FoxgloveServer", "need_sdk"]

DEFAULT_PORT = 8765
"""Foxglove's own."""


def need_sdk() -> Any:
    """Return the package `foxglove`.

    Raises:
        ConfigError: It is not installed; names the extra.
    """
    try:
        import foxglove
    except ImportError as error:
        message, hint = "needs the package foxglove-sdk", "pip install 'embodichain[foxglove]'"
        raise ConfigError([Problem("viewer.name", message, hint)]) from error
    return foxglove


class FoxgloveServer:
    """Serves messages to viewers; a channel without subscribers costs nothing.

    Args:
        host: The address to listen on.
        port: 0 takes a free one.
        name: What clients show as the source.

    Raises:
        ConfigError: If foxglove-sdk is not installed, or the address cannot be listened on.
    """

    def __init__(self, host: str, port: int = DEFAULT_PORT, name: str = "embodichain") -> None:
        foxglove = self._sdk = need_sdk()
        self._context = foxglove.Context()
        self._channels: dict[str, Channel] = {}
        self._schemas: dict[str, Any] = {}
        self._audience = _Audience()
        try:
            self._server = foxglove.start_server(
                name=name,
                host=host,
                port=port,
                server_listener=self._audience,  # has what is called
                context=self._context,
            )
        except RuntimeError as error:
            message = f"cannot listen on {host}:{port}: {error}"
            raise ConfigError([Problem("viewer.port", message, "viewer.port=N is another")]) from (
                error
            )
        self.host, self.port = host, int(self._server.port)

    @property
    def url(self) -> str:
        """What clients open."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"ws://{host}:{self.port}"

    @property
    def wanted(self) -> bool:
        """Whether anybody looks at anything."""
        return self._audience.present

    def newcomers(self) -> set[str]:
        """Topics that somebody subscribed to since the last call."""
        return self._audience.take()

    def channel(self, topic: str, schema: str, data: bytes | None = None) -> None:
        """Declare a channel once.

        Args:
            topic: Its name.
            schema: ``embodichain.NAME`` or ``foxglove.NAME``.
            data: The schema's FileDescriptorSet, where it is this run's own.
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

    def watched(self, topic: str) -> bool:
        """Whether somebody has subscribed to a channel."""
        return bool(self._channels[topic].has_sinks())

    def send(self, time_ns: int, messages: Sequence[tuple[str, bytes]]) -> None:
        """Send messages to those who have subscribed.

        Raises:
            KeyError: If a channel was not declared.
        """
        for topic, data in messages:
            channel = self._channels[topic]
            if channel.has_sinks():
                channel.log(data, log_time=time_ns)

    def begin_anew(self) -> None:
        """Tell clients that time begins again: they forget what they have, and stay subscribed."""
        self._server.clear_session()

    def close(self) -> None:
        """Say goodbye to everybody. A second call does nothing."""
        self._server.stop()
        for channel in self._channels.values():
            channel.close()
        self._channels.clear()


class _Audience:
    """Who has subscribed to what; called on threads of the server."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._seats: set[tuple[int, int]] = set()
        self._new: set[str] = set()
        self.present = False

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Somebody wants a channel."""
        with self._lock:
            self._seats.add((client.id, channel.id))
            self._new.add(channel.topic)
            self.present = True

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        """Somebody wants it no longer, or has gone."""
        with self._lock:
            self._seats.discard((client.id, channel.id))
            self.present = bool(self._seats)

    def take(self) -> set[str]:
        """Topics with new subscribers since the last call."""
        if not self._new:
            return set()
        with self._lock:
            found, self._new = self._new, set()
        return found

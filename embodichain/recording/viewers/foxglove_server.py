"""`FoxgloveServer`: serves channels over Foxglove's WebSocket protocol, read-only.

It knows topics, schemas and subscriptions. Needs foxglove-sdk.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable
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

    Raises:
        ConfigError: If foxglove-sdk is not installed, or the address cannot be listened on.
    """

    def __init__(self, host: str, port: int = DEFAULT_PORT) -> None:
        foxglove = self._sdk = need_sdk()
        self._context = foxglove.Context()
        self._channels: dict[str, Channel] = {}
        self._schemas: dict[str, Any] = {}
        self._subscriptions = _Subscriptions()
        try:
            self._server = foxglove.start_server(
                name="embodichain",
                host=host,
                port=port,
                server_listener=self._subscriptions,
                context=self._context,
            )
        except RuntimeError as error:
            message, hint = f"cannot listen on {host}:{port}: {error}", "viewer.port=N is another"
            raise ConfigError([Problem("viewer.port", message, hint)]) from error
        self.port = int(self._server.port)
        self.url = f"ws://[{host}]:{self.port}" if ":" in host else f"ws://{host}:{self.port}"

    @property
    def wanted(self) -> bool:
        """Whether any channel has a subscriber."""
        return bool(self._subscriptions.present)

    def newcomers(self) -> set[str]:
        """Return topics with new subscriptions since the last call."""
        return self._subscriptions.take()

    def channel(self, topic: str, schema: str, data: bytes | None = None) -> None:
        """Declare a channel; a second call does nothing.

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

    def send(self, time_ns: int, messages: Iterable[tuple[str, bytes]]) -> None:
        """Send messages to their subscribers.

        Raises:
            KeyError: If a channel was not declared.
        """
        for topic, data in messages:
            channel = self._channels[topic]
            if channel.has_sinks():
                channel.log(data, log_time=time_ns)

    def restart(self) -> None:
        """Tell clients that time starts again: they drop what they have and stay subscribed."""
        self._server.clear_session()

    def close(self) -> None:
        """Close all connections. A second call does nothing."""
        self._server.stop()
        for channel in self._channels.values():
            channel.close()
        self._channels.clear()


class _Subscriptions:
    """Clients by channel; the server calls it on its own threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._new: set[str] = set()
        self.present: set[tuple[int, int]] = set()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Add a subscription."""
        with self._lock:
            self.present.add((client.id, channel.id))
            self._new.add(channel.topic)

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        """Remove a subscription; also called when a client has gone."""
        with self._lock:
            self.present.discard((client.id, channel.id))

    def take(self) -> set[str]:
        """Return topics with new subscriptions since the last call."""
        if not self._new:
            return set()
        with self._lock:
            found, self._new = self._new, set()
        return found

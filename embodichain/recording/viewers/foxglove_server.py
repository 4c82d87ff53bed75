"""`FoxgloveServer`: Foxglove's WebSocket protocol, on a socket whose requests are checked first.

The protocol is https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md: the server names its
channels in JSON, a viewer subscribes to some, and gets their messages in binary. Foxglove's own
server (foxglove-sdk) takes any page's connection and has no place for a check, so this one speaks
the part that a read-only server needs.
"""

from __future__ import annotations

import asyncio
import base64
import json
import logging
import socket
import struct
import threading
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from embodichain.recording.format.messages.schema import descriptor_set
from embodichain.recording.viewers.door import Door
from embodichain.recording.viewers.outbox import Outbox
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.system.access import Access
from embodichain.utils.system.addresses import reachable

__all__ = ["APPS", "FoxgloveServer"]

APPS = (
    "https://app.foxglove.dev",
    "https://studio.foxglove.dev",
    "https://lichtblick-suite.github.io",
    "file://",
)
"""Sites of Foxglove and Lichtblick, whose pages may connect; ``file://`` is the desktop's."""
_PORT = 8765  # Foxglove's default
_PROTOCOLS = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
"""Two names of the same messages: of foxglove-sdk, and of the published text."""
_MESSAGE = struct.Struct("<BIQ")
"""Head of a message: opcode 1, the subscription's number, the log time in ns."""
_WARNING, _ERROR = 1, 2
_LARGEST_REQUEST = 1 << 20
_CLOSE_SECONDS = 1.0
_PING_SECONDS = 60.0
"""A viewer that answers nothing for so long is gone."""


class _NoHandshakes(logging.Filter):
    """Leaves out connections that are not a WebSocket's, or close before they are one."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a line is written."""
        return record.getMessage() != "opening handshake failed"


_wire = logging.getLogger(f"{__name__}.wire")
_wire.setLevel(logging.WARNING)  # requests have the token: no line of them, even for debugging
_wire.addFilter(_NoHandshakes())


@dataclass(frozen=True, slots=True)
class _Channel:
    """A declared channel.

    Attributes:
        number: Its id in the protocol.
        topic: Its name.
        about: As it is advertised.
    """

    number: int
    topic: str
    about: Mapping[str, Any]


@dataclass(eq=False, slots=True)
class _Client:
    """A connected viewer; the server's thread changes it.

    Attributes:
        connection: Its connection.
        outbox: Messages that are to be sent to it.
        waits: Set while `outbox` has something.
        subscriptions: Number of a subscription to its topic.
        told: Numbers of the channels that were advertised to it.
    """

    connection: ServerConnection
    outbox: Outbox = field(default_factory=Outbox)
    waits: asyncio.Event = field(default_factory=asyncio.Event)
    subscriptions: dict[int, str] = field(default_factory=dict)
    told: set[int] = field(default_factory=set)

    def say(self, key: object, message: str | bytes) -> None:
        """Send a message when its turn comes."""
        self.outbox.put(key, message)
        self.waits.set()

    def complain(self, text: str, level: int = _ERROR) -> None:
        """Show the viewer's user a mistake."""
        self.say("status", json.dumps({"op": "status", "level": level, "message": text}))


class FoxgloveServer:
    """Serves messages to viewers, read-only; a channel without subscribers costs nothing.

    It sends on a thread of its own. What a viewer does not take in time is dropped, see `Outbox`.

    Args:
        host: The address to listen on.
        port: None is 8765, 0 a free one.
        access: Who may connect: a drawn token by default, and no pages but those of `APPS`.
        name: The server's name, which viewers show.

    Attributes:
        port: The port.
        url: Address for viewers, with the token: *Open connection*, Foxglove WebSocket.
        address: The same without it, for logs.

    Raises:
        ConfigError: If the address cannot be listened on, or `access` does not fit it.
    """

    def __init__(
        self,
        host: str,
        port: int | None = None,
        access: Access | None = None,
        name: str = "embodichain",
    ) -> None:
        self._name = name
        self._door = Door(host, access or Access(), APPS)
        self._channels: dict[str, _Channel] = {}
        self._lock = threading.Lock()
        self._new: set[str] = set()
        self._subscribers: dict[str, tuple[tuple[_Client, int], ...]] = {}
        self._clients: list[_Client] = []
        self._session = _session()
        listening = _listen(host, _PORT if port is None else port)
        self.port = int(listening.getsockname()[1])
        self.address = f"ws://{reachable(host)}:{self.port}"
        self.url = f"{self.address}/{self._door.query}" if self._door.asks else self.address
        self._loop = asyncio.new_event_loop()
        self._open = True
        self._ended = asyncio.Event()
        serving = threading.Event()
        self._thread = threading.Thread(
            target=self._run, args=(listening, serving), name="foxglove", daemon=True
        )
        self._thread.start()
        serving.wait()
        if not self._open:
            raise RuntimeError(f"the server at {self.address} does not start")

    # -- the run's thread --------------------------------------------------------------------------

    @property
    def wanted(self) -> bool:
        """Whether any channel has a subscriber."""
        return bool(self._subscribers)

    @property
    def connected(self) -> bool:
        """Whether a viewer is connected, whatever it is subscribed to."""
        return bool(self._clients)

    def is_wanted(self, topic: str) -> bool:
        """Whether a channel has a subscriber; KeyError if it was not declared."""
        return self._channels[topic].topic in self._subscribers

    def newcomers(self) -> set[str]:
        """Return topics with new subscriptions since the last call."""
        if not self._new:
            return set()
        with self._lock:
            new = self._new
            self._new = set()
        return new

    def channel(self, topic: str, schema: str, data: bytes | None = None) -> None:
        """Declare a channel; a second call does nothing.

        Args:
            topic: Its name.
            schema: ``embodichain.NAME`` or ``foxglove.NAME``.
            data: The schema's FileDescriptorSet if it is specific to this run.
        """
        if topic in self._channels:
            return
        content = descriptor_set(schema) if data is None else data
        number = len(self._channels) + 1
        about = {
            "id": number,
            "topic": topic,
            "encoding": "protobuf",
            "schemaName": schema,
            "schema": base64.b64encode(content).decode(),
            "schemaEncoding": "protobuf",
        }
        with self._lock:
            self._channels[topic] = _Channel(number, topic, about)
        self._ask(self._advertise)

    def send(self, time_ns: int, messages: Iterable[tuple[str, bytes]]) -> None:
        """Send messages to their subscribers; KeyError if a channel was not declared."""
        served: set[_Client] = set()
        for topic, data in messages:
            if not self.is_wanted(topic):
                continue
            for client, number in self._subscribers.get(topic, ()):
                client.outbox.put(number, _MESSAGE.pack(1, number, time_ns) + data)
                served.add(client)
        if served:
            self._ask(_wake, served)

    def restart(self) -> None:
        """Signal that time starts again: clients drop their data and stay subscribed."""
        self._session = _session()
        self._ask(self._introduce)

    def close(self) -> None:
        """Close all connections. A second call does nothing."""
        self._ask(self._ended.set)
        self._thread.join()

    def _ask(self, call: Any, *arguments: Any) -> None:
        """Have a function called on the server's thread, soon; never if the server has ended."""
        with self._lock:
            if self._open:
                self._loop.call_soon_threadsafe(call, *arguments)

    # -- the server's thread -----------------------------------------------------------------------

    def _run(self, listening: socket.socket, serving: threading.Event) -> None:
        try:
            self._loop.run_until_complete(self._serve(listening, serving))
        finally:
            with self._lock:
                self._open = False
            serving.set()
            self._loop.close()

    async def _serve(self, listening: socket.socket, serving: threading.Event) -> None:
        async with serve(
            self._meet,
            sock=listening,
            process_request=self._check,
            subprotocols=_PROTOCOLS,
            compression=None,
            max_size=_LARGEST_REQUEST,
            ping_timeout=_PING_SECONDS,
            close_timeout=_CLOSE_SECONDS,
            logger=_wire,
        ):
            serving.set()
            await self._ended.wait()

    def _check(self, connection: ServerConnection, request: Request) -> Response | None:
        """Refuse a request, or let it become a connection."""
        return self._door.refusal(request)

    async def _meet(self, connection: ServerConnection) -> None:
        """Serve one viewer until it goes."""
        client = _Client(connection)
        self._clients.append(client)
        client.say(None, self._introduction())
        self._advertise()
        sender = asyncio.create_task(_send(client))
        try:
            async for message in connection:
                self._take(client, message)
        except ConnectionClosed:
            pass  # without a farewell, as when a laptop is shut
        finally:
            sender.cancel()
            self._clients.remove(client)
            for number in list(client.subscriptions):
                self._unsubscribe(client, number)

    def _introduction(self) -> str:
        about = {
            "op": "serverInfo",
            "name": self._name,
            "capabilities": [],
            "supportedEncodings": [],
            "metadata": {},
            "sessionId": self._session,
        }
        return json.dumps(about)

    def _introduce(self) -> None:
        for client in self._clients:
            client.say(None, self._introduction())

    def _advertise(self) -> None:
        """Tell each viewer of the channels that it does not know."""
        with self._lock:
            channels = list(self._channels.values())
        for client in self._clients:
            new = [channel for channel in channels if channel.number not in client.told]
            if new:
                client.told |= {channel.number for channel in new}
                about = [channel.about for channel in new]
                client.say(None, json.dumps({"op": "advertise", "channels": about}))

    def _take(self, client: _Client, message: str | bytes) -> None:
        """Do what a viewer asks for."""
        try:
            if isinstance(message, bytes):
                raise ValueError("this server takes no messages")
            request = json.loads(message)
            op = request["op"]
            if op == "subscribe":
                for subscription in request["subscriptions"]:
                    number = int(subscription["id"])
                    self._subscribe(client, number, int(subscription["channelId"]))
            elif op == "unsubscribe":
                for number in request["subscriptionIds"]:
                    self._unsubscribe(client, int(number))
            else:
                client.complain(f"this server is read-only, it does not do {str(op)[:100]!r}")
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            client.complain(f"not a request of the protocol: {str(error)[:100]}")

    def _subscribe(self, client: _Client, number: int, channel: int) -> None:
        with self._lock:
            topics = [entry.topic for entry in self._channels.values() if entry.number == channel]
            if not topics or number in client.subscriptions or not 0 <= number < 1 << 32:
                why = f"subscription {number} to channel {channel}"
                client.complain(f"{why}: taken already, or no such channel", _WARNING)
                return
            topic = topics[0]
            client.subscriptions[number] = topic
            self._subscribers[topic] = (*self._subscribers.get(topic, ()), (client, number))
            self._new.add(topic)

    def _unsubscribe(self, client: _Client, number: int) -> None:
        topic = client.subscriptions.pop(number, None)
        if topic is None:
            client.complain(f"there is no subscription {number}", _WARNING)
            return
        client.outbox.forget(number)
        with self._lock:
            subscribers = self._subscribers[topic]
            others = tuple(entry for entry in subscribers if entry != (client, number))
            if others:
                self._subscribers[topic] = others
            else:
                del self._subscribers[topic]


async def _send(client: _Client) -> None:
    """Send what waits for a viewer, at its speed."""
    try:
        while True:
            await client.waits.wait()
            client.waits.clear()
            while (message := client.outbox.take()) is not None:
                await client.connection.send(message)
    except ConnectionClosed:
        pass  # `_meet` sees it as well


def _wake(clients: Iterable[_Client]) -> None:
    for client in clients:
        client.waits.set()


def _session() -> str:
    """A name for a stretch of time; another one than before."""
    return str(time.time_ns())


def _listen(host: str, port: int) -> socket.socket:
    """A listening socket, of the address's family.

    Raises:
        ConfigError: There is no such address here, or another program has the port.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        return socket.create_server(address[:2], family=family)
    except OSError as error:
        message = f"cannot listen on {host}:{port}: {error.strerror or error}"
        raise ConfigError([Problem("viewer.port", message, "viewer.port=N is another")]) from error

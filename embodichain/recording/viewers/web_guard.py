"""`Guard`: checks every request to a page of `viewer=web`, and serves the operator's part of it.

MuJoCo's web server answers pages of other sites, and takes files; see `web_process.py`.
"""

from __future__ import annotations

import functools
import socket
import threading
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit
from weakref import WeakKeyDictionary

from mujoco.studio.web import web_server

from embodichain.recording.viewers.operator_pages import SCRIPT, OperatorPages
from embodichain.utils.addresses import is_loopback

__all__ = ["GUARDS", "Guard", "guard_serving"]

_TELEOP = "/teleop"
_HEAD_END = b"</head>"
_TELEOP_TAG = f'<script src="{SCRIPT.name}"></script>'.encode()
_LOOPBACK = ("localhost", "127.0.0.1", "::1")


class Guard:
    """Checks the requests to one socket, and answers those for the operator's operators.

    Args:
        host: The address it listens on.
        operators: The operator's place; None serves Studio's page as it is.

    Attributes:
        serving: Set once requests are checked.
        connections: Paths of open WebSockets.
    """

    def __init__(self, host: str, operators: OperatorPages | None = None) -> None:
        self._names = {host.lower(), *_LOOPBACK} if is_loopback(host) else None
        self._operators = operators
        self.serving = threading.Event()
        self.connections: list[str] = []

    async def count(self, handler: Callable[[Any], Any], websocket: Any) -> None:
        """Handle a connection; it is in `connections` while it is open."""
        path = websocket.request.path.partition("?")[0]
        self.connections.append(path)
        operators = self._operators
        try:
            await (operators.handle if operators is not None and path == _TELEOP else handler)(
                websocket
            )
        finally:
            self.connections.remove(path)

    def answer(self, answer: Callable[[Any, Any], Any], connection: Any, request: Any) -> Any:
        """The response to a request that is not refused; None opens a WebSocket."""
        path = request.path.partition("?")[0]
        if self._operators is None:
            return answer(connection, request)
        if path == _TELEOP:
            return None
        if path == f"/{SCRIPT.name}":
            return _response(SCRIPT.read_bytes(), "text/javascript")
        response = answer(connection, request)
        if path in ("/", "/index.html"):
            page = response.body.replace(_HEAD_END, _TELEOP_TAG + _HEAD_END, 1)
            return _response(page, "text/html; charset=utf-8")
        return response

    def refusal(self, request: Any) -> Any:
        """The response if a request is refused, else None.

        Browsers let any page open a WebSocket to any address, with the page's site in ``Origin``;
        pages of other sites are refused. Another name in ``Host`` than ours is refused too: it may
        be a site's name that was made to resolve to this machine (DNS rebinding).
        """
        if request.path.partition("?")[0].endswith("/drop"):
            return _forbidden("this viewer takes no files")
        hosts = request.headers.get_all("Host")
        if len(hosts) != 1:
            return _forbidden("one Host is needed")
        if self._names is not None and urlsplit(f"//{hosts[0]}").hostname not in self._names:
            return _forbidden("this viewer is not known by that name")
        for origin in request.headers.get_all("Origin"):
            if urlsplit(origin).netloc.lower() != hosts[0].lower():
                return _forbidden("pages of other sites may not use this viewer")
        return None


GUARDS: WeakKeyDictionary[socket.socket, Guard] = WeakKeyDictionary()
"""The guard of each socket that has one."""


def guard_serving() -> None:
    """Make MuJoCo's server check requests to guarded sockets first."""
    plain: Callable[..., Any] = web_server.serve

    def serve(handler: Callable[[Any], Any], *args: Any, **kwargs: Any) -> Any:
        guard = GUARDS.get(kwargs.get("sock"))  # type: ignore[arg-type]
        if guard is None:
            return plain(handler, *args, **kwargs)
        answer = kwargs["process_request"]

        def checked(connection: Any, request: Any) -> Any:
            refused = guard.refusal(request)
            return guard.answer(answer, connection, request) if refused is None else refused

        guard.serving.set()
        kwargs["process_request"] = checked
        return plain(functools.partial(guard.count, handler), *args, **kwargs)

    web_server.serve = serve


def _response(body: bytes, kind: str) -> Any:
    """A response with the headers that the page's shared memory needs."""
    headers = web_server.Headers()
    headers["Content-Type"], headers["Content-Length"] = kind, str(len(body))
    headers["Cache-Control"] = "no-store"
    headers["Cross-Origin-Opener-Policy"] = "same-origin"
    headers["Cross-Origin-Embedder-Policy"] = "require-corp"
    return web_server.Response(200, "OK", headers, body)


def _forbidden(why: str) -> Any:
    return web_server.Response(403, "Forbidden", web_server.Headers(), f"{why}\n".encode())

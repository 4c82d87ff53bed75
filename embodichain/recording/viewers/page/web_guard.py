"""`Guard`: checks every request to a page of `viewer=web`, and serves the operator's part of it.

MuJoCo's web server answers pages of other sites, and takes files; see `web_process.py`.
"""

from __future__ import annotations

import functools
import html
import json
import re
import socket
import threading
from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

from mujoco.studio.web import web_server

from embodichain.recording.viewers.door import Door, forbidden, harden
from embodichain.recording.viewers.operators.operator_pages import SCRIPT, OperatorPages

__all__ = ["GUARDS", "Guard", "guard_serving"]

_TELEOP = "/teleop"
_SWITCHING = 101
_HEAD_END = b"</head>"
_TELEOP_TAG = f'<script src="{SCRIPT.name}"></script>'.encode()
_TITLE = re.compile(rb"<title>.*?</title>", re.DOTALL)
_KEEP_TITLE = """<script>{{
  const title = {title};
  const show = () => {{ if (document.title !== title) document.title = title; }};
  new MutationObserver(show).observe(document.querySelector("title"), {{childList: true}});
}}</script>"""
"""MuJoCo's program names the page after itself when it starts; it has no option for that."""
_HIDE_TOKEN = b"<script>history.replaceState(null, '', location.pathname)</script>"
"""Removes the token from the address, once the cookie is set: it is not for bookmarks."""


class Guard:
    """Checks the requests to one socket, and answers those of the operator's pages.

    Args:
        door: Decides who may use the page.
        operators: The operator's pages; None serves Studio's page without them.
        title: Title of the page.

    Attributes:
        serving: Set once requests are checked.
        connections: Paths of open WebSockets.
    """

    def __init__(
        self, door: Door, operators: OperatorPages | None = None, title: str = "embodichain"
    ) -> None:
        self._door = door
        text = json.dumps(title).replace("<", "\\u003c")  # it would end the script
        keep_title = _KEEP_TITLE.format(title=text)
        self._title = f"<title>{html.escape(title)}</title>{keep_title}".encode()
        self._operators = operators
        self.serving = threading.Event()
        self.connections: list[str] = []

    async def count(self, handler: Callable[[Any], Any], websocket: Any) -> None:
        """Handle a connection; it is in `connections` while it is open."""
        path = websocket.request.path.partition("?")[0]
        self.connections.append(path)
        if self._operators is not None and path == _TELEOP:
            handler = self._operators.handle
        try:
            await handler(websocket)
        finally:
            self.connections.remove(path)

    def answer(self, answer: Callable[[Any, Any], Any], connection: Any, request: Any) -> Any:
        """The response to a request that is not refused; None opens a WebSocket."""
        response = self._content(answer, connection, request)
        if response is not None:
            self._door.greet(request, response)
        return response

    def _content(self, answer: Callable[[Any, Any], Any], connection: Any, request: Any) -> Any:
        """The response of MuJoCo's server, in its page our title and scripts; our script."""
        path, _, query = request.path.partition("?")
        if self._operators is not None:
            if path == _TELEOP:
                return None
            if path == f"/{SCRIPT.name}":
                return _response(SCRIPT.read_bytes(), "text/javascript")
        response = answer(connection, request)
        if path not in ("/", "/index.html"):
            return response
        tags = b""
        if "token=" in query:
            tags += _HIDE_TOKEN
        if self._operators is not None:
            tags += _TELEOP_TAG
        page = _TITLE.sub(lambda _: self._title, response.body, count=1)
        page = page.replace(_HEAD_END, tags + _HEAD_END, 1)
        return _response(page, "text/html; charset=utf-8")

    def refusal(self, request: Any) -> Any:
        """The response if a request is refused, else None."""
        refused = self._door.refusal(request)
        if refused is None and request.path.partition("?")[0].endswith("/drop"):
            return forbidden("this viewer takes no files")
        return refused


GUARDS: WeakKeyDictionary[socket.socket, Guard] = WeakKeyDictionary()
"""The guard of each socket that has one."""


def guard_serving() -> None:
    """Make MuJoCo's server check requests to guarded sockets first, in this process.

    MuJoCo's server calls `websockets.serve` in a function of its own thread, with its own handlers:
    no argument, subclass or socket of ours comes between a request and its answer. So the name
    that this function calls is replaced, in the one process where nobody else can use it: it is
    started for one page (`web_process.py`) and ends with it. No process of a user calls this.
    """
    serve_unguarded: Callable[..., Any] = web_server.serve

    def serve(handler: Callable[[Any], Any], *args: Any, **kwargs: Any) -> Any:
        guard = GUARDS.get(kwargs.get("sock"))  # type: ignore[arg-type]
        if guard is None:
            return serve_unguarded(handler, *args, **kwargs)
        answer = kwargs["process_request"]
        finish = kwargs["process_response"]

        def check_and_answer(connection: Any, request: Any) -> Any:
            refusal = guard.refusal(request)
            if refusal is not None:
                return refusal
            return guard.answer(answer, connection, request)

        def finish_and_harden(connection: Any, request: Any, response: Any) -> Any:
            response = finish(connection, request, response) or response
            # MuJoCo lets pages of other sites read every response; a WebSocket's stays so.
            if response.status_code == _SWITCHING:
                return response
            return harden(response)

        guard.serving.set()
        kwargs["process_request"] = check_and_answer
        kwargs["process_response"] = finish_and_harden
        return serve_unguarded(functools.partial(guard.count, handler), *args, **kwargs)

    web_server.serve = serve


def _response(body: bytes, content_type: str) -> Any:
    """A response with the headers that the page's shared memory needs."""
    headers = web_server.Headers()
    headers["Content-Type"] = content_type
    headers["Content-Length"] = str(len(body))
    headers["Cache-Control"] = "no-store"
    headers["Cross-Origin-Opener-Policy"] = "same-origin"
    headers["Cross-Origin-Embedder-Policy"] = "require-corp"
    return web_server.Response(200, "OK", headers, body)

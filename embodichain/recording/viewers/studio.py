"""`Studio`: MuJoCo Studio's web viewer on one address, for looking only.

MuJoCo 4.0's web viewer listens on every interface, takes files that are dropped on its page, and
answers pages of other sites. All of that is changed here and nowhere else, by two seams: `_Viewer`
gives the address, and `_guard_serving` puts a check before every request. Where a MuJoCo has them
no more, nothing is served. Importing this imports MuJoCo Studio; only `web_process.py` does.
"""

from __future__ import annotations

import functools
import socket
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any
from urllib.parse import urlsplit
from weakref import WeakKeyDictionary

import mujoco
from mujoco.studio import launch_thread, viewer_protocol, web_viewer
from mujoco.studio.web import web_server

from embodichain.utils.addresses import is_loopback
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["Studio"]

_START_SECONDS = 20.0
_IDLE_SECONDS = 0.05
_LOOPBACK = ("localhost", "127.0.0.1", "::1")


class Studio:
    """Serves a model's page from threads of its own until it is closed; once in a process.

    Args:
        model: Shown first; copied.
        host: The address to listen on.
        port: The port, or None for the first free one from 8080.
        title: Of the page.
        plugins: Studio's viewer plugins.

    Attributes:
        url: Where the page is.

    Raises:
        ConfigError: The address cannot be listened on, or this MuJoCo's viewer cannot be
            confined.
    """

    def __init__(
        self, model: mujoco.MjModel, host: str, port: int | None, title: str, plugins: Sequence[Any]
    ) -> None:
        made: list[_Viewer] = []
        ready = threading.Event()

        def run(endpoint: Any) -> None:
            try:
                config = viewer_protocol.ViewerConfig(title=title, gfx="web", http_port=port or 0)
                made.append(_Viewer(host, config, endpoint, model=model, plugins=list(plugins)))
            finally:
                ready.set()
            viewer_protocol.run_viewer_loop(made[0])

        _guard_serving()
        self._handle = launch_thread.launch_thread(run)
        ready.wait(_START_SECONDS)
        if not made:
            self._fail(host)
        self.url = made[0].url
        self._guard = made[0].guard

    @property
    def watched(self) -> bool:
        """Whether a browser has the page open."""
        return bool(self._guard.connections)

    @property
    def controlled(self) -> bool:
        """Whether one of them has the panel; the others look on."""
        return "/ui" in self._guard.connections

    def send(self, message: Any) -> None:
        """Hand the viewer one of Studio's messages."""
        self._handle.send_to_viewer(message)

    def close(self, reason: str) -> None:
        """Serve no longer.

        Args:
            reason: What open pages say.
        """
        self._handle.close(reason)

    def _fail(self, host: str) -> None:
        """Say why there is no viewer."""
        try:
            self._handle.close()  # raises what its thread raised
        except Exception as error:
            raise _refused(f"cannot listen on {host}: {error}") from error
        raise _refused(f"cannot listen on {host}: MuJoCo's viewer does not start")


class _Viewer(web_viewer.WebViewer):  # type: ignore[misc]
    """Studio's web viewer, which binds `_host`: here that is the address it is told."""

    def __init__(self, host: str, *args: Any, **kwargs: Any) -> None:
        self._address = host
        super().__init__(*args, **kwargs)

    @property
    def _host(self) -> str:
        return self._address

    @_host.setter
    def _host(self, every_interface: str) -> None:
        """MuJoCo sets what it would listen on; it is not heard."""

    @property
    def url(self) -> str:
        """Where the page is, for a browser on this machine."""
        host = "127.0.0.1" if self._address in ("0.0.0.0", "::") else self._address
        name = f"[{host}]" if ":" in host else host
        return f"http://{name}:{self._http_sock.getsockname()[1]}/"

    def _start_server(self) -> None:
        """Start serving, if the socket is what it should be; and make sure requests are checked."""
        bound = self._http_sock.getsockname()[0]
        if bound not in {found[4][0] for found in socket.getaddrinfo(self._address, None)}:
            raise RuntimeError(f"MuJoCo {mujoco.__version__} listens on {bound}")
        self._http_sock.listen()  # a port that is taken fails here, not in the server's thread
        self.guard = _GUARDS[self._http_sock] = _Guard(self._address)
        super()._start_server()
        if not self.guard.serving.wait(_START_SECONDS):
            self._web_server.stop()
            raise RuntimeError(f"requests to MuJoCo {mujoco.__version__}'s viewer are not checked")

    def prepare_next_frame(self) -> bool:
        """Draw only for an open page."""
        if not self.guard.connections:
            time.sleep(_IDLE_SECONDS)
            return False
        ready: bool = super().prepare_next_frame()
        return ready

    def get_drop_file(self) -> str:
        """No file was ever dropped."""
        return ""


class _Guard:
    """What one socket's requests must be like.

    Args:
        host: The address it listens on.

    Attributes:
        serving: Set once requests are checked.
        connections: Paths of WebSockets that are open.
    """

    def __init__(self, host: str) -> None:
        self._names = {host.lower(), *_LOOPBACK} if is_loopback(host) else None
        self.serving = threading.Event()
        self.connections: list[str] = []

    async def count(self, handler: Callable[[Any], Any], websocket: Any) -> None:
        """Handle a connection, and know of it."""
        path = websocket.request.path.partition("?")[0]
        self.connections.append(path)
        try:
            await handler(websocket)
        finally:
            self.connections.remove(path)

    def refusal(self, request: Any) -> Any:
        """The answer to a request that is not heard, or None.

        No page of another site may talk to the viewer: browsers let any page open a WebSocket
        anywhere, and say where it comes from in ``Origin``. A name in ``Host`` that is not ours is
        a site's whose name was pointed at this machine.
        """
        if request.path.partition("?")[0].endswith("/drop"):
            return _forbidden("this viewer takes no files")
        named = request.headers.get_all("Host")
        if len(named) != 1:
            return _forbidden("one Host is needed")
        if self._names is not None and urlsplit(f"//{named[0]}").hostname not in self._names:
            return _forbidden("this viewer is not known by that name")
        for origin in request.headers.get_all("Origin"):
            if urlsplit(origin).netloc.lower() != named[0].lower():
                return _forbidden("pages of other sites may not use this viewer")
        return None


_GUARDS: WeakKeyDictionary[socket.socket, _Guard] = WeakKeyDictionary()


def _guard_serving() -> None:
    """Check requests to guarded sockets first."""
    plain: Callable[..., Any] = web_server.serve

    def serve(handler: Callable[[Any], Any], *args: Any, **kwargs: Any) -> Any:
        guard = _GUARDS.get(kwargs.get("sock"))  # type: ignore[arg-type]
        if guard is None:
            return plain(handler, *args, **kwargs)
        answer = kwargs["process_request"]

        def checked(connection: Any, request: Any) -> Any:
            refused = guard.refusal(request)
            return answer(connection, request) if refused is None else refused

        guard.serving.set()
        kwargs["process_request"] = checked
        return plain(functools.partial(guard.count, handler), *args, **kwargs)

    web_server.serve = serve


def _forbidden(why: str) -> Any:
    return web_server.Response(403, "Forbidden", web_server.Headers(), f"{why}\n".encode())


def _refused(why: str) -> ConfigError:
    return ConfigError([Problem("viewer", why)])

"""`Door`: checks every request to a server before it is answered.

A request needs a name of this server in ``Host``, an allowed site in ``Origin`` if it has one, and
the server's token: as ``?token=`` in the address, in the cookie that the first page sets, or as
``Authorization: Bearer``. These are the checks of Jupyter's server.
"""

from __future__ import annotations

import contextlib
import hmac
import html
import ipaddress
import secrets
import socket
from collections.abc import Sequence
from urllib.parse import quote, unquote, urlsplit

from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from embodichain.utils.errors import ConfigError
from embodichain.utils.system.access import AUTO, NONE, WITHHELD, Access
from embodichain.utils.system.addresses import is_loopback

__all__ = ["Door", "forbidden", "harden"]

_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_ASKS = (
    "This server asks for its token. Open the address that was printed when it started, which "
    "has it (?token=...); a program can send the header Authorization: Bearer TOKEN."
)
_FORM = (
    "<!doctype html><title>embodichain</title><p>{asks}</p>"
    '<form><input name="token" type="password" autofocus autocomplete="off"> '
    "<button>Open</button></form>\n"
)


class Door:
    """Decides which requests a server answers.

    Args:
        host: The address that the server listens on.
        access: Who may use it.
        origins: Sites whose pages may use it if `access` names none.

    Attributes:
        asks: Whether a token is needed.

    Raises:
        ConfigError: If `access` is wrong, or does not fit the address.
    """

    def __init__(self, host: str, access: Access, origins: Sequence[str] = ()) -> None:
        problems = list(access.problems(host))
        if problems:
            raise ConfigError(problems)
        self._token: bytes | None = None
        if access.token != NONE:
            drawn = access.token in (AUTO, WITHHELD)
            self._token = (secrets.token_urlsafe(32) if drawn else access.token).encode()
        self._session = secrets.token_urlsafe(32)  # the cookie's value, which is not the token
        self._ticket: bytes | None = None
        self._names = {_plain(name) for name in (host, *access.allow_hosts)}
        self._any_address = not is_loopback(host)
        if self._any_address:
            self._names.add(_plain(socket.gethostname()))
        self._names |= set(_LOOPBACK)
        allowed = origins if access.allow_origins is None else access.allow_origins
        self._origins = {_site(origin) for origin in allowed}

    @property
    def asks(self) -> bool:
        """Whether a token is needed."""
        return self._token is not None

    @property
    def query(self) -> str:
        """The end of an address that has the token: ``?token=...``, or nothing."""
        return "" if self._token is None else f"?token={quote(self._token.decode(), safe='')}"

    def query_once(self) -> str:
        """Return the end of an address that opens one page, once: ``?token=...``, or nothing.

        It is for a browser's command line, which other users of this machine can read.
        """
        if self._token is None:
            return ""
        ticket = secrets.token_urlsafe(32)
        self._ticket = ticket.encode()
        return f"?token={ticket}"

    def refusal(self, request: Request) -> Response | None:
        """The response if a request is refused, else None.

        Browsers let any page open a WebSocket to any address, with the page's site in ``Origin``;
        pages of other sites are refused. Another name in ``Host`` than ours is refused too: it may
        be a site's name that was made to resolve to this machine (DNS rebinding). A number is no
        name, so a server for other machines is known by any address.
        """
        hosts = request.headers.get_all("Host")
        if len(hosts) != 1:
            return forbidden("one Host is needed")
        if not self._is_name(_host_and_port(hosts[0])[0]):
            return forbidden("this viewer is not known by that name")
        for origin in request.headers.get_all("Origin"):
            own = _site(origin).partition("://")[2] == hosts[0].lower()
            if not own and _site(origin) not in self._origins:
                return forbidden("pages of other sites may not use this viewer")
        if self._token is None or self._has_token(request) or self._has_cookie(request):
            return None
        if self._has_ticket(request) and "Upgrade" not in request.headers:
            return None  # `greet` takes it
        return _unauthorized(request)

    def greet(self, request: Request, response: Response) -> None:
        """Add the cookie to the response to a request that has the token.

        Args:
            request: A request that was not refused.
            response: Its response; changed.
        """
        if self._token is None or self._has_cookie(request):
            return
        once = self._has_ticket(request)
        if once:
            self._ticket = None
        if once or self._has_token(request):
            response.headers["Set-Cookie"] = (
                f"{_cookie_name(request)}={self._session}; Path=/; HttpOnly; SameSite=Strict"
            )

    def _is_name(self, name: str) -> bool:
        if name in self._names:
            return True
        if not self._any_address:
            return False
        with contextlib.suppress(ValueError):
            ipaddress.ip_address(name)
            return True
        return False

    def _has_token(self, request: Request) -> bool:
        """Whether address or header have the token; the time does not tell how much of it."""
        given = _tokens(request)
        for value in request.headers.get_all("Authorization"):
            scheme, _, text = value.strip().partition(" ")
            if scheme.lower() == "bearer":
                given.append(text.strip())
        return any([_equal(text, self._token) for text in given])

    def _has_ticket(self, request: Request) -> bool:
        return any([_equal(text, self._ticket) for text in _tokens(request)])

    def _has_cookie(self, request: Request) -> bool:
        name = _cookie_name(request)
        lines = request.headers.get_all("Cookie")
        pairs = [pair.strip().partition("=") for line in lines for pair in line.split(";")]
        given = [value for key, _, value in pairs if key == name]
        return any([_equal(value, self._session.encode()) for value in given])


def forbidden(why: str) -> Response:
    """The response to a request that is refused whoever sends it."""
    return harden(Response(403, "Forbidden", Headers(), f"{why}\n".encode()))


def harden(response: Response) -> Response:
    """Forbid other pages to frame a response, to load it, and to learn its address; return it."""
    headers = response.headers
    for name, value in (
        ("X-Frame-Options", "DENY"),
        ("Cross-Origin-Resource-Policy", "same-origin"),
        ("Referrer-Policy", "no-referrer"),
        ("X-Content-Type-Options", "nosniff"),
    ):
        if name in headers:
            del headers[name]
        headers[name] = value
    if "Access-Control-Allow-Origin" in headers:
        del headers["Access-Control-Allow-Origin"]
    return response


def _unauthorized(request: Request) -> Response:
    """The response without the token: for a browser a page with a field for it."""
    page = any("text/html" in value for value in request.headers.get_all("Accept"))
    body = _FORM.format(asks=html.escape(_ASKS)) if page else f"{_ASKS}\n"
    headers = Headers()
    headers["WWW-Authenticate"] = 'Bearer realm="embodichain"'
    headers["Content-Type"] = f"text/{'html' if page else 'plain'}; charset=utf-8"
    headers["Content-Length"] = str(len(body.encode()))
    headers["Cache-Control"] = "no-store"
    return harden(Response(401, "Unauthorized", headers, body.encode()))


def _tokens(request: Request) -> list[str]:
    """What the address gives as the token."""
    pairs = [pair.partition("=") for pair in request.path.partition("?")[2].split("&")]
    return [unquote(value) for key, _, value in pairs if key == "token"]


def _equal(given: str, expected: bytes | None) -> bool:
    return expected is not None and hmac.compare_digest(given.encode(errors="replace"), expected)


def _plain(name: str) -> str:
    """A name as it is compared: small letters, without brackets and the root's dot."""
    return name.lower().strip("[]").rstrip(".")


def _host_and_port(header: str) -> tuple[str, int]:
    """The name in a ``Host``, empty if there is none, and its port."""
    try:
        parts = urlsplit(f"//{header}")
        return _plain(parts.hostname or ""), 80 if parts.port is None else parts.port
    except ValueError:
        return "", 80


def _site(origin: str) -> str:
    """An ``Origin`` as it is compared."""
    scheme, separator, host = origin.lower().partition("://")
    return f"{scheme}{separator}{host.rstrip('/')}"


def _cookie_name(request: Request) -> str:
    """The cookie's name, with the port that the browser sees: it sends a cookie to every port."""
    return f"embodichain-{_host_and_port(request.headers.get_all('Host')[0])[1]}"

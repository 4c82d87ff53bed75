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
_HTTP_PORT = 80
_PROTECTION = {
    "X-Frame-Options": "DENY",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Headers of every response."""
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
            is_drawn = access.token in (AUTO, WITHHELD)
            token = secrets.token_urlsafe(32) if is_drawn else access.token
            self._token = token.encode()
        self._session = secrets.token_urlsafe(32)  # the cookie's value, which is not the token
        self._ticket: bytes | None = None  # a token that is accepted once
        self._names = {_plain(name) for name in (host, *access.allow_hosts)}
        self._any_address = not is_loopback(host)
        if self._any_address:
            self._names.add(_plain(socket.gethostname()))
        self._names |= set(_LOOPBACK)
        if access.allow_origins is not None:
            origins = access.allow_origins
        self._origins = {_site(origin) for origin in origins}

    @property
    def asks(self) -> bool:
        """Whether a token is needed."""
        return self._token is not None

    @property
    def query(self) -> str:
        """The end of an address that has the token: ``?token=...``, or nothing."""
        if self._token is None:
            return ""
        return f"?token={quote(self._token.decode(), safe='')}"

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
        be a site's name that was made to resolve to this machine (DNS rebinding). A number is not
        a name, so a server for other machines is known by any address.
        """
        hosts = request.headers.get_all("Host")
        if len(hosts) != 1:
            return forbidden("one Host is needed")
        if not self._is_name(_host_and_port(hosts[0])[0]):
            return forbidden("this viewer is not known by that name")
        for origin in request.headers.get_all("Origin"):
            site = _site(origin)
            is_own = site.partition("://")[2] == hosts[0].lower()
            if not is_own and site not in self._origins:
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
        has_ticket = self._has_ticket(request)
        if has_ticket:
            self._ticket = None
        if has_ticket or self._has_token(request):
            response.headers["Set-Cookie"] = (
                f"{_cookie_name(request)}={self._session}; Path=/; HttpOnly; SameSite=Strict"
            )

    def _is_name(self, name: str) -> bool:
        """Whether this server is known by a name, or by the address that it is."""
        if name in self._names:
            return True
        if not self._any_address:
            return False
        with contextlib.suppress(ValueError):
            ipaddress.ip_address(name)
            return True
        return False

    def _has_token(self, request: Request) -> bool:
        """Whether address or header have the token."""
        tokens = _tokens(request)
        for value in request.headers.get_all("Authorization"):
            scheme, _, text = value.strip().partition(" ")
            if scheme.lower() == "bearer":
                tokens.append(text.strip())
        return _any_equal(tokens, self._token)

    def _has_ticket(self, request: Request) -> bool:
        """Whether the address has the ticket."""
        return _any_equal(_tokens(request), self._ticket)

    def _has_cookie(self, request: Request) -> bool:
        """Whether the request has the cookie of this session."""
        name = _cookie_name(request)
        values = []
        for line in request.headers.get_all("Cookie"):
            for pair in line.split(";"):
                key, _, value = pair.strip().partition("=")
                if key == name:
                    values.append(value)
        return _any_equal(values, self._session.encode())


def forbidden(why: str) -> Response:
    """The response to a request that is refused whoever sends it."""
    return harden(Response(403, "Forbidden", Headers(), f"{why}\n".encode()))


def harden(response: Response) -> Response:
    """Forbid other pages to frame a response, to load it, and to learn its address; return it."""
    headers = response.headers
    for name, value in _PROTECTION.items():
        if name in headers:
            del headers[name]  # else there would be two: assignment adds
        headers[name] = value
    if "Access-Control-Allow-Origin" in headers:
        del headers["Access-Control-Allow-Origin"]
    return response


def _unauthorized(request: Request) -> Response:
    """The response without the token: for a browser a page with a field for it."""
    is_browser = any("text/html" in value for value in request.headers.get_all("Accept"))
    if is_browser:
        content_type = "text/html"
        body = _FORM.format(asks=html.escape(_ASKS)).encode()
    else:
        content_type = "text/plain"
        body = f"{_ASKS}\n".encode()
    headers = Headers()
    headers["WWW-Authenticate"] = 'Bearer realm="embodichain"'
    headers["Content-Type"] = f"{content_type}; charset=utf-8"
    headers["Content-Length"] = str(len(body))
    headers["Cache-Control"] = "no-store"
    return harden(Response(401, "Unauthorized", headers, body))


def _tokens(request: Request) -> list[str]:
    """The values of ``token`` in the address."""
    tokens = []
    for pair in request.path.partition("?")[2].split("&"):
        key, _, value = pair.partition("=")
        if key == "token":
            tokens.append(unquote(value))
    return tokens


def _any_equal(texts: list[str], expected: bytes | None) -> bool:
    """Whether one of the texts is the expected one; the time does not tell how much of it."""
    if expected is None:
        return False
    # A list: all texts are compared, so that the time does not tell which one is equal either.
    return any([hmac.compare_digest(text.encode(errors="replace"), expected) for text in texts])


def _plain(name: str) -> str:
    """A name as it is compared: lower case, without brackets and the root's dot."""
    return name.lower().strip("[]").rstrip(".")


def _host_and_port(header: str) -> tuple[str, int]:
    """The name in a ``Host``, empty if there is none, and its port."""
    try:
        parts = urlsplit(f"//{header}")
        name = _plain(parts.hostname or "")
        port = parts.port
    except ValueError:
        return "", _HTTP_PORT
    return name, _HTTP_PORT if port is None else port


def _site(origin: str) -> str:
    """An ``Origin`` as it is compared."""
    scheme, separator, host = origin.lower().partition("://")
    return f"{scheme}{separator}{host.rstrip('/')}"


def _cookie_name(request: Request) -> str:
    """The cookie's name, with the port that the browser sees: it sends a cookie to every port."""
    return f"embodichain-{_host_and_port(request.headers.get_all('Host')[0])[1]}"

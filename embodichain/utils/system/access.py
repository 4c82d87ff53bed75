"""`Access`: who may use a server: its token, its names, and pages of other sites."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from embodichain.utils.errors import Problem
from embodichain.utils.system.addresses import is_loopback

__all__ = ["AUTO", "NONE", "WITHHELD", "Access", "is_secret"]

AUTO = "auto"
"""A token that is drawn when the server starts."""
NONE = "none"
"""No token: for addresses that only this machine reaches."""
WITHHELD = "<token>"
"""In records in place of a given token; read again, it is `AUTO`."""
_TOKEN = re.compile(r"[!-~]+")
_HOST = re.compile(r"[^\s/?#@*]+")
_ORIGIN = re.compile(r"file://|[a-z][a-z0-9+.-]*://[^\s/?#@*]+/?")


def is_secret(token: object) -> bool:
    """Whether the value of a key `token` is a given one, which no record may contain."""
    return isinstance(token, str) and token not in (AUTO, NONE, WITHHELD)


@dataclass(frozen=True, slots=True)
class Access:
    """Who may use a server.

    Attributes:
        token: ``auto`` draws one, ``none`` asks for none, another text is the token.
        allow_hosts: Names of this server in addition to its address, as in ``Host``, without a
            port.
        allow_origins: Sites whose pages may use it, such as ``https://app.foxglove.dev``; None is
            the server's default. Its own pages always may.
    """

    token: str = field(default=AUTO, repr=False)
    allow_hosts: Sequence[str] = ()
    allow_origins: Sequence[str] | None = None

    def problems(self, host: str, path: str = "viewer") -> Iterator[Problem]:
        """Yield what is wrong in it, for a server that listens on an address.

        Args:
            host: The address.
            path: Key path of the server's config, for messages.
        """
        token = self.token
        token_path = f"{path}.token"
        if token == NONE and not is_loopback(host):
            message = (
                f"none is for an address that only this machine reaches, and {path}.host is {host}"
            )
            yield Problem(token_path, message, "Leave it out and one is drawn, or give a text.")
        elif token.lower() in (AUTO, NONE) and token not in (AUTO, NONE):
            hint = f"Did you mean {token.lower()!r}?"
            yield Problem(token_path, "auto and none are written in small letters", hint)
        elif is_secret(token) and not _TOKEN.fullmatch(token):
            message = "a token consists of printable ASCII characters without blanks"
            yield Problem(token_path, message, "It is sent in addresses and headers.")
        for i, name in enumerate(self.allow_hosts):
            if not _HOST.fullmatch(name):
                message = f"expected a name without scheme and path, got {name!r}"
                yield Problem(f"{path}.allow_hosts.{i}", message, "For example lab.example.org.")
        for i, origin in enumerate(self.allow_origins or ()):
            if not _ORIGIN.fullmatch(origin.lower()):
                message = f"expected a site with its scheme, without a path, got {origin!r}"
                hint = "For example https://app.foxglove.dev; there is no wildcard."
                yield Problem(f"{path}.allow_origins.{i}", message, hint)

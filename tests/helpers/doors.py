"""The way in: port and token of an address that a server printed."""

from urllib.parse import parse_qs, urlsplit


def port_of(url: str) -> int:
    """The port of an address."""
    port = urlsplit(url).port
    assert port is not None
    return port


def token_of(url: str) -> str:
    """The token of an address."""
    return parse_qs(urlsplit(url).query)["token"][0]


def bearer(url: str) -> dict[str, str]:
    """The header with which a program that knows an address comes in."""
    return {"Authorization": f"Bearer {token_of(url)}"}

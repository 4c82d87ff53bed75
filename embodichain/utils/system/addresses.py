"""Addresses that viewers listen on."""

from __future__ import annotations

import ipaddress

__all__ = ["is_loopback", "reachable"]


def is_loopback(host: str) -> bool:
    """Whether an address is reachable from this machine only, such as ``127.0.0.1``."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def reachable(host: str) -> str:
    """An address to listen on as a URL of this machine names it: ``[::1]``, 127.0.0.1 for any."""
    host = "127.0.0.1" if host in ("0.0.0.0", "::") else host
    return f"[{host}]" if ":" in host else host

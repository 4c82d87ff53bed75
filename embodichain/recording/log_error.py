"""Errors of reading a log, and the size beyond which nothing in a file is accepted."""

from __future__ import annotations

from embodichain.utils.errors import ConfigError

__all__ = ["LARGEST_CHUNK", "DamageError", "LogError"]

LARGEST_CHUNK = 2**27
"""Bytes of a chunk's content, at most: nothing larger is written, or unpacked when read."""


class LogError(ConfigError):
    """A file is MCAP, but not a log that this version can replay."""


class DamageError(Exception):
    """Bytes of a log are damaged; the text says what is wrong."""

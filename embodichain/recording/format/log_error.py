"""Errors of reading a log, and the size limit of chunks."""

from __future__ import annotations

from embodichain.utils.errors import ConfigError

__all__ = ["LARGEST_CHUNK", "LONGEST_CHUNK", "DamageError", "LogError"]

LARGEST_CHUNK = 2**27
"""Size limit of a chunk's content in bytes: larger chunks are neither written nor unpacked."""
LONGEST_CHUNK = LARGEST_CHUNK + 2**20
"""Size limit of its record, which is a little longer than its content if that is random."""


class LogError(ConfigError):
    """An MCAP file is not a log that this version can read or replay."""


class DamageError(Exception):
    """Bytes of a log are damaged; the text says what is wrong."""

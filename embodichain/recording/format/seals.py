"""Digests of a log's metadata and attachments, for which MCAP has no checksum, or only a weak one.

A sealed metadata record has the digest of its name and of all its other entries, so a change of
the digest itself is found as well. The first record lists the attachments with theirs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import blake2b

from embodichain.recording.format.log_error import DamageError

__all__ = ["SEAL", "check_seal", "digest_of", "sealed"]

SEAL = "digest"
"""Key of a metadata record's digest of itself."""


def digest_of(data: bytes | memoryview) -> str:
    """BLAKE2b with 16 bytes, as 32 hexadecimal digits."""
    return blake2b(data, digest_size=16).hexdigest()


def _seal_of(name: str, values: Mapping[str, str]) -> str:
    entries = sorted((key, value) for key, value in values.items() if key != SEAL)
    return digest_of(json.dumps([name, entries]).encode())


def sealed(name: str, values: Mapping[str, str]) -> dict[str, str]:
    """The entries of a metadata record, with their digest as the last one."""
    others = {key: value for key, value in values.items() if key != SEAL}
    return {**others, SEAL: _seal_of(name, others)}


def check_seal(name: str, values: Mapping[str, str]) -> bool:
    """Check the digest of a metadata record; return whether it has one.

    Raises:
        DamageError: If the digest is not that of the record.
    """
    if SEAL not in values:
        return False
    if values[SEAL] != _seal_of(name, values):
        raise DamageError("its digest is wrong")
    return True

"""`tell_when_forked`: objects are told that they are in a forked process.

A fork has one thread: whoever held a lock is not there to release it, and what was open is still in
use by the process it was forked from. What an object does about it, it knows itself.
"""

from __future__ import annotations

import os
import weakref
from typing import Protocol

__all__ = ["tell_when_forked"]


class _Told(Protocol):
    def forked(self) -> None: ...


_told: weakref.WeakSet[_Told] = weakref.WeakSet()


def tell_when_forked(who: _Told) -> None:
    """Have `who.forked()` called in every forked process, as long as it lives."""
    _told.add(who)


def _tell_all() -> None:
    for who in list(_told):
        who.forked()


os.register_at_fork(after_in_child=_tell_all)

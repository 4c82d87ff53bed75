"""`call_in_forks`: objects are told that they are in a forked process.

A fork has one thread: whoever held a lock is not there to release it, and what was open is still in
use by the process it was forked from. What an object does about it, it knows itself.
"""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable

__all__ = ["call_in_forks"]

_methods: set[weakref.WeakMethod[Callable[[], None]]] = set()


def call_in_forks(method: Callable[[], None]) -> None:
    """Have a bound method called in every forked process, as long as its object lives."""
    _methods.add(weakref.WeakMethod(method, _methods.discard))


def _call_all() -> None:
    for reference in list(_methods):
        if (method := reference()) is not None:
            method()


os.register_at_fork(after_in_child=_call_all)

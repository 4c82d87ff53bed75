"""A quick start: Python's cyclic garbage collector waits until the first step.

Imports and builds make a million objects and next to no garbage. Looking through them again and
again costs a fifth of the time to the first step, and once more whenever everything is looked
through later. Python's `gc` manual describes this use of `gc.freeze`.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

__all__ = ["started", "starting"]


@contextmanager
def starting() -> Iterator[None]:
    """Collect no cyclic garbage inside, until `started` is called."""
    gc.disable()
    try:
        yield
    finally:
        started()


def started() -> None:
    """Collect again; what was there before, modules above all, is not looked through any more."""
    if not gc.isenabled():
        _freeze()
        gc.enable()


@cache
def _freeze() -> None:
    """Once a process: later runs in it import nothing new, and leave garbage that counts."""
    gc.freeze()

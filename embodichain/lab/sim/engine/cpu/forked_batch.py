"""What remains of a batch with threads in a forked process: a sentence instead of a hang.

A fork copies the memory of a batch, not its threads. Waiting for them would take for ever, and
freeing the batch, which joins them, would abort the process.
"""

from __future__ import annotations

import ctypes
import os
import weakref
from typing import Any, Protocol

__all__ = ["guard_against_forks"]


class _Threaded(Protocol):
    """An engine whose batch has threads."""

    def lose_threads(self, instead: Any) -> None:
        """Use another object instead of the batch."""


_engines: weakref.WeakSet[_Threaded] = weakref.WeakSet()
"""The engines of this process whose batch has threads."""


class _ForkedBatch:
    """Stands in for a batch whose threads are in the parent process."""

    def __getattr__(self, name: str) -> Any:
        """Refuse everything that a batch has."""
        raise RuntimeError(
            "this process was forked from the one that made the environment, whose physics "
            "threads are not here: make the environment in this process, start it with "
            'multiprocessing.set_start_method("spawn"), or set sim.num_threads=1'
        )


def guard_against_forks(engine: _Threaded) -> None:
    """Have an engine raise RuntimeError where it would hang in a forked process.

    Args:
        engine: An engine whose batch has more than one thread.
    """
    _engines.add(engine)


def _after_fork() -> None:
    for engine in list(_engines):
        batch = vars(engine).get("_batch")
        if batch is None:  # closed
            continue
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(batch))  # never freed in this process
        engine.lose_threads(_ForkedBatch())
    _engines.clear()


if hasattr(os, "register_at_fork"):  # Windows has no fork
    os.register_at_fork(after_in_child=_after_fork)

"""Physics first: the simulation shows that it is at work, and the log's process waits meanwhile.

That process has a thread that Linux runs only where no core is wanted (`SCHED_IDLE`). But since
version 6.6 a thread that has had its share of a core gives way at the next tick to any that waits,
also to such a one, whose debts are forgotten when a core falls idle. Where physics takes every core
it loses up to 4 ms a call (seen in the kernel's trace of calls of 20 ms).
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from embodichain.recording.handover import Counters, Slab

__all__ = ["PhysicsSign", "StandingBack"]

LONG_SECONDS = 1e-3
"""Shorter calls are over before anybody else is given their core."""
NAP_SECONDS = 2e-4
PATIENCE_SECONDS = 0.1
"""Of a longer call no more is waited for: what is recorded shall be in the file within a second."""
_AT = Counters.SIZE // 2


class PhysicsSign:
    """The simulation's side.

    Args:
        page: Memory that both share, of `Counters.SIZE`.
        orders: Returns how many orders the other process was given.
    """

    def __init__(self, page: Slab, orders: Callable[[], int]) -> None:
        self._shown = np.ndarray(2, "<u8", page.memory, _AT)
        self._orders = orders
        self._calls = 0
        self._began = 0.0
        self._long = False

    def begins(self) -> None:
        """Physics begins, on every core."""
        self._began = time.perf_counter()
        if self._long:
            self._calls += 1
            self._shown[:] = self._calls, self._orders()

    def ends(self) -> None:
        """It has ended."""
        self._shown[0] = 0
        self._long = time.perf_counter() - self._began > LONG_SECONDS


class StandingBack:
    """The other process's side.

    Args:
        page: As for `PhysicsSign`.
    """

    def __init__(self, page: Slab) -> None:
        self._shown = np.ndarray(2, "<u8", page.memory, _AT)
        self._enough = 0  # the call that was waited for as long as any is

    def wait(self, order: int, wanted: Callable[[], bool]) -> None:
        """Wait until physics has ended, for a while.

        Args:
            order: The order in progress. Where more than one waits after it, there is too little
                time otherwise, and nothing is waited for.
            wanted: Whether to wait at all.
        """
        call, orders = self._shown.tolist()
        if not call or call == self._enough or orders > order + 1:
            return
        end = time.monotonic() + PATIENCE_SECONDS
        while self._shown[0] and wanted():
            time.sleep(NAP_SECONDS)
            if time.monotonic() > end:
                self._enough = int(self._shown[0])
                return

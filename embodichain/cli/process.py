"""The process of a job: when garbage is collected, and what signals do.

Imports and builds make a million objects and next to no garbage; looking through them again and
again costs a fifth of the time to the first step. Python's `gc` manual describes this use of
`gc.freeze`.

Ctrl-C, SIGTERM and SIGUSR2 (what batch systems send some time before they kill, as with
`sbatch --signal=USR2@120`) end a run after its current step, a film after its current picture, and
anything else at once; everything is closed on the way.
"""

from __future__ import annotations

import gc
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from types import FrameType, TracebackType
from typing import Any

from embodichain.cli.exits import Interrupted

__all__ = ["StopFlag", "signals_raise", "started", "starting"]

_SIGNALS = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGUSR2") if hasattr(signal, name)
]
_TWICE = "interrupted twice: left without closing everything"


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


@contextmanager
def signals_raise() -> Iterator[None]:
    """Within it a signal raises `Interrupted`: files that are being written are removed on the way.

    The same signals again are ignored meanwhile, but for Ctrl-C, which leaves at once. Where a
    `StopFlag` is up, that is what signals set.

    Python ignores what is raised in a finalizer or a callback of a weak reference, where a signal
    may arrive as anywhere else. The signal is then delivered again, shortly after.
    """
    came: list[str] = []
    report = sys.unraisablehook

    def handle(number: int, frame: FrameType | None) -> None:
        name = signal.Signals(number).name
        if not came:
            came.append(name)
            raise Interrupted(f"interrupted ({name})")
        if number == signal.SIGINT:
            raise KeyboardInterrupt(_TWICE)

    def deliver_again(ignored: sys.UnraisableHookArgs) -> None:
        if not isinstance(ignored.exc_value, Interrupted):
            report(ignored)
            return
        number = signal.Signals[came.pop()]
        main = threading.main_thread().ident
        threading.Timer(0.01, signal.pthread_kill, [main, number]).start()

    sys.unraisablehook = deliver_again
    try:
        with _handled_by(handle):
            yield
    finally:
        sys.unraisablehook = report


@contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Give our signals to a handler; outside the main thread nothing can, and nothing changes."""
    before: dict[signal.Signals, Any] = {}
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.signal(number, handler) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


class StopFlag:
    """Within a ``with`` block, the first signal sets `stopped`; a second Ctrl-C raises at once.

    Outside the main thread (a sweep's worker may be a thread) signals cannot be handled, and the
    flag stays down.

    Attributes:
        stopped: Name of the signal that came (``SIGINT``), or None.
    """

    def __init__(self) -> None:
        self.stopped: str | None = None
        self._handled = _handled_by(self._raise_flag)

    def is_stopped(self) -> bool:
        """Return whether a signal came."""
        return self.stopped is not None

    def __enter__(self) -> StopFlag:
        self._handled.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._handled.__exit__(None, None, None)

    def _raise_flag(self, number: int, frame: FrameType | None) -> None:
        if self.stopped is not None and number == signal.SIGINT:
            raise KeyboardInterrupt(_TWICE)
        self.stopped = signal.Signals(number).name

"""`Writing`: a lock for writes to a log from the stepping thread and from a timer.

A failed write ends the log: the first error is kept, and each later use raises it.
"""

from __future__ import annotations

import errno
import os
import signal
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

__all__ = ["LogWriteError", "Writing"]

TICK_SECONDS = 0.25
"""Interval of the timer, which also runs while the simulation does not step."""

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class LogWriteError(OSError):
    """The log could not be written; the text says why, and where it ends."""


class Writing:
    """A lock around a log's file, and the first error of writing it.

    Args:
        path: The log, for messages.
        where_it_ends: Returns a text that says where the log ends if nothing more is written.
        tick: A bound method, called every `TICK_SECONDS` on another thread under the lock until an
            error occurs or its owner is deleted; its owner is not kept alive.

    Attributes:
        lock: Held while the file, or the data waiting for it, is changed.
        told: Whether the error was raised to the program.
    """

    def __init__(
        self, path: Path, where_it_ends: Callable[[], str], tick: Callable[[], None]
    ) -> None:
        self.lock = threading.Lock()
        self.told = False
        self._path, self._where_it_ends = path, where_it_ends
        self._tick = weakref.WeakMethod(tick)
        self._cause: BaseException | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="log-timer", daemon=True)
        self._thread.start()
        _writings.add(self)

    @contextmanager
    def writes(self) -> Iterator[None]:
        """Context for code that writes: takes the lock and delays signal handlers.

        Raises:
            LogWriteError: If the log could not be written, now or before.
        """
        with _signals_held_back(), self.lock:
            self.check()
            try:
                yield
            except BaseException as error:
                self._cause = error
                if isinstance(error, OSError):
                    raise self._error() from error
                raise

    def check(self) -> None:
        """Raise if a write has failed.

        Raises:
            LogWriteError: If a write has failed.
        """
        if self._cause is not None:
            raise self._error() from self._cause

    def stop(self) -> None:
        """Stop the timer."""
        self._stop.set()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join()

    def forked(self) -> None:
        """In a forked process: stop writing; the log belongs to the parent process."""
        self.lock = threading.Lock()
        why = "the process this one was forked from writes it"
        self._cause = self._cause or ChildProcessError(errno.EPERM, why)
        self._stop.set()
        self._where_it_ends = str
        self.told = True

    def _error(self) -> LogWriteError:
        self.told = True
        cause, why = self._cause, str(self._cause)
        if isinstance(cause, OSError) and cause.strerror:
            named = cause.filename not in (None, Path(self._path).name)
            why = cause.strerror + (f": {cause.filename}" if named else "")
        end = self._where_it_ends()
        return LogWriteError(
            f"the log {self._path} could not be written: {why}{end and f'; {end}'}"
        )

    def _watch(self) -> None:
        while not self._stop.wait(TICK_SECONDS):
            tick = self._tick()
            if tick is None:
                return
            with self.lock:
                if self._cause is not None or self._stop.is_set():
                    return
                try:
                    tick()
                except BaseException as error:  # noqa: BLE001  (the next step raises it)
                    self._cause = error
            del tick


@contextmanager
def _signals_held_back() -> Iterator[None]:
    """Delay handlers of SIGINT and SIGTERM: an exception from one could leave half a chunk.

    Python runs handlers in the main thread, whichever thread receives the signal, so masking
    signals in this thread would not be enough.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[tuple[int, FrameType | None]] = []
    handlers: dict[int, Callable[[int, FrameType | None], object]] = {
        number: handler for number in _SIGNALS if callable(handler := signal.getsignal(number))
    }
    try:
        for number in handlers:
            signal.signal(number, lambda *args: came.append(args))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number, frame in came:
            handlers[number](number, frame)


_writings: weakref.WeakSet[Writing] = weakref.WeakSet()


def _after_fork() -> None:
    for writing in list(_writings):
        writing.forked()


if hasattr(os, "register_at_fork"):  # Windows has no fork
    os.register_at_fork(after_in_child=_after_fork)

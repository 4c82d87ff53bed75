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

__all__ = ["LogWriteError", "Writing", "delayed_signals"]

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
        error_was_raised: Whether the error was raised to the program.
    """

    def __init__(
        self, path: Path, where_it_ends: Callable[[], str], tick: Callable[[], None]
    ) -> None:
        self.lock = threading.Lock()
        self.error_was_raised = False
        self._path = path
        self._where_it_ends = where_it_ends
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
        with delayed_signals(), self.lock:
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
        if self._cause is None:
            reason = "the process this one was forked from writes it"
            self._cause = ChildProcessError(errno.EPERM, reason)
        self._stop.set()
        self._where_it_ends = str  # returns "": the parent process decides where it ends
        self.error_was_raised = True

    def _error(self) -> LogWriteError:
        self.error_was_raised = True
        text = f"the log {self._path} could not be written: {self._reason()}"
        end = self._where_it_ends()
        if end:
            text += f"; {end}"
        return LogWriteError(text)

    def _reason(self) -> str:
        """Why a write failed, with the file's name if it is not the first file of the log."""
        cause = self._cause
        if not isinstance(cause, OSError) or not cause.strerror:
            return str(cause)
        if cause.filename in (None, self._path.name):
            return cause.strerror
        return f"{cause.strerror}: {cause.filename}"

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
def delayed_signals() -> Iterator[None]:
    """Delay handlers of SIGINT and SIGTERM: an exception from one could leave half a chunk.

    Python runs handlers in the main thread, whichever thread receives the signal, so masking
    signals in this thread would not be enough.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[tuple[int, FrameType | None]] = []
    handlers: dict[int, Callable[[int, FrameType | None], object]] = {}
    for signal_number in _SIGNALS:
        handler = signal.getsignal(signal_number)
        if callable(handler):  # else the signal is ignored, or has its default action
            handlers[signal_number] = handler
    try:
        for number in handlers:
            signal.signal(number, lambda *args: received.append(args))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number, frame in received:
            handlers[number](number, frame)


_writings: weakref.WeakSet[Writing] = weakref.WeakSet()


def _after_fork() -> None:
    for writing in list(_writings):
        writing.forked()


if hasattr(os, "register_at_fork"):  # Windows has no fork
    os.register_at_fork(after_in_child=_after_fork)

"""`RenderThread`: the one thread of a process that draws.

An OpenGL context belongs to the thread that uses it, and drivers do not survive a fork.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from queue import SimpleQueue
from typing import Any, TypeVar

from embodichain.utils.errors import RenderError

__all__ = ["RenderThread", "render_thread"]

_log = logging.getLogger(__name__)
_T = TypeVar("_T")


class RenderThread:
    """Calls functions in one thread, in the order of the requests.

    It is a daemon: a process ends while it waits for work.
    """

    def __init__(self) -> None:
        self._pid = os.getpid()
        self._calls: SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="render", daemon=True)
        self._thread.start()

    @property
    def forked(self) -> bool:
        """Whether this process was forked from the one that has the thread."""
        return os.getpid() != self._pid

    def call(self, function: Callable[[], _T]) -> _T:
        """Call a function in the thread and wait for its result.

        A signal whose handler raises takes the call back if it has not begun. If it has, its end is
        awaited, since it reads arrays of the caller, and then the exception is raised.

        Raises:
            RenderError: If this process was forked from the one that draws.
            BaseException: What the function raises, with its traceback.
        """
        if self.forked:
            raise RenderError(
                "no picture can be made in a process that was forked from one that made pictures; "
                'start it with multiprocessing.set_start_method("spawn"), or fork before the first '
                "picture"
            )
        if threading.current_thread() is self._thread:
            return function()
        result: Future[_T] = Future()
        self._calls.put((function, result))
        try:
            return result.result()
        except BaseException:
            if not result.done() and not result.cancel():
                wait([result])
            raise

    def call_later(self, function: Callable[[], object]) -> None:
        """Call a function in the thread without waiting; does nothing in a forked process."""
        if not self.forked:
            result: Future[object] = Future()
            result.add_done_callback(_log_failure)
            self._calls.put((function, result))

    def _run(self) -> None:
        while True:
            function, result = self._calls.get()
            if result.set_running_or_notify_cancel():
                try:
                    value = function()
                except BaseException as error:  # noqa: BLE001  (the caller raises it)
                    result.set_exception(error)
                else:
                    result.set_result(value)
                    del value
            del function, result  # no arrays of a caller are kept while waiting


def _log_failure(result: Future[object]) -> None:
    error = result.exception()
    if error is not None:
        _log.warning("in the render thread: %s", error, exc_info=error)


_lock = threading.Lock()
_thread: RenderThread | None = None


def render_thread() -> RenderThread:
    """The thread of this process, which starts at first use; a forked process has its parent's."""
    global _thread
    with _lock:
        if _thread is None:
            _thread = RenderThread()
        return _thread

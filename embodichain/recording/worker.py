"""`Worker`: the process that writes logs, started beside the simulation and used again.

In a process of its own because Python runs one thread at a time: what packs and compresses would
hold up the simulation exactly when it runs Python, and run when physics has every core. Started
anew rather than forked: a copy of a process with threads may hang.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import socket
import subprocess
import sys
import threading

__all__ = ["Worker", "acquire", "release", "warm_up"]

_START = """\
import signal, sys
for number in {ignored}:
    signal.signal(number, signal.SIG_IGN)
import json
sys.path[:] = json.loads(sys.argv[2])
from embodichain.recording.write_process import main
main(int(sys.argv[1]))
"""
_IGNORED = ("SIGINT", "SIGTERM", "SIGHUP", "SIGUSR1", "SIGUSR2")
"""Batch systems send them to every process; this one ends when the simulation's has ended."""
_END_SECONDS = 10.0

_lock = threading.Lock()
_idle: list[Worker] = []
_all: set[Worker] = set()


class Worker:
    """A process that waits for orders.

    Attributes:
        connection: Orders go in, replies come out.
        orders: How many orders were sent.
        slabs: How many slabs it was given.

    Raises:
        OSError: If no process can be started.
        RuntimeError: If this Python does not know its own program.
    """

    def __init__(self) -> None:
        if not sys.executable:
            raise RuntimeError("a log is written by another Python, and sys.executable is empty")
        self.connection, theirs = socket.socketpair()
        self.orders = self.slabs = 0
        ignored = [int(getattr(signal, name)) for name in _IGNORED if hasattr(signal, name)]
        path = [os.path.abspath(entry) for entry in sys.path]
        number = str(theirs.fileno())
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _START.format(ignored=ignored), number, json.dumps(path)],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,  # what goes wrong is told on stderr
                start_new_session=True,  # Ctrl-C is the simulation's
                cwd="/",  # nobody's folder is kept busy
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            )
        except BaseException:
            self.connection.close()
            raise
        finally:
            theirs.close()
        _all.add(self)

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def how_it_ended(self) -> str:
        """``signal 9`` or ``status 1``; waits for the end."""
        try:
            code = self._process.wait(_END_SECONDS)
        except subprocess.TimeoutExpired:
            return "no answer"
        return f"signal {-code}" if code < 0 else f"status {code}"

    def close(self) -> None:
        """Let the process end: it does when nobody gives orders any more."""
        self.connection.close()
        _all.discard(self)
        try:
            self._process.wait(_END_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def acquire() -> Worker:
    """A worker that has nothing to do, started if there is none."""
    with _lock:
        while _idle:
            worker = _idle.pop()
            if worker.alive:
                return worker
            worker.close()
    return Worker()


def release(worker: Worker) -> None:
    """Give a worker back whose log is closed. One is kept for the next log."""
    with _lock:
        if not _idle:
            _idle.append(worker)
            return
    worker.close()


def warm_up() -> None:
    """Start a worker for a log that will be opened soon, unless one waits already."""
    with _lock:
        if not _idle:
            _idle.append(Worker())


def _end() -> None:
    for worker in list(_all):
        worker.close()


def _forget() -> None:
    """In a forked process: the workers are the other's, and must see it end."""
    for worker in _all:
        worker.connection.close()
    _all.clear()
    _idle.clear()


atexit.register(_end)
os.register_at_fork(after_in_child=_forget)

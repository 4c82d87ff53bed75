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
from contextlib import suppress

__all__ = ["Worker", "acquire", "release", "warm_up"]

_START = """\
import signal, sys
for number in {ignored}:
    signal.signal(number, signal.SIG_IGN)
import json
sys.path[:] = json.loads(sys.argv[2])
from embodichain.recording.write_process import main
main(int(sys.argv[1]), int(sys.argv[3]))
"""
_IGNORED = ("SIGINT", "SIGTERM", "SIGHUP", "SIGUSR1", "SIGUSR2")
"""Batch systems send them to every process; this one ends when the simulation's has ended."""
_ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",
    "MUJOCO_GL": "disabled",  # nothing is drawn: a quarter of the time that imports take
    # Chunks and rows are made and dropped all the time: glibc would give their memory back, and the
    # kernel would clear it anew, which was a sixth of the time at 1,024 environments.
    "MALLOC_MMAP_THRESHOLD_": str(2**25),
    "MALLOC_TRIM_THRESHOLD_": str(2**27),
}
_END_SECONDS = 10.0

_lock = threading.Lock()
_idle: list[Worker] = []
_all: set[Worker] = set()


class Worker:
    """A process that waits for orders.

    Attributes:
        connection: Orders go in, replies come out.
        orders: How many orders were sent.

    Raises:
        OSError: If no process can be started.
        RuntimeError: If this Python does not know its own program.
    """

    def __init__(self) -> None:
        if not sys.executable:
            raise RuntimeError("a log is written by another Python, and sys.executable is empty")
        self.connection, theirs = socket.socketpair()
        hurry, self._hurry = os.pipe()
        os.set_blocking(self._hurry, False)
        self.orders = self._slabs = 0
        ignored = [int(getattr(signal, name)) for name in _IGNORED if hasattr(signal, name)]
        path = [os.path.abspath(entry) for entry in sys.path]
        ends = theirs.fileno(), hurry
        words = str(ends[0]), json.dumps(path), str(ends[1])
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _START.format(ignored=ignored), *words],
                pass_fds=ends,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,  # what goes wrong is told on stderr
                # Ctrl-C is the simulation's. No session of its own: that would have a share of the
                # processor of its own, however far its threads stand back.
                process_group=0,
                cwd="/",  # nobody's folder is kept busy
                env={**os.environ, **_ENVIRONMENT},
            )
        except BaseException:
            self._let_go()
            raise
        finally:
            theirs.close()
            os.close(hurry)
        _all.add(self)

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def new_slab(self) -> int:
        """A number that no slab it was given has."""
        self._slabs += 1
        return self._slabs

    def hurry(self) -> None:
        """Say that somebody waits for the process."""
        with suppress(BlockingIOError, BrokenPipeError):  # it was told, or is told otherwise
            os.write(self._hurry, b"!")

    def _let_go(self) -> None:
        """Close what connects both processes; a second time does nothing."""
        self.connection.close()
        if self._hurry >= 0:
            os.close(self._hurry)
            self._hurry = -1

    def how_it_ended(self) -> str:
        """``signal 9`` or ``status 1``; waits for the end."""
        try:
            code = self._process.wait(_END_SECONDS)
        except subprocess.TimeoutExpired:
            return "no answer"
        return f"signal {-code}" if code < 0 else f"status {code}"

    def close(self) -> None:
        """Let the process end: it does when nobody gives orders any more."""
        self._let_go()
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
    global _lock
    _lock = threading.Lock()  # who held it is not here
    for worker in _all:
        worker._let_go()
    _all.clear()
    _idle.clear()


atexit.register(_end)
os.register_at_fork(after_in_child=_forget)

"""`LogWriter`: the simulation's side of the process that writes a log.

It copies arguments of calls into shared memory and hands them over in batches; the calls are
carried out by the other process, in order (`log_builder`). When that does not keep up, it waits:
nothing is dropped. What the calls mean is not known here.
"""

from __future__ import annotations

import atexit
import errno
import marshal
import os
import pickle
import select
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from embodichain.recording import handover, worker
from embodichain.recording.handover import Counters, Order, ReplyReader, Slab
from embodichain.recording.placing import placed, put
from embodichain.recording.write_error import LogWriteError, cause_of, write_error

__all__ = ["LogWriteError", "LogWriter"]

BATCH_SECONDS = 0.05
"""Calls wait no longer than this for the next one before they are handed over with it."""
IDLE_SECONDS = 0.2
"""And no longer than this if none comes: with the flushing of the file that stays below 1 s."""
HURRY_SECONDS = 0.05
"""After waiting so long for the other process, it is told not to stand back."""
SLAB_BYTES = 3 * 2**19
BUDGET_BYTES = 64 * 2**20
"""About how much may wait for the disk before the simulation waits too."""
_CONTENT_BYTES = 2**16
"""Kept free in a slab for what is no array."""
_BATCH_CALLS = 512
"""Calls in a batch; more would not fit there."""
_CALL_BYTES = 256
"""About what a call takes besides rows."""


class LogWriter:
    """A log that another process writes.

    Args:
        path: A new file; an existing one is never overwritten.
        compression: As in `RecordOptions`.
        make_head: Makes what the log begins with (a `LogHead`), on a thread of its own. Calls wait
            for it in the other process, the simulation does not.
        step_bytes: How large a slab is at least.

    Raises:
        FileExistsError: If `path` exists.
        OSError: If the file or the process cannot be made.
    """

    def __init__(
        self, path: Path, compression: str, make_head: Callable[[], object], step_bytes: int = 0
    ) -> None:
        self.path = path
        self._slab_bytes = _pages(max(SLAB_BYTES, step_bytes + _CONTENT_BYTES))
        self._budget = max(BUDGET_BYTES, 4 * self._slab_bytes)
        self._filled = self._slab_bytes - self._slab_bytes // 4  # rows leave room for the rest
        self._made_bytes = 0
        self._away = 0  # bytes in slabs that the other process has
        self._progress = 0.0  # when one came back
        self._slabs: dict[int, Slab] = {}
        self._free: list[Slab] = []
        self._slab: Slab | None = None
        self._pending: list[handover.Call] = []
        self._unsent: Order | None = None
        self._flushed = False
        self._ended = False
        self._closed = self._told = False
        self._error: BaseException | None = None
        self._where = ""
        self._pid = os.getpid()
        self._lock = threading.Lock()  # whoever holds it may hand over
        self._handed_over = time.monotonic()
        self._stop = threading.Event()
        self._head = threading.Thread(target=self._send_head, args=(make_head,), name="log-head")
        self._open(path, compression)
        self._head.start()
        self._thread = threading.Thread(target=self._watch, name="log-handover", daemon=True)
        self._thread.start()
        # A program that ends without closing leaves a file with its end all the same.
        atexit.register(self.close)

    def _open(self, path: Path, compression: str) -> None:
        # A descriptor: whoever renames the folder meanwhile does not send later files elsewhere.
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
            file = os.open(path, flags, 0o666)
            try:
                self._worker = worker.acquire()
                self._replies = ReplyReader(self._worker.connection)
                page = Slab(0, Counters.SIZE)
                self.counters = Counters(page)
                content = pickle.dumps((path.name, compression), 5)
                slab = self._take(len(content))
                at = put(slab, content)
                order = self._order(handover.OPEN, slab, slab, at, len(content))
                self._send(order, (file, folder, page.descriptor))
                self._away += slab.at
                page.forget_descriptor()
            finally:
                os.close(file)
        finally:
            os.close(folder)

    # -- calls -------------------------------------------------------------------------------------

    def call(self, method: str, *args: object) -> None:
        """Have the other process call a method, after all calls before.

        Arguments are copied later: nobody may write into them any more.

        Raises:
            OSError: If the log could not be written; it ends there.
        """
        with self._lock:
            if self._error is not None:
                raise self._told_error()
            self._pending.append((method, args, ()))

    def call_with(
        self,
        method: str,
        shape: tuple[int, int],
        fill: Callable[[NDArray[np.float64]], object],
        *args: object,
    ) -> None:
        """The same with a first argument that `fill` writes at once, where it is handed over from.

        Raises:
            OSError: If the log could not be written.
        """
        with self._lock:
            if self._error is not None:
                raise self._told_error()
            nbytes = 8 * shape[0] * shape[1]
            slab = self._slab
            if slab is None or slab.at + nbytes > self._filled:
                self._hand_over()
                slab = self._slab = self._take(nbytes + _CONTENT_BYTES)
            at = slab.at
            fill(np.ndarray(shape, np.float64, slab.memory, at))
            slab.at = at + nbytes
            self._pending.append((method, (None, *args), (0, at, "d", shape)))

    def hand_over_when_due(self) -> None:
        """Hand over if calls have waited long enough; called after every step."""
        late = time.monotonic() - self._handed_over > BATCH_SECONDS
        if late or len(self._pending) > _BATCH_CALLS:
            with self._lock:
                self._hand_over()

    @property
    def ahead(self) -> int:
        """About how many bytes the counters do not know of yet."""
        here = 0 if self._slab is None else self._slab.at
        return self._away + here + _CALL_BYTES * len(self._pending)

    def catch_up(self) -> None:
        """Wait until the counters know of everything.

        Raises:
            OSError: If the file could not be written.
        """
        with self._lock:
            self._hand_over()
            while self._away:
                self._receive(wait=True)

    def flush(self) -> None:
        """Wait until everything handed over so far is in the file, readable there.

        Raises:
            OSError: If the file could not be written.
        """
        self._head.join()
        with self._lock:
            self._hand_over()
            self._flushed = False
            self._send(self._order(handover.FLUSH))
            while not self._flushed:
                self._receive(wait=True)

    def close(self) -> None:
        """Write what waits, the index and the end of the file. A second call does nothing.

        Raises:
            OSError: If the file could not be written.
        """
        if self._closed or os.getpid() != self._pid:  # a forked process: the log is the other's
            return
        self._closed = True
        atexit.unregister(self.close)
        self._stop.set()
        self._head.join()
        try:
            with self._lock:
                self._hand_over()
                self._send(self._order(handover.CLOSE))
                while not self._ended:
                    self._receive(wait=True)
        except BaseException:
            self._worker.close()
            raise
        finally:
            self._pending, self._slab, self._free = [], None, []
            self._slabs.clear()
        worker.release(self._worker)

    @property
    def lost(self) -> bool:
        """Whether the file could not be written, and somebody was told."""
        return self._told

    @property
    def worker_pid(self) -> int:
        """The process that writes."""
        return self._worker.pid

    # -- handing over; the lock is held ------------------------------------------------------------

    def _take(self, nbytes: int) -> Slab:
        """A slab that nobody uses; waits while too many are on their way."""
        size = self._slab_bytes if nbytes <= self._slab_bytes else _pages(nbytes)
        self._receive()
        while True:
            if size == self._slab_bytes and self._free:
                slab = self._free.pop()
                slab.at = 0
                return slab
            used = len(self._slabs) - len(self._free) - (self._slab is not None)
            if self._made_bytes + size <= self._budget or not used:
                return self._make(size)
            self._receive(wait=True)

    def _make(self, size: int) -> Slab:
        """A new slab, which the other process is told of."""
        self._worker.slabs += 1
        slab = Slab(self._worker.slabs, size)
        self._made_bytes += size
        self._slabs[slab.number] = slab
        order = self._order(handover.SLAB, slab, slab, 0, size)
        self._send(order, (slab.descriptor,))
        slab.forget_descriptor()
        return slab

    def _hand_over(self) -> None:
        if self._error is not None:
            raise self._told_error()
        self._handed_over = time.monotonic()
        if self._unsent is not None:  # an interrupt came while it was sent: twice does no harm
            self._send(self._unsent)
            self._unsent = None
        if not self._pending:
            return
        slab = self._slab
        if slab is None:
            slab = self._slab = self._take(0)
        limit = slab.size - _CONTENT_BYTES
        content = marshal.dumps([placed(slab, limit, *call) for call in self._pending])
        fits = slab.at + len(content) <= slab.size
        target = slab if fits else self._take(len(content))
        at = put(target, content)
        order = self._order(handover.BATCH, slab, target, at, len(content))
        # Nothing can interrupt between these: they call nothing.
        self._unsent, self._pending, self._slab = order, [], None
        if not self._away:
            self._progress = self._handed_over
        self._away += slab.at + (target.at if target is not slab else 0)
        self._send(order)
        self._unsent = None

    def _order(
        self,
        kind: int,
        slab: Slab | None = None,
        content: Slab | None = None,
        at: int = 0,
        length: int = 0,
    ) -> Order:
        self._worker.orders += 1
        arrays, packed = (0 if s is None else s.number for s in (slab, content))
        return Order(kind, self._worker.orders, arrays, packed, at, length)

    def _send(self, order: Order, descriptors: tuple[int, ...] = ()) -> None:
        try:
            handover.send_order(self._worker.connection, order, descriptors)
        except (BrokenPipeError, ConnectionResetError):
            while True:  # until it has said why
                self._receive(wait=True)

    def _receive(self, wait: bool = False) -> None:
        """Take replies in."""
        head_waits = self._head.is_alive() and threading.current_thread() is not self._head
        if wait and head_waits:  # for the lock, and what is on its way waits for the head
            self._lock.release()
            try:
                self._head.join()
            finally:
                self._lock.acquire()
        connection = self._worker.connection
        patience = HURRY_SECONDS if wait else 0.0
        while not select.select([connection], [], [], patience)[0]:
            if not wait:
                return
            self._worker.hurry()
            patience = 1.0
        replies = self._replies.read()
        if replies is None:
            self._fail(None)
        for kind, number, report in replies or ():
            if kind == handover.FREED:
                self._take_back(number)
            elif kind == handover.FLUSHED:
                self._flushed = True
            elif kind == handover.CLOSED:
                self._ended = True
            else:
                self._fail(report)

    def _take_back(self, number: int) -> None:
        slab = self._slabs[number]
        self._away -= slab.at
        self._progress = time.monotonic()
        if slab.size == self._slab_bytes:
            self._free.append(slab)
        else:
            del self._slabs[number]
            self._made_bytes -= slab.size

    def _fail(self, report: bytes | None) -> None:
        """The other process could not write, or has ended without a word."""
        if report is None:
            how = self._worker.how_it_ended()
            why = f"the process that writes it has ended ({how})"
            self._error = ChildProcessError(errno.EPIPE, why)
        else:
            self._error, self._where = cause_of(report)
        raise self._told_error()

    def _told_error(self) -> LogWriteError:
        self._told = True
        return write_error(self.path, self._error, self._where)

    # -- other threads -----------------------------------------------------------------------------

    def _send_head(self, make: Callable[[], object]) -> None:
        """Make what the log begins with, and send it."""
        try:
            content = pickle.dumps(make(), 5)
            with self._lock:
                slab = self._make(_pages(len(content)))
                put(slab, content)
                self._send(self._order(handover.HEAD, slab, slab, 0, len(content)))
                self._away += slab.at
        except BaseException as error:  # noqa: BLE001  (the next call raises it)
            self._error, self._told = self._error or error, False

    def _watch(self) -> None:
        """Hand over what nobody adds to: a killed process must not lose it.

        Never waits for the simulation, which hands over itself when it is at it.
        """
        while not self._stop.wait(IDLE_SECONDS):
            if self._head.is_alive() or not self._lock.acquire(blocking=False):
                continue
            try:
                if self._error is None:
                    self._look_after(time.monotonic())
            except OSError as error:
                self._error, self._told = self._error or error, False
                return  # the next call says it
            finally:
                self._lock.release()

    def _look_after(self, now: float) -> None:
        """Hand over what waits, and do not let the other process stand back for long."""
        if now - self._handed_over >= IDLE_SECONDS:
            self._hand_over()
        self._receive()
        if self._away and now - self._progress >= IDLE_SECONDS:
            self._worker.hurry()


def _pages(nbytes: int) -> int:
    return -(-nbytes // 4096) * 4096

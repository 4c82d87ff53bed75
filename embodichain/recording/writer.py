"""`LogWriter`: the simulation's side of the process that writes a log.

It copies arguments of calls into shared memory and hands them over in batches; the calls are
carried out by the other process, in order (`log_builder`). When that does not keep up, it waits:
nothing is dropped. What the calls mean is not known here.
"""

from __future__ import annotations

import atexit
import os
import pickle
import select
import threading
import time
from collections.abc import Callable, Hashable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording import handover, worker
from embodichain.recording.forked import tell_when_forked
from embodichain.recording.handover import Counters, Order, ReplyReader, Slab
from embodichain.recording.placing import WaitingCalls, put
from embodichain.recording.slab_pool import SlabPool, slab_bytes_for
from embodichain.recording.write_error import LogWriteError, Loss

__all__ = ["LogWriteError", "LogWriter"]

BATCH_SECONDS = 0.1
"""Calls wait no longer than this for the next one before they are handed over with it."""
IDLE_SECONDS = 0.2
"""And no longer than this if none comes: with the flushing of the file that stays below 1 s."""
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
        step_bytes: About how much a step takes, at most.

    Raises:
        FileExistsError: If `path` exists.
        OSError: If the file or the process cannot be made.
    """

    def __init__(
        self, path: Path, compression: str, make_head: Callable[[], object], step_bytes: int = 0
    ) -> None:
        self.path = path
        slab_bytes = slab_bytes_for(step_bytes + _CONTENT_BYTES)
        self._slabs = SlabPool(slab_bytes, BUDGET_BYTES, lambda: self._worker.new_slab())
        self._filled = slab_bytes - slab_bytes // 4  # rows leave room for the rest
        self._progress = 0.0  # when a slab came back
        self._slab: Slab | None = None
        self._calls = WaitingCalls()
        self._unsent: Order | None = None
        self._flushed = self._ended = self._closed = False
        self._loss = Loss(path)
        self._lock = threading.Lock()  # whoever holds it may hand over
        self._handed_over = time.monotonic()
        self._stop = threading.Event()
        self._head = threading.Thread(target=self._send_head, args=(make_head,), name="log-head")
        self._open(path, compression)
        self._head.start()
        self._thread = threading.Thread(target=self._watch, name="log-handover", daemon=True)
        self._thread.start()
        atexit.register(self.close)  # a file has its end where nobody closes it
        tell_when_forked(self)

    def _open(self, path: Path, compression: str) -> None:
        with ExitStack() as opened:
            # A descriptor: whoever renames the folder does not send later files elsewhere.
            folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
            opened.callback(os.close, folder)
            file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
            opened.callback(os.close, file)
            self._worker = worker.acquire()
            self._replies = ReplyReader(self._worker.connection)
            page = Slab(0, Counters.SIZE)
            self.counters = Counters(page)
            content = pickle.dumps((path.name, compression), 5)
            slab = self._take(len(content))
            order = self._order(handover.OPEN, slab, slab, put(slab, content), len(content))
            self._send(order, (file, folder, page.descriptor))
            self._slabs.away += slab.at
            page.forget_descriptor()

    # -- calls -------------------------------------------------------------------------------------

    def call(self, method: str, *args: object) -> None:
        """Have the other process call a method, after all calls before.

        Arguments are copied later: nobody may write into them any more.

        Raises:
            OSError: If the log could not be written; it ends there.
        """
        with self._lock:
            self._loss.check()
            self._calls.add(method, args)

    def call_alike(self, method: str, args: tuple[Hashable, ...], *arrays: NDArray[Any]) -> None:
        """The same for calls of which many are alike; arrays are copied at once.

        Args:
            method: The method.
            args: Its first arguments, of which there are few: numbers, texts, None, tuples of them.
            arrays: Those that follow. With the same `args` they should have the same types and
                shapes; should they not, nothing is wrong, only slower.

        Raises:
            OSError: If the log could not be written.
        """
        with self._lock:
            if self._loss.cause is not None:
                raise self._loss.error()
            form, slab = self._calls.form((method, args), arrays), self._slab
            if slab is None or slab.at + form.nbytes > self._filled:
                slab = self._next_slab(form.nbytes)
            at = slab.at
            if form.fill(slab, arrays):
                self._calls.waiting.append((form.number, at))
            else:
                self._calls.add(method, (*args, *map(np.array, arrays)))

    def call_with(
        self,
        method: str,
        args: tuple[object, ...],
        shape: tuple[int, int],
        fill: Callable[[NDArray[np.float64]], object],
        alike: bool = False,
    ) -> None:
        """The same with a last argument that `fill` writes at once, where it is handed over from.

        `alike` says that many calls have these first arguments, which are hashable then.

        Raises:
            OSError: If the log could not be written.
        """
        nbytes = 8 * shape[0] * shape[1]
        with self._lock:
            if self._loss.cause is not None:
                raise self._loss.error()
            slab = self._slab
            if slab is None or slab.at + nbytes > self._filled:
                slab = self._next_slab(nbytes)
            array = np.ndarray(shape, np.float64, slab.memory, at := slab.at)
            fill(array)
            slab.at = at + nbytes
            if alike:
                form = self._calls.form((method, args, shape), (array,))
                self._calls.waiting.append((form.number, at))
            else:
                self._calls.add(method, (*args, None), (len(args), at, "d", shape))

    def hand_over_when_due(self) -> None:
        """Hand over if calls have waited long enough; called after every step."""
        late = time.monotonic() - self._handed_over > BATCH_SECONDS
        if late or len(self._calls.waiting) > _BATCH_CALLS:
            with self._lock:
                self._hand_over()

    @property
    def ahead(self) -> int:
        """About how many bytes the counters do not know of yet."""
        here = 0 if self._slab is None else self._slab.at
        return self._slabs.away + here + _CALL_BYTES * len(self._calls.waiting)

    def catch_up(self) -> None:
        """Wait until the counters know of everything.

        Raises:
            OSError: If the file could not be written.
        """
        with self._lock:
            self._hand_over()
            while self._slabs.away:
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
            OSError: If the file could not be written, and no call said so before.
        """
        if self._closed:
            return
        self._closed, told = True, self._loss.told
        atexit.unregister(self.close)
        self._stop.set()
        self._head.join()
        try:
            with self._lock:
                self._hand_over()
                self._send(self._order(handover.CLOSE))
                while not self._ended:
                    self._receive(wait=True)
        except BaseException as error:
            self._worker.close()
            if told and isinstance(error, LogWriteError):  # once is enough
                return
            raise
        finally:
            self._calls, self._slab = WaitingCalls(), None
            self._slabs.clear()
        worker.release(self._worker)

    @property
    def lost(self) -> bool:
        """Whether the file could not be written, and somebody was told."""
        return self._loss.told

    @property
    def worker_pid(self) -> int:
        """The process that writes."""
        return self._worker.pid

    def forked(self) -> None:
        """This process was forked: the log is the other's."""
        self._lock, self._closed = threading.Lock(), True
        self._loss.forked()

    # -- handing over; the lock is held ------------------------------------------------------------

    def _take(self, nbytes: int) -> Slab:
        """A slab that nobody uses; waits while too many are on their way."""
        if not self._slabs.any_free:
            self._receive()
        while (slab := self._slabs.take(nbytes, self._slab is not None)) is None:
            self._receive(wait=True)
        self._tell(slab)
        return slab

    def _next_slab(self, nbytes: int) -> Slab:
        """Another slab to fill, which has so much room: the one in use has not."""
        self._hand_over()
        if self._slab is not None:  # nothing waited
            self._slabs.put_back(self._slab)
        slab = self._slab = self._take(nbytes + _CONTENT_BYTES)
        return slab

    def _tell(self, slab: Slab) -> None:
        """Tell the other process of a slab, if it is new."""
        if slab.descriptor >= 0:
            order = self._order(handover.SLAB, slab, slab, 0, slab.size)
            self._send(order, (slab.descriptor,))
            slab.forget_descriptor()

    def _hand_over(self) -> None:
        self._loss.check()
        self._handed_over = time.monotonic()
        if self._unsent is not None:  # an interrupt came while it was sent: twice does no harm
            self._send(self._unsent)
            self._unsent = None
        if not self._calls.waiting:
            return
        slab = self._slab
        if slab is None:
            slab = self._slab = self._take(0)
        limit = slab.size - _CONTENT_BYTES
        content = self._calls.packed(slab, limit)
        fits = slab.at + len(content) <= slab.size
        target = slab if fits else self._take(len(content))
        at = put(target, content)
        order = self._order(handover.BATCH, slab, target, at, len(content))
        # Nothing can interrupt between these: they call nothing.
        self._unsent, self._calls.waiting, self._calls.new_forms, self._slab = order, [], [], None
        if not self._slabs.away:
            self._progress = self._handed_over
        self._slabs.away += slab.at + (target.at if target is not slab else 0)
        self._send(order)
        self._unsent = None

    def _order(
        self, kind: int, slab: Slab | None = None, content: Slab | None = None, *span: int
    ) -> Order:
        self._worker.orders += 1
        arrays, packed = (0 if s is None else s.number for s in (slab, content))
        return Order(kind, self._worker.orders, arrays, packed, *span)

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
        patience = 0.0
        while not select.select([connection], [], [], patience)[0]:
            if not wait:
                return
            # Or it stands back: at 1,024 environments waits came to 5 % of the time.
            self._worker.hurry()
            patience = 1.0
        replies = self._replies.read()
        if replies is None:
            self._fail(None)
        for kind, number, report in replies or ():
            if kind == handover.FREED:
                self._slabs.take_back(number)
                self._progress = time.monotonic()
            elif kind == handover.FLUSHED:
                self._flushed = True
            elif kind == handover.CLOSED:
                self._ended = True
            else:
                self._fail(report)

    def _fail(self, report: bytes | None) -> None:
        """The other process could not write, or has ended without a word."""
        if report is None:
            self._loss.unexplained(self._worker.how_it_ended())
        else:
            self._loss.reported(report)
        raise self._loss.error()

    # -- other threads -----------------------------------------------------------------------------

    def _send_head(self, make: Callable[[], object]) -> None:
        """Make what the log begins with, and send it."""
        told: bool | None = None
        try:
            content = pickle.dumps(make(), 5)
            with self._lock:
                told = self._loss.told
                slab = self._slabs.make(len(content))
                self._tell(slab)
                put(slab, content)
                self._send(self._order(handover.HEAD, slab, slab, 0, len(content)))
                self._slabs.away += slab.at
        except BaseException as error:  # noqa: BLE001  (the next call raises it)
            self._loss.found(error)
            if told is not None:  # what was raised here told nobody
                self._loss.told = told

    def _watch(self) -> None:
        """Hand over what nobody adds to; never waits for the simulation, which does it itself."""
        while not self._stop.wait(IDLE_SECONDS):
            if self._head.is_alive() or not self._lock.acquire(blocking=False):
                continue
            try:
                if self._loss.cause is None:
                    self._look_after(time.monotonic())
            except OSError as error:
                self._loss.found(error)
                self._loss.told = False
                return  # the next call says it
            finally:
                self._lock.release()

    def _look_after(self, now: float) -> None:
        """Hand over what waits, and do not let the other process stand back for long."""
        if now - self._handed_over >= IDLE_SECONDS:
            self._hand_over()
        self._receive()
        if self._slabs.away and now - self._progress >= IDLE_SECONDS:
            self._worker.hurry()

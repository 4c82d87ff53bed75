"""The process that writes logs: takes orders (`handover`) until the simulation's process ends.

What it is told to write means nothing here; `LogBuilder` knows.
"""

from __future__ import annotations

import json
import os
import select
import socket
import threading
import time
import traceback
from contextlib import suppress
from io import FileIO

from embodichain.recording import handover
from embodichain.recording.batches import unpickled
from embodichain.recording.handover import Counters, Order, Reply, Slab
from embodichain.recording.log_builder import LogBuilder
from embodichain.recording.log_file import LogFile

__all__ = ["main"]

FLUSH_SECONDS = 0.5
"""Together with what is not handed over yet, at most a second is lost if all is killed."""


def main(orders: int, hurry: int) -> None:
    """Write one log after another.

    A thread that runs only where no core is wanted otherwise does it, until the simulation has to
    wait: on a machine where others want every core it would never come to anything.

    Args:
        orders: Descriptor of the socket that orders come from.
        hurry: Descriptor that something can be read from when the simulation waits.
    """
    with socket.socket(fileno=orders) as connection, open(hurry, "rb", buffering=0) as calls:
        writing = _Writing(connection)
        while not writing.over:
            quiet = threading.Thread(target=_write_quietly, args=(writing,), name="log-writer")
            quiet.start()
            waits = calls.read(1)
            writing.pause = True
            quiet.join()
            writing.pause = False
            if waits:
                _write_at_once(writing, calls)
            while not waits and not writing.over:  # the simulation's process has ended
                writing.carry_on()


def _write_quietly(writing: _Writing) -> None:
    """Carry out orders where no core is wanted by anybody else.

    Since version 6.6 Linux gives even such a thread a core for up to 4 ms, from the tick at which
    whoever runs there has had its share. So it offers the core all the time: that took a tenth off
    what a log costs 1,024 environments with one physics step, and a quarter with ten.
    """
    if hasattr(os, "SCHED_IDLE"):
        # Some containers forbid it; then it is a thread like any other.
        with suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
            writing.gives_way = True
    while not writing.pause and not writing.over:
        writing.carry_on()
    writing.gives_way = False


def _write_at_once(writing: _Writing, calls: FileIO) -> None:
    """Carry out all orders that wait, whoever wants the cores, and flush."""
    if select.select([calls], [], [], 0)[0]:
        calls.read(4096)  # said about orders that are there
    while not writing.over and writing.ready(0.0):
        writing.carry_on()
    writing.flush()


class _Writing:
    """The log in progress, if any, and the memory it comes from."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._slabs: dict[int, Slab] = {}
        self._file: LogFile | None = None
        self._builder: LogBuilder | None = None
        self._waiting: list[Order] = []
        self._last = 0
        self._begun = self._due = 0.0
        self._dirty = False
        self.gives_way = False
        """Whether others go before."""
        self.pause = False
        """Whether somebody else shall carry on."""
        self.over = False
        """Whether nothing follows."""

    def carry_on(self) -> None:
        """Wait for an order and carry it out."""
        try:
            if not self._wait():
                return
            received = handover.receive_order(self._connection)
            if received is None:
                self.over = True
                self._abandon()
            else:
                self._carry_out(*received)
        except Exception as error:  # noqa: BLE001  (whoever gave the order is told)
            self.over = True
            self._fail(error)

    def flush(self) -> None:
        """Flush now rather than when it is due."""
        try:
            if self._dirty and not self.over:
                self._flush()
        except Exception as error:  # noqa: BLE001  (whoever gives the next order is told)
            self.over = True
            self._fail(error)

    def _wait(self) -> bool:
        """Wait for an order, and flush when it is due; False if somebody else shall carry on."""
        while not self.ready(max(0.0, self._due - time.monotonic()) if self._dirty else None):
            self._flush()
        return not self.pause

    def ready(self, patience: float | None) -> bool:
        """Wait for an order; whether there is one after so many seconds (None: however long)."""
        return bool(select.select([self._connection], [], [], patience)[0])

    def _carry_out(self, order: Order, descriptors: list[int]) -> None:
        """Do what an order says."""
        if order.number <= self._last:  # sent twice
            return
        self._last = order.number
        if order.kind == handover.SLAB:
            slab = Slab(order.slab, order.length, *descriptors)
            slab.forget_descriptor()
            self._slabs[order.slab] = slab
        elif order.kind == handover.OPEN:
            self._open(order, *descriptors)
        elif order.kind == handover.HEAD:
            self._begin(order)
        elif order.kind == handover.BATCH:
            if self._builder is None:  # calls wait for the head
                self._waiting.append(order)
            else:
                self._batch(self._builder, order)
        elif order.kind == handover.FLUSH:
            self._flush()
            self._reply(handover.FLUSHED)
        elif order.kind == handover.CLOSE:
            self._close()

    def _open(self, order: Order, file: int, folder: int, page: int) -> None:
        name, compression = unpickled(self._content(order))
        slab = Slab(0, Counters.SIZE, page)
        slab.forget_descriptor()
        self._file = LogFile(file, folder, name, compression, Counters(slab))
        self._free(order)
        self._flush()

    def _begin(self, order: Order) -> None:
        if self._file is None:
            return
        self._builder = LogBuilder(self._file, unpickled(self._content(order)), self._give_way)
        self._free(order)
        self._due, self._begun = 0.0, time.monotonic()
        waiting, self._waiting = self._waiting, []
        for batch in waiting:
            self._batch(self._builder, batch)

    def _batch(self, builder: LogBuilder, order: Order) -> None:
        """Carry out calls, whose arrays lie in the slab until they are written or copied."""
        builder.batches.carry_out(self._content(order), self._slabs[order.slab].memory)
        builder.settle()
        self._free(order)
        self._dirty = True
        if time.monotonic() >= self._due:
            self._flush()

    def _give_way(self) -> None:
        if self.gives_way and not self.pause:
            os.sched_yield()

    def _content(self, order: Order) -> bytes:
        return self._slabs[order.content].memory[order.at : order.at + order.length]

    def _free(self, order: Order) -> None:
        for number in {order.slab, order.content}:
            self._reply(handover.FREED, number)

    def _reply(self, kind: int, number: int = 0) -> None:
        # What was handed over is written, also when whoever did it is gone.
        with suppress(BrokenPipeError, ConnectionResetError):
            self._connection.sendall(Reply.pack(kind, number))

    def _flush(self) -> None:
        if self._builder is not None:
            self._builder.flush()
        elif self._file is not None:
            self._file.flush()
        # A log that has just begun has waited for this process to start: it does not wait again.
        now = time.monotonic()
        self._due, self._dirty = now + min(FLUSH_SECONDS, now - self._begun), False

    def _close(self) -> None:
        self._flush()
        file, self._file, self._builder = self._file, None, None
        if file is not None:
            file.finish()
        self._slabs.clear()
        self._reply(handover.CLOSED)

    def _abandon(self) -> None:
        """Nobody gives orders any more, in the middle of a log: keep what was handed over."""
        if self._file is not None:
            self._flush()
            self._file.close()

    def _fail(self, error: Exception) -> None:
        """Tell the simulation why its log ends here."""
        known = isinstance(error, OSError) and error.errno is not None
        report = {
            "errno": error.errno if known and isinstance(error, OSError) else None,
            "why": error.strerror if known and isinstance(error, OSError) else str(error),
            "traceback": "".join(traceback.format_exception(error)),
            "where": "" if self._file is None else self._file.where_it_ends,
        }
        data = json.dumps(report).encode()
        self._reply(handover.FAILED, len(data))
        with suppress(BrokenPipeError, ConnectionResetError):
            self._connection.sendall(data)

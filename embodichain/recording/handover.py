"""How the simulation hands its log to the process that writes it: orders, replies, shared memory.

An order is 32 bytes on a socket; what it is about lies in a `Slab`, a block of memory that both
processes see, and may be used again when the reply says so. Descriptors travel with the order that
needs them. What a log is made of is not known here.
"""

from __future__ import annotations

import mmap
import os
import socket
import struct
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = [
    "BATCH",
    "CLOSE",
    "CLOSED",
    "FAILED",
    "FLUSH",
    "FLUSHED",
    "FREED",
    "HEAD",
    "OPEN",
    "PICKLED",
    "SLAB",
    "Call",
    "Counters",
    "FormFields",
    "FormTold",
    "Order",
    "Reply",
    "ReplyReader",
    "Slab",
    "receive_order",
    "send_order",
]

# Orders.
OPEN, SLAB, HEAD, BATCH, FLUSH, CLOSE = range(1, 7)
# Replies.
FREED, FLUSHED, CLOSED, FAILED = range(1, 5)

_ORDER = struct.Struct("<BxxxIIIQQ")
Reply = struct.Struct("<BxxxI")
"""Kind, and a number: of a slab, or of the bytes that follow."""

Call = tuple[str, tuple[object, ...], tuple[object, ...]]
"""Method, arguments, and what the arguments lack: four entries for each array that lies in the slab
(its index, offset, type and shape), or for what is pickled (index, 0, `PICKLED` and the bytes). The
rest are numbers and texts, so that a batch of calls is packed by `marshal`, in a tenth of the time
that pickle takes."""
FormFields = tuple[tuple[str, tuple[int, ...], int], ...]
"""Type, shape and offset of each array of calls that are alike."""
FormTold = tuple[int, str, tuple[object, ...], FormFields]
"""Number of a form, its method, the arguments before the arrays, and the arrays.

A batch is a list of forms that are new, and a list of calls; a call that has a form is its number
and where the arrays lie in the slab."""
PICKLED = "pickled"


@dataclass(frozen=True, slots=True)
class Order:
    """What the other process shall do.

    Attributes:
        kind: ``OPEN`` a log (descriptors of file, folder and counters); take a new ``SLAB`` (its
            descriptor); write the ``HEAD``; carry out a ``BATCH`` of calls; ``FLUSH``; ``CLOSE``.
        number: Counts orders: one that comes twice is carried out once.
        slab: The slab of arrays.
        content: The slab in which the pickled content lies.
        at: Where it begins there.
        length: Its bytes; of a new slab, its size.
    """

    kind: int
    number: int
    slab: int = 0
    content: int = 0
    at: int = 0
    length: int = 0


def send_order(connection: socket.socket, order: Order, descriptors: Sequence[int] = ()) -> None:
    """Send an order, with descriptors that the other process gets its own copies of.

    Raises:
        OSError: If the other process is gone.
    """
    data = _ORDER.pack(order.kind, order.number, order.slab, order.content, order.at, order.length)
    if descriptors:
        socket.send_fds(connection, [data], list(descriptors))
    else:
        connection.sendall(data)


def receive_order(connection: socket.socket) -> tuple[Order, list[int]] | None:
    """Wait for an order and its descriptors; None when the simulation's process has ended."""
    data, descriptors = b"", list[int]()
    while len(data) < _ORDER.size:
        try:
            more, found, _, _ = socket.recv_fds(connection, _ORDER.size - len(data), 3)
        except ConnectionResetError:
            return None
        if not more:
            return None
        data += more
        descriptors += found
    return Order(*_ORDER.unpack(data)), descriptors


class ReplyReader:
    """Takes replies off a socket.

    Args:
        connection: The socket.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._data = b""

    def read(self) -> list[tuple[int, int, bytes]] | None:
        """Wait for replies: kind, number, and the report of a failure.

        Returns:
            Those that have arrived; None when the other process has ended.
        """
        if not self._more():
            return None
        found: list[tuple[int, int, bytes]] = []
        while len(self._data) >= Reply.size:
            kind, number = Reply.unpack_from(self._data)
            end = Reply.size + (number if kind == FAILED else 0)
            while len(self._data) < end and self._more():
                pass
            found.append((kind, number, self._data[Reply.size : end]))
            self._data = self._data[end:]
        return found

    def _more(self) -> bool:
        try:
            data = self._connection.recv(2**16)
        except ConnectionResetError:
            data = b""
        self._data += data
        return bool(data)


class Slab:
    """A block of memory that two processes share.

    Args:
        number: Its name in orders.
        size: Bytes.
        descriptor: Of an existing one; None makes a new one.
    """

    __slots__ = ("at", "descriptor", "memory", "number", "size")

    def __init__(self, number: int, size: int, descriptor: int | None = None) -> None:
        self.number, self.size, self.at = number, size, 0
        self.descriptor = _new_memory(size) if descriptor is None else descriptor
        self.memory = mmap.mmap(self.descriptor, size)

    def forget_descriptor(self) -> None:
        """Close the descriptor; the memory stays as long as anybody looks at it."""
        os.close(self.descriptor)
        self.descriptor = -1


def _new_memory(size: int) -> int:
    """Descriptor of memory that has no name: nothing is left of it, however its users end."""
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create("embodichain-log", os.MFD_CLOEXEC)
    else:  # macOS
        with tempfile.TemporaryFile() as stream:
            descriptor = os.dup(stream.fileno())
    os.ftruncate(descriptor, size)
    return descriptor


class Counters:
    """What the writing process counts and the simulation may look at, at any time.

    Args:
        slab: Where they lie; at least `SIZE` bytes.
    """

    SIZE = 4096
    _NAMES = ("nbytes", "size", "part", "head_bytes")
    __slots__ = ("_values",)

    def __init__(self, slab: Slab) -> None:
        self._values = np.ndarray(len(self._NAMES), "<u8", slab.memory)

    def set(self, nbytes: int, size: int, part: int, head_bytes: int) -> None:
        """Say how things are."""
        self._values[:] = nbytes, size, part, head_bytes

    @property
    def nbytes(self) -> int:
        """Bytes of all files that were written."""
        return int(self._values[0])

    @property
    def size(self) -> int:
        """Bytes of the file in progress, those of its last chunk before they are compressed."""
        return int(self._values[1])

    @property
    def part(self) -> int:
        """Files that were finished."""
        return int(self._values[2])

    @property
    def head_bytes(self) -> int:
        """Bytes that the file in progress began with; 0 until its start is written."""
        return int(self._values[3])

"""One background thread that compresses and writes an MCAP file.

The simulation hands over batches of messages and goes on; when the disk is slower than physics, it
waits (the queue is bounded, nothing is dropped). What a message means is known elsewhere.
"""

from __future__ import annotations

import atexit
import errno
import os
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

from embodichain.recording.mcap_file import McapFile, Part
from embodichain.recording.schemas import descriptor_set

__all__ = ["Batch", "Deferred", "Job", "LogWriteError", "McapThread", "Message"]

FLUSH_SECONDS = 1.0
"""What a killed process loses at most."""

Message = tuple[str, int, tuple[Part, ...]]
"""Topic, log time in ns, and the parts of the payload."""
Job = Callable[["McapThread"], None]
"""Work for the background thread; it may register channels and write."""
Deferred = tuple[Callable[..., None], tuple[object, ...]]
"""A function for the background thread and its arguments."""
Batch = list[Message | Job | Deferred]


class LogWriteError(OSError):
    """The log could not be written; the text says why, and where it ends."""


class McapThread:
    """A file that is written beside the simulation.

    Args:
        path: A new file; an existing one is never overwritten.
        compression: ``lz4``, ``zstd`` or ``none``.
        depth: Batches that may wait in the queue.
        collect: Asked, on the background thread, for what was not handed over within a second.
        ends: Says where the file ends, for the error when it cannot be written.

    Raises:
        FileExistsError: If `path` exists.
    """

    def __init__(
        self,
        path: Path,
        compression: str,
        depth: int,
        collect: Callable[[McapThread], Batch] | None = None,
        ends: Callable[[McapThread], str] | None = None,
    ) -> None:
        self.path = path
        self._collect, self._ends = collect, ends
        self._compression = compression
        # A descriptor: whoever renames the folder meanwhile does not send later files elsewhere.
        self.folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            self._stream: BinaryIO = path.open("xb", buffering=0)
        except BaseException:
            os.close(self.folder)
            raise
        self._writer = McapFile(self._stream, compression, library="embodichain")
        self._before: Counter[str] = Counter()
        self._bytes_before = 0
        self.part = 0
        """Files that were finished."""
        self.finished: Callable[[int], None] | None = None
        """Called on the background thread with the size of the last file, when it is whole."""
        self._queue: queue.Queue[Batch | None] = queue.Queue(depth)
        self._channels: dict[str, int] = {}
        self._declared: dict[str, tuple[str, bytes | None]] = {}
        self._schemas: dict[str, int] = {}
        self._error: BaseException | None = None
        self._told = False
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="mcap-writer", daemon=True)
        self._thread.start()
        # A program that ends without closing must not leave this thread in the middle of a chunk:
        # the file would lack its end, and a daemon thread in native code may crash at exit.
        atexit.register(self.close)

    # -- called by the simulation's thread -------------------------------------------------------

    def put(self, batch: Batch) -> None:
        """Hand over messages and jobs, in order; waits while the queue is full.

        Raises:
            OSError: If the file could not be written; the log ends there.
        """
        while True:
            self._raise_error()
            try:
                self._queue.put(batch, timeout=1.0)
            except queue.Full:
                continue
            return

    def flush(self) -> None:
        """Wait until everything handed over so far is in the file, readable there.

        Raises:
            OSError: If the file could not be written.
        """
        done = threading.Event()

        def write_out(_thread: McapThread) -> None:
            self._writer.flush()
            done.set()

        self.put([write_out])
        while not done.wait(timeout=0.1):
            self._raise_error()

    def close(self) -> None:
        """Write what waits, the index and the end of the file. A second call does nothing.

        Raises:
            OSError: If the file could not be written.
        """
        if self._closed:
            return
        self._closed = True
        atexit.unregister(self.close)
        while self._thread.is_alive():
            try:
                self._queue.put(None, timeout=1.0)
                break
            except queue.Full:
                continue
        self._thread.join()
        self._raise_error()

    @property
    def lost(self) -> bool:
        """Whether the file could not be written, and somebody was told."""
        return self._told

    @property
    def idle(self) -> bool:
        """Whether nothing waits in the queue."""
        return self._queue.empty()

    @property
    def size(self) -> int:
        """Bytes of the file in progress, those of its last chunk before they are compressed."""
        return self._writer.size

    @property
    def nbytes(self) -> int:
        """Bytes of all files that were written."""
        return self._bytes_before + self._writer.nbytes

    def written(self, topic: str) -> int:
        """How many messages of a channel are in the files, readable there."""
        channel = self._channels.get(topic)
        return self._before[topic] + (0 if channel is None else self._writer.count(channel))

    def _raise_error(self) -> None:
        error = self._error
        if error is not None:
            self._told = True
            why = error.strerror if isinstance(error, OSError) and error.strerror else repr(error)
            end = f"; {self._ends(self)}" if self._ends is not None else ""
            raise LogWriteError(f"the log {self.path} could not be written: {why}{end}") from error

    # -- called by the background thread ---------------------------------------------------------

    def channel(self, topic: str, schema: str, data: bytes | None = None) -> None:
        """Declare a channel once.

        Args:
            topic: Its name.
            schema: ``embodichain.NAME`` or ``foxglove.NAME``.
            data: The schema's FileDescriptorSet, where it is this run's own.
        """
        if topic in self._channels:
            return
        self._declared[topic] = schema, data
        if schema not in self._schemas:
            self._schemas[schema] = self._writer.schema(
                schema, data if data is not None else descriptor_set(schema)
            )
        self._channels[topic] = self._writer.channel(topic, self._schemas[schema])

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Add an attachment."""
        self._writer.attachment(name, media_type, data, time_ns)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._writer.metadata(name, values)

    def write(self, topic: str, time_ns: int, parts: Sequence[Part]) -> None:
        """Add a message to a declared channel."""
        self._writer.message(self._channels[topic], time_ns, parts)

    def roll(self, name: str, last: Callable[[McapThread], None]) -> int:
        """Finish the file, and go on in another one, with the same channels under the same ids.

        The new file exists before the old one names it: whoever reads finds both.

        Args:
            name: The new file, in the same folder.
            last: Called for what the old file shall end with.

        Returns:
            Size of the finished file.
        """
        stream = self._new(name)
        try:
            last(self)
            self._writer.finish()
            self._check_place()
        except BaseException:
            stream.close()
            raise
        for topic, channel in self._channels.items():
            self._before[topic] += self._writer.count(channel)
        nbytes = self._writer.nbytes
        self._stream.close()
        self._stream = stream
        self._writer = McapFile(stream, self._compression, library="embodichain")
        self._bytes_before += nbytes
        self._channels.clear()
        self._schemas.clear()
        for topic, (schema, data) in list(self._declared.items()):
            self.channel(topic, schema, data)
        self.part += 1
        return nbytes

    def _new(self, name: str) -> BinaryIO:
        """A new file in the folder, without a buffer: chunks are large.

        What could not be written must not come again at close.
        """
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        return open(os.open(name, flags, 0o666, dir_fd=self.folder), "wb", buffering=0)

    def _run(self) -> None:
        try:
            self._loop()
            self._writer.finish()
            self._check_place()
            if self.finished is not None:
                self.finished(self._writer.nbytes)
        except BaseException as error:  # noqa: BLE001  (`put` and `close` raise it)
            self._error = error
        finally:
            try:
                self._stream.close()
            except OSError as error:  # some file systems say here that they could not write
                self._error = self._error or error
            os.close(self.folder)
            while self._error is not None and not self._queue.empty():
                self._queue.get_nowait()  # nobody must wait for a dead writer

    def _check_place(self) -> None:
        """Raise if the file was removed: what is written then is gone with this process."""
        if not os.fstat(self._stream.fileno()).st_nlink:
            raise FileNotFoundError(errno.ENOENT, "the file was removed while it was written")

    def _loop(self) -> None:
        due = time.monotonic() + FLUSH_SECONDS
        waiting = False
        while True:
            try:
                batch = self._queue.get(timeout=max(0.0, due - time.monotonic()))
            except queue.Empty:
                batch = self._collect(self) if self._collect is not None else []
            if batch is None:
                return
            for item in batch:
                if not isinstance(item, tuple):
                    item(self)
                elif len(item) == 2:
                    item[0](*item[1])
                else:
                    self.write(*item)
            waiting = waiting or bool(batch)
            if time.monotonic() >= due:
                if waiting:
                    self._writer.flush()
                    self._check_place()
                due, waiting = time.monotonic() + FLUSH_SECONDS, False

"""`LogFile`: a log's MCAP file in progress, which may go on in another one."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import mcap.writer
import zstandard
from mcap.writer import CompressionType, Writer

from embodichain.recording.log_error import LARGEST_CHUNK
from embodichain.recording.schema import descriptor_set

__all__ = ["LogFile"]

_LIBRARY = "embodichain"
_CHUNK_BYTES = 2**20
_LARGEST_MESSAGE = LARGEST_CHUNK - 2 * _CHUNK_BYTES
_COMPRESSIONS = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}
_FAST = zstandard.ZstdCompressionParameters(
    window_log=20,
    hash_log=13,
    chain_log=6,
    search_log=1,
    min_match=7,
    target_length=47,
    strategy=zstandard.STRATEGY_FAST,
)


class _FastZstd:
    """What `mcap.writer` uses of zstandard; its level 3 takes nine times as long on float64."""

    compress = staticmethod(zstandard.ZstdCompressor(compression_params=_FAST).compress)


_library: Any = mcap.writer
_library.zstandard = _FastZstd  # it takes no level


_CHUNK = b"\x06"
"""Opcode of a chunk; `mcap.writer` writes a chunk in one call, and its message indexes after it."""


class _Appended:
    """A new file that is written without a buffer: what fails to be written must not come again.

    Args:
        descriptor: The open file.
        on_chunk: Called when a chunk is in the file as a whole.

    Attributes:
        descriptor: The open file.
        size: Bytes in it.
    """

    def __init__(self, descriptor: int, on_chunk: Callable[[], None]) -> None:
        self.descriptor = descriptor
        self.size = 0
        self._on_chunk = on_chunk

    def write(self, data: bytes) -> int:
        """Append all bytes.

        Raises:
            OSError: If not all of them could be written; `size` says how many bytes the file has.
        """
        left = memoryview(data)
        while left:
            done = os.write(self.descriptor, left)  # a disk that is nearly full takes a part
            self.size += done
            left = left[done:]
        if data[:1] == _CHUNK:
            self._on_chunk()
        return len(data)

    def tell(self) -> int:
        return self.size

    def flush(self) -> None:
        """Everything is in the file."""


class LogFile:
    """A log's file in progress.

    Args:
        path: A new file. Later files go into the same folder, also if it is renamed meanwhile.
        compression: ``zstd``, ``lz4`` or ``none``.

    Attributes:
        name: The first file's name.
        folder: Descriptor of the folder.
        part: How many files were finished before this one.

    Raises:
        FileExistsError: If `path` exists.
    """

    def __init__(self, path: Path, compression: str) -> None:
        self.name = path.name
        self._compression = _COMPRESSIONS[compression]
        self.folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        self.part = 0
        self._before = 0  # bytes of finished files
        self._last_step = self._readable_step = -1
        self._declared: dict[str, tuple[str, bytes]] = {}
        try:
            self._open(self.name)
        except BaseException:
            os.close(self.folder)
            raise

    def _open(self, name: str) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        descriptor = os.open(name, flags, 0o666, dir_fd=self.folder)
        self._stream = _Appended(descriptor, self._on_chunk)
        stream: Any = self._stream
        self._writer: Any = Writer(stream, _CHUNK_BYTES, self._compression)
        self._writer.start(library=_LIBRARY)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        for topic, (schema, data) in self._declared.items():
            self._register(topic, schema, data)

    @property
    def size(self) -> int:
        """Bytes of the file in progress."""
        return self._stream.size

    @property
    def nbytes(self) -> int:
        """Bytes of all files so far."""
        return self._before + self._stream.size

    @property
    def where_it_ends(self) -> str:
        """Where the log ends if nothing more is written, in words."""
        step = self._readable_step
        return f"it ends after control step {step}" if step >= 0 else "no control step is in it"

    def channel(self, topic: str, schema: str, data: bytes | None = None) -> None:
        """Declare a channel, for this file and later ones; a second call does nothing.

        Args:
            topic: Its name.
            schema: ``embodichain.NAME`` or ``foxglove.NAME``.
            data: The schema's FileDescriptorSet, where it is this run's own.
        """
        if topic not in self._declared:
            declared = self._declared[topic] = schema, data or descriptor_set(schema)
            self._register(topic, *declared)

    def _register(self, topic: str, schema: str, data: bytes) -> None:
        writer = self._writer
        if schema not in self._schemas:
            self._schemas[schema] = writer.register_schema(schema, "protobuf", data)
        self._channels[topic] = writer.register_channel(topic, "protobuf", self._schemas[schema])

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Add an attachment."""
        self._writer.add_attachment(time_ns, time_ns, name, media_type, data)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._writer.add_metadata(name, dict(values))

    def write(self, topic: str, time_ns: int, data: bytes, last_step: int | None = None) -> None:
        """Add a message to a declared channel.

        Args:
            topic: The channel.
            time_ns: Log time.
            data: The message.
            last_step: Newest control step that is finished with it.

        Raises:
            OSError: If it cannot be written, or is larger than a chunk may be.
        """
        if len(data) > _LARGEST_MESSAGE:
            raise OSError(errno.EMSGSIZE, f"a message of {len(data)} bytes fits into no chunk")
        if last_step is not None:
            self._last_step = last_step
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns)

    def flush(self) -> None:
        """Make everything readable in the file.

        Raises:
            OSError: If it cannot be written, or was removed.
        """
        self._writer.flush()
        self._check_place()

    def _on_chunk(self) -> None:
        """A chunk is in the file: everything that was added so far is readable.

        What fails to be written after the chunk, such as its index, does not change that.
        """
        self._readable_step = self._last_step

    def put_beside(self, name: str, text: str) -> None:
        """Write a small file beside the log, unless there is one of that name."""
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        try:
            descriptor = os.open(name, flags, 0o666, dir_fd=self.folder)
        except FileExistsError:
            return
        with open(descriptor, "w") as stream:
            stream.write(text)

    def roll(self, name: str, finish: Callable[[], None]) -> int:
        """Finish the file and go on in another one with the same channels.

        The new file exists before the old one names it: a reader finds both.

        Args:
            name: The new file, in the same folder.
            finish: Called for what the old file ends with.

        Returns:
            Size of the finished file.
        """
        old, writer = self._stream, self._writer
        try:
            self._open(name)
        finally:  # what `finish` adds belongs to the old file
            new, self._stream = self._stream, old
            new_writer, self._writer = self._writer, writer
        try:
            finish()
            self._finish()
        except BaseException:
            os.close(new.descriptor)
            raise
        os.close(old.descriptor)
        self._before += old.size
        self._stream, self._writer = new, new_writer
        self.part += 1
        return old.size

    def _finish(self) -> None:
        self._writer.finish()
        self._check_place()

    def finish(self) -> int:
        """Write the index and the end of the file, and return its size.

        Raises:
            OSError: If it cannot be written, or was removed.
        """
        self._finish()
        return self._stream.size

    def close(self) -> None:
        """Close the file as it is. Some file systems report only here that they could not write."""
        os.close(self.folder)
        os.close(self._stream.descriptor)

    def _check_place(self) -> None:
        """Raise if the file was removed: what is written then is gone with this process."""
        if not os.fstat(self._stream.descriptor).st_nlink:
            raise FileNotFoundError(errno.ENOENT, "the file was removed while it was written")

"""`LogFile`: the MCAP file that a log is being written to; it may continue in another file."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from embodichain.recording.format.container.mcap_records import LIBRARIES
from embodichain.recording.format.container.mcap_writer import McapWriter, nbytes
from embodichain.recording.format.log_error import LARGEST_CHUNK
from embodichain.recording.format.messages.schema import descriptor_set
from embodichain.recording.format.parts import part_name
from embodichain.utils.system.atomic import write_text_at

__all__ = ["LogFile"]

_LARGEST_MESSAGE = LARGEST_CHUNK - 2 * 2**20
_CHUNK = b"\x06"
"""Opcode of a chunk; `McapWriter` writes a chunk in one call, and its message indexes after it."""


class _Declaration(NamedTuple):
    """The schema of a channel, which every file of the log declares again.

    Attributes:
        schema: Its name.
        descriptor_set: Its serialized FileDescriptorSet.
    """

    schema: str
    descriptor_set: bytes


class _AppendedFile:
    """A new file, unbuffered: bytes that could not be written must not be written again later.

    Args:
        descriptor: The open file.
        name: Its name, for errors.
        on_chunk: Called after a chunk was written completely.

    Attributes:
        descriptor: The open file.
        size: Size of the file in bytes.
    """

    def __init__(self, descriptor: int, name: str, on_chunk: Callable[[], None]) -> None:
        self.descriptor = descriptor
        self.size = 0
        self._name = name
        self._on_chunk = on_chunk

    def write(self, data: bytes) -> int:
        """Append all bytes.

        Raises:
            OSError: If not all of them could be written; `size` is the size of the file.
        """
        rest = memoryview(data)
        while rest:
            try:
                count = os.write(self.descriptor, rest)  # writes less if the disk is nearly full
            except OSError as error:
                raise OSError(error.errno, error.strerror, self._name) from error
            self.size += count
            rest = rest[count:]
        if data[:1] == _CHUNK:
            self._on_chunk()
        return len(data)

    def tell(self) -> int:
        return self.size


class LogFile:
    """The file that a log is being written to.

    Args:
        path: The first file of the log. Later files are created in the same folder, even if it was
            renamed.
        compression: ``zstd``, ``lz4`` or ``none``.
        part: Index of the file to begin with, which is new.

    Attributes:
        name: The first file's name.
        folder: Descriptor of the folder.
        part: Number of files finished before this one.

    Raises:
        FileExistsError: If the file exists.
    """

    def __init__(self, path: Path, compression: str, part: int = 0) -> None:
        self.name = path.name
        self._compression = compression
        self.folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        self.part = part
        self._finished_bytes = 0  # of the files before this one
        self._last_step = -1  # that a message completes
        self._readable_step = -1  # the last step of the chunks in the file
        self._declared: dict[str, _Declaration] = {}  # by topic
        try:
            self._open(part_name(self.name, part))
        except BaseException:
            os.close(self.folder)
            raise

    def _open(self, name: str) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        descriptor = os.open(name, flags, 0o666, dir_fd=self.folder)
        self._stream = _AppendedFile(descriptor, name, self._on_chunk)
        self._writer = McapWriter(self._stream, self._compression, LIBRARIES[0])
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        for topic, declaration in self._declared.items():
            self._register(topic, declaration)

    @property
    def size(self) -> int:
        """Size of the current file in bytes."""
        return self._stream.size

    @property
    def nbytes(self) -> int:
        """Size of all files so far in bytes."""
        return self._finished_bytes + self._stream.size

    @property
    def where_it_ends(self) -> str:
        """Text that says where the log ends if nothing more is written."""
        step = self._readable_step
        if step < 0:
            return "no control step is in it"
        return f"it ends after control step {step}"

    def channel(self, topic: str, schema: str, data: bytes | None = None) -> None:
        """Declare a channel, for this file and later ones; a second call does nothing.

        Args:
            topic: Its name.
            schema: ``embodichain.NAME`` or ``foxglove.NAME``.
            data: The schema's FileDescriptorSet if it is specific to this run.
        """
        if topic in self._declared:
            return
        declaration = _Declaration(schema, data or descriptor_set(schema))
        self._declared[topic] = declaration
        self._register(topic, declaration)

    def _register(self, topic: str, declaration: _Declaration) -> None:
        """Write a channel to the current file, and its schema before it."""
        writer = self._writer
        schema = declaration.schema
        if schema not in self._schemas:
            self._schemas[schema] = writer.schema(schema, "protobuf", declaration.descriptor_set)
        self._channels[topic] = writer.channel(topic, "protobuf", self._schemas[schema])

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Add an attachment."""
        self._writer.attachment(name, media_type, data, time_ns)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._writer.metadata(name, values)

    def write(
        self, topic: str, time_ns: int, data: bytes | list[Any], last_step: int | None = None
    ) -> int:
        """Add a message to a declared channel, and return its size.

        Args:
            topic: The channel.
            time_ns: Log time.
            data: The message, or a list of bytes and contiguous arrays that it consists of.
            last_step: The last control step that this message completes.

        Raises:
            OSError: If it cannot be written, or exceeds the size limit of a chunk.
        """
        size = sum(map(nbytes, data)) if isinstance(data, list) else len(data)
        if size > _LARGEST_MESSAGE:
            raise OSError(errno.EMSGSIZE, f"a message of {size} bytes fits into no chunk")
        if last_step is not None:
            self._last_step = last_step
        self._writer.message(self._channels[topic], time_ns, data)
        return size

    def flush(self) -> None:
        """Write everything to the file, so that it can be read.

        Raises:
            OSError: If it cannot be written, or was removed.
        """
        self._writer.end_chunk()
        self._check_place()

    def _on_chunk(self) -> None:
        """After a chunk was written: all messages added so far are readable.

        A later failure, such as in writing the chunk's index, does not change that.
        """
        self._readable_step = self._last_step

    def write_beside(self, name: str, text: str) -> None:
        """Write a small file next to the log, unless a file of that name exists."""
        write_text_at(self.folder, name, text, new=True)

    def roll(self, name: str, finish: Callable[[], None]) -> int:
        """Finish the file and continue in a new one with the same channels.

        The new file is created before the old one names it, so readers always find it.

        Args:
            name: Name of the new file, in the same folder.
            finish: Called to write the last records of the old file.

        Returns:
            Size of the finished file.
        """
        old_stream = self._stream
        old_writer = self._writer
        try:
            self._open(name)
        finally:  # records that `finish` adds belong to the old file
            new_stream = self._stream
            new_writer = self._writer
            self._stream = old_stream
            self._writer = old_writer
        try:
            finish()
            self._finish()
        except BaseException:
            os.close(new_stream.descriptor)
            raise
        os.close(old_stream.descriptor)
        self._finished_bytes += old_stream.size
        self._stream = new_stream
        self._writer = new_writer
        self.part += 1
        return old_stream.size

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
        """Close the file without an index. Some file systems report write errors only here."""
        os.close(self.folder)
        os.close(self._stream.descriptor)

    def _check_place(self) -> None:
        """Raise if the file was removed: the data would be lost when this process ends."""
        if not os.fstat(self._stream.descriptor).st_nlink:
            raise FileNotFoundError(errno.ENOENT, "the file was removed while it was written")

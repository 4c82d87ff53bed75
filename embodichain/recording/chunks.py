"""Finds the chunks of a log without reading them, and takes messages out of one at a time.

The container is walked from record to record (https://mcap.dev/spec), skipping what chunks hold, so
that a whole file and one that was cut are found the same way, and a range of steps costs only the
chunks it lies in. What messages mean is not known here.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from embodichain.recording.header import METADATA, METADATA_END, Header, LogError
from embodichain.recording.mcap_file import MAGIC
from embodichain.utils.errors import ConfigError

__all__ = ["ChunkFile", "ChunkPlace", "Found"]

CHUNK_LIMIT = 2**30
"""Bytes that a chunk may claim to hold; the recorder closes one after 1 MiB and a message."""
_KEPT_LIMIT = 2**29
"""Bytes of the largest attachment or metadata record that is believed."""

_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")  # start, end, size, CRC, length of the compression's name
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_DAMAGE = (McapError, struct.error, UnicodeDecodeError, EOFError, IndexError, MemoryError)

Found = tuple[str, int, memoryview]
"""Topic, log time in ns, payload."""


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """Where a chunk lies.

    Attributes:
        start_ns: Smallest log time in it.
        end_ns: Largest log time in it.
        size: Bytes it unpacks to.
        crc: CRC-32 of those; 0 if there is none.
        compression: ``lz4``, ``zstd`` or empty.
        offset: Where its packed bytes begin.
        length: How many they are.
    """

    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    offset: int
    length: int


class ChunkFile:
    """The chunks, attachments and metadata of a file; the messages are still in it.

    Args:
        path: The file.

    Raises:
        ConfigError: If the file is missing, empty or not MCAP.
        LogError: If its metadata is of another version, or damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.is_file():
            what = "is not a file" if path.exists() else "does not exist"
            raise ConfigError(f"{path} {what}")
        self.chunks: list[ChunkPlace] = []
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.header: Header | None = None
        self.finished = False
        """Whether the recorder closed the log itself."""
        self.complete = False
        """Whether the file has its end."""
        self.damage = ""
        """Why reading ended before that; grows when a damaged chunk is met."""
        self._attachments: dict[str, tuple[int, int]] = {}
        self._stream: BinaryIO = path.open("rb")
        try:
            self._walk()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    # -- the container -----------------------------------------------------------------------------

    def _walk(self) -> None:
        magic = self._stream.read(len(MAGIC))
        if magic != MAGIC:
            what = "is empty" if not magic else "is not an MCAP file"
            raise ConfigError(f"{self.path} {what}")
        size, at = self.path.stat().st_size, len(MAGIC)
        while True:
            head = self._stream.read(_HEAD.size)
            if len(head) < _HEAD.size:
                break
            opcode, length = _HEAD.unpack(head)
            at += _HEAD.size
            if length > size - at:
                break
            try:
                self._note(opcode, at, length)
            except _DAMAGE as error:
                self.damage = f"a record is damaged ({type(error).__name__})"
                return
            if opcode == Opcode.FOOTER:
                self.complete = True
                return
            at += length
            self._stream.seek(at)
        self.damage = "the file ends early: it was not closed, or cut"

    def _note(self, opcode: int, at: int, length: int) -> None:
        """Take over what the record at `at` says."""
        if opcode == Opcode.CHUNK:
            start, end, size, crc, n = _CHUNK.unpack(self._stream.read(_CHUNK.size))
            name = self._stream.read(min(n, 16)).decode()
            offset = at + _CHUNK.size + n + 8
            self.chunks.append(
                ChunkPlace(start, end, size, crc, name, offset, at + length - offset)
            )
        elif opcode == Opcode.METADATA and length < _KEPT_LIMIT:
            record = Metadata.read(ReadDataStream(self._stream))
            if record.name == METADATA:
                self.header = Header.from_metadata(record.metadata)
            elif record.name == METADATA_END:
                self.finished = True
        elif opcode == Opcode.ATTACHMENT and length < _KEPT_LIMIT:
            self._stream.seek(at + 16)  # after log time and creation time
            (n,) = struct.unpack("<I", self._stream.read(4))
            if n > length:
                raise EOFError("a name is longer than its record")
            self._attachments[self._stream.read(n).decode()] = (at, length)

    def require_header(self) -> Header:
        """The metadata of the recording.

        Raises:
            LogError: If there is none: another program's MCAP, or a file cut before it.
        """
        if self.header is None:
            why = f" ({self.damage})" if self.damage else ""
            raise LogError(f"{self.path} has no metadata record {METADATA!r}{why}")
        return self.header

    @property
    def attachments(self) -> list[str]:
        """Names of the attachments."""
        return list(self._attachments)

    def attachment(self, name: str) -> bytes:
        """Content of an attachment.

        Raises:
            LogError: If there is none of that name, or it is damaged.
        """
        if name not in self._attachments:
            there = ", ".join(self._attachments) or "none"
            raise LogError(f"{self.path} has no attachment {name}; there are: {there}")
        at, length = self._attachments[name]
        self._stream.seek(at)
        raw = self._stream.read(length)
        (crc,) = struct.unpack("<I", raw[-4:])
        if crc and zlib.crc32(raw[:-4]) != crc:
            raise LogError(f"{self.path}: the attachment {name} is damaged: its checksum is wrong")
        try:
            record = Attachment.read(_stream_of(raw))
        except _DAMAGE as error:
            raise LogError(f"{self.path}: the attachment {name} is damaged ({error!r})") from error
        content: bytes = record.data
        return content

    # -- messages ----------------------------------------------------------------------------------

    def between(self, start_ns: int, end_ns: int) -> list[ChunkPlace]:
        """Chunks that may hold messages of these log times, both included, in file order."""
        return [c for c in self.chunks if c.start_ns <= end_ns and c.end_ns >= start_ns]

    def messages(self, chunks: list[ChunkPlace] | None = None) -> Iterator[Found]:
        """Messages of some chunks, or of all, in file order; what is damaged ends iteration."""
        for found in self.blocks(chunks):
            yield from found

    def blocks(self, chunks: list[ChunkPlace] | None = None) -> Iterator[list[Found]]:
        """The same, a list for each chunk. Channels are declared in the first chunks."""
        if chunks is not None and self.chunks and not self.channels:
            self._unpack(self.chunks[0])
        for chunk in self.chunks if chunks is None else chunks:
            found = self._unpack(chunk)
            if found is None:
                return
            yield found

    def _unpack(self, chunk: ChunkPlace) -> list[Found] | None:
        self._stream.seek(chunk.offset)
        try:
            data = _decompress(chunk, self._stream.read(chunk.length))
            if chunk.crc and zlib.crc32(data) != chunk.crc:
                raise EOFError("its checksum is wrong")
            return self._records(memoryview(data))
        except (*_DAMAGE, RuntimeError, zstandard.ZstdError) as error:
            self.complete = False
            self.damage = f"a chunk is damaged: {str(error) or type(error).__name__}"
            return None

    def _records(self, data: memoryview) -> list[Found]:
        found: list[Found] = []
        head, message = _HEAD.unpack_from, _MESSAGE.unpack_from
        at, size = 0, len(data)
        topics = {i: channel.topic for i, channel in self.channels.items()}
        while at < size:
            opcode, length = head(data, at)
            at += 9
            if length > size - at:
                raise EOFError("a record is longer than its chunk")
            if opcode == 5:
                channel, _, log_time, _ = message(data, at)
                if channel not in topics:
                    raise EOFError(f"a message belongs to channel {channel}, unknown here")
                found.append((topics[channel], log_time, data[at + 22 : at + length]))
            elif opcode == Opcode.CHANNEL:
                record = Channel.read(_stream_of(data[at : at + length]))
                self.channels[record.id], topics[record.id] = record, record.topic
            elif opcode == Opcode.SCHEMA:
                schema = Schema.read(_stream_of(data[at : at + length]))
                self.schemas[schema.id] = schema
            at += length
        return found


def _stream_of(data: bytes | memoryview) -> Any:
    return ReadDataStream(io.BytesIO(data))


def _decompress(chunk: ChunkPlace, data: bytes) -> bytes:
    """Unpack a chunk; never to more than it announces.

    Raises:
        EOFError: If the size is not the announced one, or is not believed.
    """
    if chunk.size > CHUNK_LIMIT:
        raise EOFError(f"it claims to hold {chunk.size} bytes")
    if chunk.compression == "":
        out = data
    elif chunk.compression == "lz4":
        out = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=chunk.size + 1)
    elif chunk.compression == "zstd":
        if zstandard.frame_content_size(data) > chunk.size:
            raise EOFError("it holds more than it announces")
        out = zstandard.ZstdDecompressor().decompress(data, max_output_size=chunk.size + 1)
    else:
        raise EOFError(f"its compression {chunk.compression!r} is not known here")
    if len(out) != chunk.size:
        raise EOFError("it does not hold what it announces")
    return out

"""`McapWriter`: writes MCAP files in chunks, with every index and checksum of the format.

The library's own writer has no parameter for the level of zstd, and takes a message in one piece.
Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

__all__ = ["McapWriter", "nbytes"]

_MAGIC = b"\x89MCAP0\r\n"
_MESSAGE = struct.Struct("<BQHIQQ")
"""Opcode, length, channel, sequence, log time and publish time."""
_HEAD = 9
"""Bytes of a record's opcode and length, which its length does not count."""
_FOOTER = struct.Struct("<BQQQ")
"""The part of a footer that its checksum covers."""
_CHUNK_BYTES = 2**20
_FAST = zstandard.ZstdCompressionParameters(
    window_log=20,
    hash_log=13,
    chain_log=6,
    search_log=1,
    min_match=7,
    target_length=47,
    strategy=zstandard.STRATEGY_FAST,
)
"""zstd's level 3 is 9 times slower on float64."""


class Stream(Protocol):
    """The file, or anything else that bytes can be appended to."""

    def write(self, data: bytes, /) -> Any:
        """Append all bytes, or raise OSError."""
        ...

    def tell(self) -> int:
        """The size of the file so far."""
        ...


class McapWriter:
    """Writes one file.

    Nothing is written twice: bytes that were passed to the stream are forgotten, even if it failed.

    Args:
        stream: An empty file.
        compression: ``zstd``, ``lz4`` or ``none``, of chunks.
        library: The text of the header that names the program.
        profile: The header's profile: an empty text, or a well-known one such as ``ros2``.
        chunk_bytes: A chunk is written when its records are longer.

    Raises:
        ValueError: If the compression is another one.
        OSError: If `stream` cannot be written, here and in each method.
    """

    def __init__(
        self,
        stream: Stream,
        compression: str,
        library: str,
        profile: str = "",
        chunk_bytes: int = _CHUNK_BYTES,
    ) -> None:
        self._stream = stream
        self._compression = compression
        self._compress = _compressor(compression)
        self._chunk_bytes = chunk_bytes
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._message_counts: defaultdict[int, int] = defaultdict(int)
        self._first_time: int | None = None
        self._last_time = 0
        self._crc = 0  # of all bytes so far
        self._chunk = bytearray()  # its records so far
        self._chunk_messages: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
        self._chunk_first_time: int | None = None
        self._chunk_last_time = 0
        self._put(_MAGIC + _bytes_of(Header(profile, library)))

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Declare a schema; returns its id."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas.append(schema)
        self._chunk += _bytes_of(schema)
        self._end_long_chunk()
        return schema.id

    def channel(
        self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str] | None = None
    ) -> int:
        """Declare a channel for messages of a schema; returns its id."""
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=encoding,
            schema_id=schema,
            metadata=dict(metadata or {}),
        )
        self._channels.append(channel)
        self._chunk += _bytes_of(channel)
        self._end_long_chunk()
        return channel.id

    def message(self, channel: int, time_ns: int, data: bytes | list[Any]) -> None:
        """Add a message to the chunk, and write the chunk if it is full.

        Args:
            channel: Id of its channel.
            time_ns: Log time and publish time.
            data: The message, or a list of bytes and contiguous arrays that it consists of.
        """
        chunk = self._chunk
        first = self._chunk_first_time
        if first is None or time_ns < first:
            self._chunk_first_time = time_ns
        if time_ns > self._chunk_last_time:
            self._chunk_last_time = time_ns
        self._chunk_messages[channel].append((time_ns, len(chunk)))
        size = sum(map(nbytes, data)) if isinstance(data, list) else len(data)
        length = _MESSAGE.size - _HEAD + size
        chunk += _MESSAGE.pack(Opcode.MESSAGE, length, channel, 0, time_ns, time_ns)
        if isinstance(data, list):
            for piece in data:
                chunk.extend(piece)  # += would call numpy's addition
        else:
            chunk += data
        if len(chunk) > self._chunk_bytes:
            self.end_chunk()

    def attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Add an attachment, created and logged at the same time."""
        start = self._stream.tell()
        attachment = Attachment(
            name=name,
            media_type=media_type,
            data=data,
            create_time=time_ns,
            log_time=time_ns,
        )
        record = _bytes_of(attachment)
        index = AttachmentIndex(
            name=name,
            media_type=media_type,
            create_time=time_ns,
            log_time=time_ns,
            offset=start,
            length=len(record),
            data_size=len(data),
        )
        self._attachments.append(index)
        self._put(record)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        start = self._stream.tell()
        record = _bytes_of(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(MetadataIndex(offset=start, length=len(record), name=name))
        self._put(record)

    def end_chunk(self) -> None:
        """Write the chunk, if it has a message, and the indexes of its messages."""
        if not self._chunk_messages:
            return
        records = self._chunk
        chunk = Chunk(
            compression="" if self._compression == "none" else self._compression,
            data=self._compress(records),
            message_start_time=self._chunk_first_time or 0,
            message_end_time=self._chunk_last_time,
            uncompressed_crc=zlib.crc32(records),
            uncompressed_size=len(records),
        )
        messages = self._chunk_messages
        self._note_times(chunk)
        self._open_chunk()
        start = self._stream.tell()
        record = _bytes_of(chunk)
        self._put(record)
        indexes: Any = RecordBuilder()
        offsets = {}
        for channel, places in messages.items():
            self._message_counts[channel] += len(places)
            offsets[channel] = start + len(record) + indexes.count
            MessageIndex(channel_id=channel, records=places).write(indexes)
        index = ChunkIndex(
            message_start_time=chunk.message_start_time,
            message_end_time=chunk.message_end_time,
            chunk_start_offset=start,
            chunk_length=len(record),
            message_index_offsets=offsets,
            message_index_length=indexes.count,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            uncompressed_size=chunk.uncompressed_size,
        )
        self._put(indexes.end())
        self._chunks.append(index)

    def finish(self) -> None:
        """Write the last chunk, the summary and the end of the file."""
        self.end_chunk()
        self._put(_bytes_of(DataEnd(self._crc)))
        start = self._stream.tell()
        summary: Any = RecordBuilder()
        groups: list[tuple[int, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ]
        offsets = []
        for opcode, records in groups:
            begin = summary.count
            for record in records:
                record.write(summary)
            offsets.append(SummaryOffset(opcode, start + begin, summary.count - begin))
        offsets_start = start + summary.count
        for offset in offsets:
            offset.write(summary)
        data = summary.end()
        crc = zlib.crc32(data)
        length = len(_bytes_of(Footer(0, 0, 0))) - _HEAD
        crc = zlib.crc32(_FOOTER.pack(Opcode.FOOTER, length, start, offsets_start), crc)
        self._put(data)
        self._put(_bytes_of(Footer(start, offsets_start, crc)))
        self._put(_MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._message_counts),
            chunk_count=len(self._chunks),
            message_count=sum(self._message_counts.values()),
            metadata_count=len(self._metadata),
            message_start_time=self._first_time or 0,
            message_end_time=self._last_time,
            schema_count=len(self._schemas),
        )

    def _open_chunk(self) -> None:
        self._chunk = bytearray()
        self._chunk_messages = defaultdict(list)
        self._chunk_first_time = None
        self._chunk_last_time = 0

    def _note_times(self, chunk: Chunk) -> None:
        """Widen the file's time range by a chunk's."""
        first = chunk.message_start_time
        self._first_time = first if self._first_time is None else min(self._first_time, first)
        self._last_time = max(self._last_time, chunk.message_end_time)

    def _end_long_chunk(self) -> None:
        if len(self._chunk) > self._chunk_bytes:
            self.end_chunk()

    def _put(self, data: bytes) -> None:
        self._crc = zlib.crc32(data, self._crc)
        self._stream.write(data)


def nbytes(piece: Any) -> int:
    """Length of bytes or of a contiguous array."""
    return len(piece) if type(piece) is bytes else memoryview(piece).nbytes


def _bytes_of(record: McapRecord) -> bytes:
    builder: Any = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()
    return data


def _compressor(compression: str) -> Callable[[bytearray], bytes]:
    if compression == "zstd":
        return zstandard.ZstdCompressor(compression_params=_FAST).compress
    if compression == "lz4":
        import lz4.frame  # type: ignore[import-untyped]

        compress: Callable[[bytearray], bytes] = lz4.frame.compress
        return compress
    if compression == "none":
        return bytes
    raise ValueError(f"compression {compression!r} is not zstd, lz4 or none")

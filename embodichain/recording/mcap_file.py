"""Writes the MCAP container: chunks, indexes, statistics (https://mcap.dev/spec).

The library's own writer spends some 12 us of Python on a message and copies its payload four times;
beside a control step of 1 ms that is too much. Here a message costs one `struct.pack`, its payload
is copied once, and every other record is still the library's. What messages mean is not known here.
"""

from __future__ import annotations

import mmap
import struct
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from io import FileIO
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from isal.isal_zlib import crc32  # zlib's takes five times as long
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from numpy.typing import NDArray

from embodichain.recording.append_file import AppendFile

__all__ = ["CHUNK_LIMIT", "COMPRESSORS", "MAGIC", "McapFile", "Part", "Piece"]

Part = bytes | NDArray[Any]
"""A piece of a payload; arrays are contiguous. It is copied at once."""
Piece = bytes | Sequence[NDArray[np.uint8]]
"""A piece of many payloads of one size: the same in each, or rows of bytes, one below the other."""

MAGIC = b"\x89MCAP0\r\n"
CHUNK_BYTES = 2**20
"""A chunk is closed when it holds more than this: large enough to compress, small enough to stay in
the cache between being gathered and being compressed."""
CHUNK_LIMIT = 2**27
"""Bytes of the largest chunk that is written or believed: a million numbers of state for each of
16 environments, or 123 for each of 136,000."""

_FAST = zstandard.ZstdCompressionParameters(
    window_log=20,
    hash_log=13,
    chain_log=6,
    search_log=1,
    min_match=7,
    target_length=47,
    strategy=zstandard.STRATEGY_FAST,
)
COMPRESSORS: Mapping[str, Callable[[memoryview], bytes]] = {
    "none": bytes,
    # Files as large as lz4's below, in less than half the time. In logs of six tasks 15 to 30 %
    # faster than level -30, files -3 to +3 %: it looks for repetitions where numbers begin (every
    # 48 bytes, one more than the target length), and for no shorter ones than 7 bytes.
    "zstd-fast": zstandard.ZstdCompressor(compression_params=_FAST).compress,
    # Acceleration 8 takes three quarters of the time, and files become 8 % larger.
    "lz4": partial(lz4.frame.compress, compression_level=-8),
    "zstd": zstandard.ZstdCompressor(level=1).compress,
}

_NAMES = {"none": "", "zstd-fast": "zstd"}
"""What compressors are called in a file, where that differs."""

# Opcode, record length, channel, sequence, log time, publish time.
_MESSAGE = struct.Struct("<BQHIQQ")
_ENTRY = struct.Struct("<QQ")
"""Of a message index: the message's time and place."""
_RECORD_HEAD = 1 + 8
_MESSAGE_FIXED = 2 + 4 + 8 + 8
_FOOTER = struct.Struct("<BQQQ")


def _width(piece: Piece) -> int:
    """Bytes of a payload that a piece takes."""
    return len(piece) if isinstance(piece, bytes) else piece[0].shape[1]


def _record(record: Any) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


class McapFile:
    """An MCAP file that grows.

    Args:
        stream: Where to write, without a buffer: chunks are large, and what could not be written
            must not come again. `finish` leaves it open.
        compression: One of `COMPRESSORS`.
        library: Name of the writer, for the header.
    """

    def __init__(self, stream: FileIO, compression: str, library: str) -> None:
        self._file = AppendFile(stream)
        self._name = _NAMES.get(compression, compression)
        self._compress = COMPRESSORS[compression]
        self._chunk = mmap.mmap(-1, 2 * CHUNK_BYTES)
        self._chunk_size = 0
        self._messages = 0
        self._first = self._last = 0
        self._index: defaultdict[int, bytearray] = defaultdict(bytearray)
        self._schemas: list[records.Schema] = []
        self._channels: list[records.Channel] = []
        self._chunk_index: list[records.ChunkIndex] = []
        self._attachment_index: list[records.AttachmentIndex] = []
        self._metadata_index: list[records.MetadataIndex] = []
        self._counts: dict[int, int] = {}
        self._start = self._end = 0
        self._write(MAGIC)
        self._write(_record(records.Header(profile="", library=library)))

    def _write(self, *parts: bytes) -> int:
        """Append bytes at once; return where they start."""
        at = self._file.size
        self._file.write(parts)
        return at

    @property
    def nbytes(self) -> int:
        """Bytes written."""
        return self._file.size

    @property
    def size(self) -> int:
        """Bytes written, and those of the chunk in progress before it is compressed."""
        return self._file.size + self._chunk_size

    def count(self, channel_id: int) -> int:
        """How many messages of a channel are in chunks that were written."""
        return self._counts[channel_id]

    # -- content -----------------------------------------------------------------------------------

    def schema(self, name: str, data: bytes) -> int:
        """Declare a protobuf schema; return its id."""
        schema = records.Schema(
            id=len(self._schemas) + 1, name=name, encoding="protobuf", data=data
        )
        self._schemas.append(schema)
        self._add(_record(schema))
        return int(schema.id)

    def channel(self, topic: str, schema_id: int) -> int:
        """Declare a channel of protobuf messages; return its id."""
        channel = records.Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding="protobuf",
            schema_id=schema_id,
            metadata={},
        )
        self._channels.append(channel)
        self._counts[channel.id] = 0
        self._add(_record(channel))
        return int(channel.id)

    def _add(self, data: bytes) -> None:
        at = self._reserve(len(data))
        self._chunk[at : at + len(data)] = data
        self._chunk_size += len(data)

    def _reserve(self, nbytes: int) -> int:
        """Where so many bytes may be written, in the chunk in progress or in another one.

        Raises:
            ValueError: If they would make any chunk larger than readers believe.
        """
        if self._chunk_size + nbytes > CHUNK_LIMIT - 2**20:
            if nbytes > CHUNK_LIMIT - 2**20:
                raise ValueError(
                    f"a message of {nbytes} bytes is more than a log's readers believe"
                )
            self._close_chunk()
        size = self._chunk_size
        if size + nbytes > len(self._chunk):
            longer = mmap.mmap(-1, size + nbytes + CHUNK_BYTES)
            longer[:size] = self._chunk[:size]
            self._chunk = longer
        return size

    def message(self, channel_id: int, time_ns: int, parts: Sequence[Part]) -> None:
        """Add a message."""
        size = _MESSAGE_FIXED
        for part in parts:
            size += len(part) if type(part) is bytes else part.nbytes  # type: ignore[union-attr]
        at = self._chunk_size
        if at + _RECORD_HEAD + size > len(self._chunk):
            at = self._reserve(_RECORD_HEAD + size)
        self._index[channel_id] += _ENTRY.pack(time_ns, at)
        chunk = self._chunk
        _MESSAGE.pack_into(chunk, at, Opcode.MESSAGE, size, channel_id, 0, time_ns, time_ns)
        at += _MESSAGE.size
        for part in parts:
            end = at + (len(part) if type(part) is bytes else part.nbytes)  # type: ignore[union-attr]
            chunk[at:end] = part  # type: ignore[assignment]  # arrays are buffers
            at = end
        self._added(1, time_ns, time_ns, at)

    def messages(self, time_ns: int, messages: Sequence[tuple[int, bytes]]) -> None:
        """Add messages of one moment: the channel and the payload of each."""
        begin = self._reserve(sum([_MESSAGE.size + len(data) for _, data in messages]))
        parts, at, index = list[bytes](), begin, self._index
        for channel, data in messages:
            index[channel] += _ENTRY.pack(time_ns, at)
            size = _MESSAGE_FIXED + len(data)
            parts += (_MESSAGE.pack(Opcode.MESSAGE, size, channel, 0, time_ns, time_ns), data)
            at += _RECORD_HEAD + size
        self._chunk[begin:at] = b"".join(parts)
        self._added(len(messages), time_ns, time_ns, at)

    def _added(self, messages: int, first_ns: int, last_ns: int, size: int) -> None:
        """Messages of these moments have made the chunk so large."""
        if not self._messages:
            self._first, self._last = first_ns, last_ns
        elif last_ns > self._last:
            self._last = last_ns
        if first_ns < self._first:
            self._first = first_ns
        self._messages += messages
        self._chunk_size = size
        if size > CHUNK_BYTES:
            self._close_chunk()

    def rows(self, messages: Sequence[tuple[int, Sequence[Piece]]], times: Sequence[int]) -> None:
        """Add the same messages for each of some moments, all of one size.

        Args:
            messages: Channel and pieces of each.
            times: The moments in ns, ascending.
        """
        count = len(times)
        sizes = [_MESSAGE_FIXED + sum(map(_width, pieces)) for _, pieces in messages]
        width = sum(sizes) + _RECORD_HEAD * len(sizes)
        if self._chunk_size + count * width > CHUNK_BYTES:
            self._close_chunk()
        begin = self._reserve(count * width)
        table = np.ndarray((count, width), np.uint8, self._chunk, begin)
        entries = np.empty((count, 2), "<u8")
        entries[:] = np.array(times, "<u8")[:, None]
        stamps = entries.copy().view(np.uint8)
        entries[:, 1] = np.arange(begin, begin + table.nbytes, width)
        at = 0
        for (channel, pieces), size in zip(messages, sizes, strict=True):
            self._index[channel] += entries.tobytes()
            entries[:, 1] += np.uint64(size + _RECORD_HEAD)
            head = _MESSAGE.pack(Opcode.MESSAGE, size, channel, 0, 0, 0)
            end = at + len(head)
            table[:, at:end] = np.frombuffer(head, np.uint8)
            table[:, end - stamps.shape[1] : end] = stamps
            for piece in pieces:
                at, end = end, end + _width(piece)
                if isinstance(piece, bytes):
                    table[:, at:end] = np.frombuffer(piece, np.uint8)
                else:
                    row = 0
                    for block in piece:
                        table[row : row + len(block), at:end] = block
                        row += len(block)
            at = end
        self._added(count * len(messages), times[0], times[-1], begin + table.nbytes)

    def attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Add a file."""
        attachment = records.Attachment(
            create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=data
        )
        record = _record(attachment)
        self._attachment_index.append(
            records.AttachmentIndex(
                offset=self._write(record),
                length=len(record),
                create_time=time_ns,
                log_time=time_ns,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a map of strings."""
        record = _record(records.Metadata(name=name, metadata=dict(values)))
        self._metadata_index.append(
            records.MetadataIndex(offset=self._write(record), length=len(record), name=name)
        )

    # -- container ---------------------------------------------------------------------------------

    def flush(self) -> None:
        """Close the chunk in progress and hand everything to the operating system."""
        self._close_chunk()

    def _close_chunk(self) -> None:
        if not self._messages:
            return
        data = memoryview(self._chunk)[: self._chunk_size]
        packed = self._compress(data)
        start, end = self._first, self._last
        # The record's fields by hand: the library would copy the data twice more.
        name = self._name.encode()
        head = struct.pack("<QQQII", start, end, len(data), crc32(data), len(name)) + name
        head += struct.pack("<Q", len(packed))
        head = struct.pack("<BQ", Opcode.CHUNK, len(head) + len(packed)) + head
        at, index_at = self._file.size, self._file.size + len(head) + len(packed)
        index, offsets = self._message_index(index_at)
        try:
            self._write(head, packed, index)  # at once: it is there, or it is not
        finally:
            if self._file.size >= index_at:  # its messages are, even if a full disk took no more
                for channel, entries in self._index.items():
                    self._counts[channel] += len(entries) // _ENTRY.size
        self._chunk_index.append(
            records.ChunkIndex(
                message_start_time=start,
                message_end_time=end,
                chunk_start_offset=at,
                chunk_length=index_at - at,
                message_index_offsets=offsets,
                message_index_length=self._file.size - index_at,
                compression=self._name,
                compressed_size=len(packed),
                uncompressed_size=len(data),
            )
        )
        self._start = min(start, self._start) if len(self._chunk_index) > 1 else start
        self._end = max(end, self._end)
        self._messages = 0
        self._index.clear()
        self._chunk_size = 0

    def _message_index(self, at: int) -> tuple[bytes, dict[int, int]]:
        """The chunk's index records, which begin at `at`, and where that of each channel does."""
        records, offsets = bytearray(), {}
        for channel, entries in self._index.items():
            offsets[channel] = at + len(records)
            size = len(entries)
            records += struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + size, channel, size)
            records += entries
        return bytes(records), offsets

    def finish(self) -> None:
        """Write the summary section and the end of the file."""
        self._close_chunk()
        self._write(_record(records.DataEnd(0)))
        groups: list[tuple[Opcode, list[Any]]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunk_index),
            (Opcode.ATTACHMENT_INDEX, self._attachment_index),
            (Opcode.METADATA_INDEX, self._metadata_index),
        ]
        start = self._file.size
        summary, offsets = bytearray(), bytearray()
        for opcode, group in groups:
            data = b"".join(map(_record, group))
            if data:
                offset = records.SummaryOffset(
                    group_opcode=opcode, group_start=start + len(summary), group_length=len(data)
                )
                offsets += _record(offset)
                summary += data
        offset_start = start + len(summary)
        whole = bytes(summary + offsets)
        self._write(whole)
        tail = _FOOTER.pack(Opcode.FOOTER, 8 + 8 + 4, start, offset_start)
        self._write(tail + struct.pack("<I", crc32(tail, crc32(whole))))
        self._write(MAGIC)

    def _statistics(self) -> records.Statistics:
        return records.Statistics(
            attachment_count=len(self._attachment_index),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunk_index),
            message_count=sum(self._counts.values()),
            metadata_count=len(self._metadata_index),
            message_start_time=self._start,
            message_end_time=self._end,
            schema_count=len(self._schemas),
        )

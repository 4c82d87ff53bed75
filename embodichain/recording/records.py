"""Records of an MCAP file, one after the other, from bytes that nobody vouches for.

No length that a file states is believed before it is compared with what is there, so memory stays
below a few times `CHUNK_LIMIT` and every loop ends with the bytes. What records mean is not known
here.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import Any, BinaryIO

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from isal.isal_zlib import crc32
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Message, Metadata, Schema, Statistics

from embodichain.recording.mcap_file import CHUNK_LIMIT, MAGIC

__all__ = [
    "CUT",
    "Block",
    "DamageError",
    "Record",
    "blocks",
    "chunk_content",
    "parse",
    "records_in_chunk",
]

CUT = "the file ends early: it was not closed, or cut"
CHECKSUM = "a chunk is damaged: its checksum is wrong"

Block = tuple[int, bytes]
"""An opcode and the record's bytes."""
Record = Schema | Channel | Message | Attachment | Metadata | Statistics

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQII")
_FOOTER = struct.Struct("<QQI")
_SKIPPED = frozenset(
    {
        *(Opcode.MESSAGE_INDEX, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX),
        *(Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET),
    }
)
_MAX_OPCODE = max(Opcode)
_PARSERS: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
}
_UNREADABLE = (
    *(McapError, struct.error, zlib.error, zstandard.ZstdError, UnicodeDecodeError),
    *(IndexError, KeyError, MemoryError, OverflowError, RuntimeError, ValueError),  # lz4's
)


class DamageError(Exception):
    """From here on the file cannot be read; the text says why."""


def blocks(stream: BinaryIO) -> Iterator[Block]:
    """Yield records after the magic up to the footer; indexes are passed over.

    Args:
        stream: A file, at its start. It may grow meanwhile.

    Raises:
        DamageError: If the file ends before its footer and magic, or what follows is no record, or
            the index at its end is damaged.
        OSError: If it cannot be read.
    """
    stream.seek(len(MAGIC))
    at, summary_at = len(MAGIC), 0
    size = os.fstat(stream.fileno()).st_size
    while True:
        head = stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise DamageError(CUT)
        opcode, length = _HEAD.unpack(head)
        if not opcode:
            raise DamageError("what follows is no record: zeros, perhaps after a power cut")
        end = at + _HEAD.size + length
        if end > size:
            size = os.fstat(stream.fileno()).st_size
            if end > size:
                raise DamageError(CUT)
        if opcode == Opcode.FOOTER:
            body = stream.read(length)
            _check_end(stream, body, at, summary_at)
            yield opcode, body
            return
        if opcode in _SKIPPED or opcode > _MAX_OPCODE:
            stream.seek(end)
        else:
            yield opcode, _whole(stream, length)
        if opcode == Opcode.DATA_END:
            summary_at = end
        at = end


def _whole(stream: BinaryIO, length: int) -> bytes:
    data = stream.read(length)
    if len(data) < length:  # somebody cut it while it was read
        raise DamageError(CUT)
    return data


def _check_end(stream: BinaryIO, footer: bytes, at: int, summary_at: int) -> None:
    """Check the closing magic, and the checksum of everything since the messages' end."""
    if stream.read(len(MAGIC)) != MAGIC:
        raise DamageError(CUT)
    if len(footer) != _FOOTER.size:
        raise DamageError("the index at its end is damaged")
    announced = _FOOTER.unpack(footer)[2]
    if not announced:
        return
    stream.seek(summary_at)
    crc, left = 0, at + _HEAD.size + _FOOTER.size - 4 - summary_at
    while left:
        piece = stream.read(min(left, 2**20))
        if not piece:
            raise DamageError(CUT)
        crc, left = crc32(piece, crc), left - len(piece)
    if crc != announced:
        raise DamageError("the index at its end is damaged: its checksum is wrong")


def chunk_content(data: bytes) -> tuple[str, bytes]:
    """Compression and unpacked records of a chunk.

    Raises:
        DamageError: If it cannot be unpacked, or is larger than any recorder makes it.
    """
    try:
        _, _, size, crc, name_length = _CHUNK.unpack_from(data)
        at = _CHUNK.size + name_length
        name = data[_CHUNK.size : at].decode()
        (packed_size,) = struct.unpack_from("<Q", data, at)
        if size > CHUNK_LIMIT:
            raise DamageError(f"a chunk announces {size} bytes; more than {CHUNK_LIMIT} are no log")
        packed = data[at + 8 :]
        if len(packed) != packed_size:
            raise DamageError("a chunk is damaged: its length is wrong")
        content = _unpack(name, packed, size)
    except _UNREADABLE as error:
        raise DamageError(f"a chunk is damaged ({_kind(error)})") from error
    if len(content) != size:
        raise DamageError("a chunk is damaged: its length is wrong")
    if crc and crc32(content) != crc:
        raise DamageError(CHECKSUM)
    return name or "none", content


def _unpack(name: str, packed: bytes, size: int) -> bytes:
    """Decompress to at most `size` bytes, whatever the compressed data say of themselves."""
    if name == "":
        return packed
    if name == "lz4":
        content: bytes = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size)
        return content
    if name == "zstd":
        stated = zstandard.frame_content_size(packed)
        if stated not in (size, -1):
            raise DamageError("a chunk is damaged: its length is wrong")
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    raise DamageError(f"a chunk has the compression {name[:20]!r}, which is not known")


def records_in_chunk(content: bytes) -> Iterator[Schema | Channel | Message]:
    """Yield what a chunk holds.

    Raises:
        DamageError: If its records do not fill it.
    """
    at, size = 0, len(content)
    while at < size:
        if size - at < _HEAD.size:
            raise DamageError("a chunk is damaged: a record is cut short")
        opcode, length = _HEAD.unpack_from(content, at)
        start = at + _HEAD.size
        at = start + length
        if at > size:
            raise DamageError("a chunk is damaged: a record is longer than the chunk")
        if opcode == Opcode.MESSAGE:
            yield _message(content, start, at)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            yield parse((opcode, content[start:at]))  # type: ignore[misc]
        else:
            raise DamageError(f"a chunk is damaged: it holds a record of kind {opcode}")


def _message(content: bytes, start: int, stop: int) -> Message:
    if stop - start < _MESSAGE.size:
        raise DamageError("a message is cut short")
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(content, start)
    data = content[start + _MESSAGE.size : stop]
    return Message(channel, log_time, data, publish_time, sequence)


def parse(block: Block) -> Record | None:
    """What a record outside of chunks is; None for kinds that replay has no use for.

    Raises:
        DamageError: If it is not what its opcode says.
    """
    opcode, data = block
    try:
        if opcode == Opcode.MESSAGE:
            return _message(data, 0, len(data))
        if opcode == Opcode.ATTACHMENT:
            return _attachment(data)
        if opcode in _PARSERS:
            record: Record = _PARSERS[opcode].read(ReadDataStream(BytesIO(data)))
            return record
    except _UNREADABLE as error:
        raise DamageError(f"a record is damaged ({_kind(error)})") from error
    return None


def _attachment(data: bytes) -> Attachment:
    (crc,) = struct.unpack_from("<I", data, len(data) - 4)
    if crc and crc32(memoryview(data)[:-4]) != crc:
        raise DamageError("an attachment is damaged: its checksum is wrong")
    attachment: Attachment = Attachment.read(ReadDataStream(BytesIO(data)))
    return attachment


def _kind(error: BaseException) -> str:
    text = " ".join(str(error).split())[:100]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__

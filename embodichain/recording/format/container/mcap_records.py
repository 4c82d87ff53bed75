"""Parses and unpacks records of an MCAP file; every failure is a `DamageError`."""

from __future__ import annotations

import struct
import zlib
from io import BytesIO
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema, Statistics

from embodichain.recording.format.log_error import LARGEST_CHUNK, DamageError

__all__ = ["LIBRARIES", "UNREADABLE", "chunk_content", "parse", "reason_of"]

LIBRARIES = ("embodichain", "embodichain recover")
"""Names of the programs that write logs, in the file's header: the recorder, and `recover`."""

UNREADABLE = (
    McapError,
    struct.error,
    zlib.error,
    zstandard.ZstdError,
    UnicodeDecodeError,
    # Those that lz4 raises:
    IndexError,
    KeyError,
    MemoryError,
    OverflowError,
    RuntimeError,
    ValueError,
)
"""Exceptions that damaged bytes cause in the libraries that read them."""
_PARSERS: dict[int, Any] = {
    Opcode.ATTACHMENT: Attachment,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.METADATA: Metadata,
    Opcode.SCHEMA: Schema,
    Opcode.STATISTICS: Statistics,
}


def chunk_content(data: bytes) -> tuple[str, bytes]:
    """Compression and decompressed records of a chunk.

    Raises:
        DamageError: If it cannot be decompressed, or exceeds `LARGEST_CHUNK`.
    """
    chunk: Chunk = parse(Opcode.CHUNK, data)
    name = chunk.compression
    size = chunk.uncompressed_size
    packed = chunk.data
    if size > LARGEST_CHUNK:
        raise DamageError(
            f"a chunk announces {size} bytes; a log has at most {LARGEST_CHUNK} in a chunk"
        )
    if len(data) != 40 + len(name.encode()) + len(packed):
        raise DamageError("a chunk is damaged: its length is wrong")
    try:
        content = _unpacked(name, packed, size)
    except UNREADABLE as error:
        raise DamageError(f"a chunk is damaged ({reason_of(error)})") from error
    if len(content) != size:
        raise DamageError("a chunk is damaged: its length is wrong")
    if zlib.crc32(content) != chunk.uncompressed_crc:  # zero, for none, is not a recorder's
        raise DamageError("a chunk is damaged: its checksum is wrong")
    return name or "none", content


def _unpacked(name: str, packed: bytes, size: int) -> bytes:
    """Decompress to at most `size` bytes, whatever size the compressed data declare."""
    if name == "":
        return packed
    stated = -1
    if name == "lz4":
        stated = lz4.frame.get_frame_info(packed)["content_size"] or -1
    elif name == "zstd":
        stated = zstandard.frame_content_size(packed)
    if stated not in (size, -1):
        raise DamageError("a chunk is damaged: its length is wrong")
    if name == "lz4":
        content: bytes = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size)
        return content
    if name == "zstd":
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    raise DamageError(f"a chunk has the compression {name[:20]!r}, which is not known")


def parse(opcode: int, data: bytes) -> Any:
    """Parse a record of this opcode.

    Raises:
        DamageError: If the bytes are not a record of this kind.
    """
    try:
        return _PARSERS[opcode].read(ReadDataStream(BytesIO(data)))
    except UNREADABLE as error:
        raise DamageError(f"a record is damaged ({reason_of(error)})") from error


def reason_of(error: BaseException) -> str:
    """Type and text of an exception, shortened."""
    text = " ".join(str(error).split())[:100]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__

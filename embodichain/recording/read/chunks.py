"""`LogReader`: the chunks, attachments and metadata of a log, in one file or several.

The file may be broken, or still growing: it is read up to the first damage, and `damage` gives the
reason. Every length in a file is checked against the bytes that are present, so memory stays below
a few times `LARGEST_CHUNK` and every loop ends at the end of the file.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, Self

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema, Statistics

from embodichain.recording.format.container.mcap_records import (
    UNREADABLE,
    chunk_content,
    parse,
    reason_of,
)
from embodichain.recording.format.header import (
    METADATA,
    METADATA_END,
    METADATA_RECOVERED,
    Header,
    check_part,
)
from embodichain.recording.format.log_error import LONGEST_CHUNK, DamageError, LogError
from embodichain.recording.format.parts import first_file, missing_part, part_name
from embodichain.recording.format.seals import SEAL, check_seal, digest_of
from embodichain.utils.errors import ConfigError
from embodichain.utils.short_repr import short_repr

__all__ = ["MAGIC", "ChunkPlace", "LogMessage", "LogReader"]

MAGIC = b"\x89MCAP0\r\n"
CUT = "the file ends early: it was not closed, or cut"
_INDEXED = (Opcode.METADATA, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)
"""Records outside of chunks whose content is kept."""
_INDEXED_LIMIT = 2**29
"""Bytes of the largest attachment or metadata record that is accepted."""
_SEALED = (METADATA_END, METADATA_RECOVERED)
"""Metadata records that have a digest if the header has one."""

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_FOOTER = struct.Struct("<QQI")
LogMessage = tuple[str, int, memoryview]
"""Topic, log time in ns, payload."""


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """The place of a chunk.

    Attributes:
        start_ns: Smallest log time in it.
        offset: Position of its record, after opcode and length.
        length: Bytes of the record.
        part: Index of the file that contains it, among those that were opened.
    """

    start_ns: int
    offset: int
    length: int
    part: int = 0


class _RecordPlace(NamedTuple):
    """The content of a record, after opcode and length.

    Attributes:
        offset: Its position in the file.
        length: Its bytes.
    """

    offset: int
    length: int


class _UnpackedChunk(NamedTuple):
    """A chunk and its messages; None if it is damaged."""

    place: ChunkPlace
    messages: list[LogMessage] | None


class LogReader:
    """Index and metadata of a log; messages are read from the file on demand.

    Args:
        path: The file, the manifest of several files, or a run's folder. The first of several
            files opens all of them; any other is read alone.

    Attributes:
        path: The first file that is read.
        chunks: Places of the chunks, in the order of the files.
        channels: Channel id to channel, from the index and the chunks read so far.
        schemas: Schema id to schema, likewise.
        metadata: Name -> content of the metadata records; `METADATA` is that of the first file,
            all others those of the last file.
        header: The metadata of the recording; None if there is none.
        finished: Whether the recorder closed the log.
        recovered: Why the log ends early, if it was recovered from a broken one.
        complete: Whether the file has its end, and all that was read is undamaged.
        damage: Why reading stops early; set when a damaged chunk is read.
        alone: Why this file is only a part of a log, if no part is lost.
        good_bytes: Number of bytes up to the end of the last undamaged record.
        total_bytes: Bytes of all files that were opened.
        compressions: Compressions of the chunks read so far.

    Raises:
        ConfigError: If the file is missing, empty or not MCAP.
        LogError: If its metadata is of another version, or damaged.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = first_file(path)
        if not self.path.is_file():
            reason = "is not a file" if self.path.exists() else "does not exist"
            raise ConfigError(f"{self.path} {reason}")
        self.chunks: list[ChunkPlace] = []
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.header: Header | None = None
        self.finished = False
        self.complete = False
        self.recovered = ""
        self.damage = ""
        self.alone = ""
        self.good_bytes = 0
        self.total_bytes = 0
        self.compressions: set[str] = set()
        self._streams: list[BinaryIO] = []
        self._file_offsets: list[int] = []  # bytes of the files before each
        self._next_file = ""  # the file that continues the last one
        self._last_introduced = -1  # the last file with the metadata of a part
        self._attachments: dict[str, _RecordPlace] = {}  # by name, all in the first file
        self._announced_messages = 0  # by the files' own statistics
        self._unpacked: _UnpackedChunk | None = None  # the chunk that was read last
        try:
            self._open(self.path)
            while self._walk() and self._next_file and self._open_next():
                pass
        except BaseException:
            self.close()
            raise

    def __repr__(self) -> str:
        """Return the path, what was found in the file, and whether it is complete."""
        return short_repr(
            self,
            str(self.path),
            chunks=len(self.chunks),
            channels=len(self.channels),
            complete=self.complete,
        )

    def _open(self, path: Path) -> None:
        self._streams.append(path.open("rb"))
        self._file_offsets.append(self.total_bytes)
        self.total_bytes += os.fstat(self._streams[-1].fileno()).st_size

    @property
    def files(self) -> list[Path]:
        """The files that were opened."""
        names = (part_name(self.path.name, part) for part in range(len(self._streams)))
        return [self.path.with_name(name) for name in names]

    def close(self) -> None:
        """Close the files."""
        for stream in self._streams:
            stream.close()

    def __enter__(self) -> Self:
        """Return the reader."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the files."""
        self.close()

    # -- the container -----------------------------------------------------------------------------

    def _open_next(self) -> bool:
        """Open the file that continues the log, if the log is read as a whole."""
        name = Path(self._next_file).name
        self._next_file = ""
        if self.require_header().part:
            self.alone = f"it continues in {name}"
            return False
        name = part_name(self.path.name, len(self._streams))
        path = self.path.with_name(name)
        if path.is_file():
            self.complete = False
            self.finished = False
            self._open(path)
            return True
        text, is_lost = missing_part(self.path, name)
        self.complete = not is_lost
        self.finished = not is_lost
        if is_lost:
            self.damage = text
        else:
            self.alone = text
        return False

    def _walk(self) -> bool:
        """Index the records of the last file; return whether it has its end."""
        part = len(self._streams) - 1
        magic = self._streams[-1].read(len(MAGIC))
        if magic != MAGIC:
            reason = "is not an MCAP file" if magic else "is empty"
            if not part:
                raise ConfigError(f"{self.path} {reason}")
            self._end_at_damage(part, CUT if MAGIC.startswith(magic) else reason)
            return False
        try:
            self._index_records(part)
        except DamageError as error:
            self._end_at_damage(part, str(error))
        except LogError as error:
            raise LogError(f"{self.path}: {error}") from error
        except UNREADABLE as error:
            self._end_at_damage(part, f"a record is damaged ({reason_of(error)})")
        return self.complete

    def _index_records(self, part: int) -> None:
        """Go from record to record, up to the footer."""
        stream = self._streams[part]
        first_chunk = len(self.chunks)
        at = len(MAGIC)
        summary_at = 0
        size = os.fstat(stream.fileno()).st_size
        while True:
            self.good_bytes = self._file_offsets[part] + at
            head = stream.read(_HEAD.size)
            if len(head) < _HEAD.size:
                raise DamageError(CUT)
            opcode, length = _HEAD.unpack(head)
            if not opcode:  # skipping zeros nine bytes at a time would take minutes
                raise DamageError("zeros follow instead of a record, perhaps after a power cut")
            at += _HEAD.size
            if length > size - at:
                raise DamageError(CUT)
            if opcode == Opcode.FOOTER:
                _check_end(stream, length, summary_at)
                self.complete = True
                self.good_bytes = self._file_offsets[part] + stream.tell()
                return
            before_chunks = len(self.chunks) == first_chunk
            self._index_record(opcode, _RecordPlace(at, length), part, before_chunks)
            at += length
            stream.seek(at)
            if opcode == Opcode.DATA_END:
                summary_at = at

    def _index_record(
        self, opcode: int, place: _RecordPlace, part: int, before_chunks: bool
    ) -> None:
        """Index a record.

        Args:
            opcode: Its kind.
            place: Its content, which the file's stream is about to read.
            part: The file.
            before_chunks: Whether the file has no chunk before it.
        """
        stream = self._streams[part]
        if opcode == Opcode.CHUNK:
            if place.length > LONGEST_CHUNK:
                raise DamageError(
                    f"a chunk has {place.length} bytes, at most {LONGEST_CHUNK} are read"
                )
            if before_chunks and part and self._last_introduced < part:
                raise DamageError("it does not say which log it is a part of")
            (start_ns,) = struct.unpack("<Q", stream.read(8))
            self.chunks.append(ChunkPlace(start_ns, place.offset, place.length, part))
        elif opcode == Opcode.ATTACHMENT and place.length < _INDEXED_LIMIT and not part:
            stream.seek(place.offset + 16)  # after log time and creation time
            (name_length,) = struct.unpack("<I", stream.read(4))
            if name_length > place.length:
                raise DamageError("a name is longer than its record")
            self._attachments[stream.read(name_length).decode()] = place
        elif opcode in _INDEXED and place.length < _INDEXED_LIMIT:
            self._add_record(parse(opcode, stream.read(place.length)), part)

    def _add_record(self, record: Any, part: int) -> None:
        if isinstance(record, Channel):  # the index repeats the channels of the chunks
            self.channels.setdefault(record.id, record)
        elif isinstance(record, Schema):
            self.schemas.setdefault(record.id, record)
        elif isinstance(record, Statistics):
            self._announced_messages += record.message_count
        else:
            self._add_metadata(record, part)

    def _add_metadata(self, record: Metadata, part: int) -> None:
        if record.name != METADATA:
            self._check_seal(record)
        if record.name != METADATA or not part:
            self.metadata[record.name] = record.metadata
        if record.name == METADATA:
            if part:
                check_part(self.require_header(), record.metadata, part)
            else:
                self.header = Header.from_metadata(record.metadata)
            self._last_introduced = part
        elif record.name == METADATA_END:
            self.finished = True
            self._next_file = record.metadata.get("next", "")
        elif record.name == METADATA_RECOVERED:
            self.recovered = record.metadata.get("why", "") or "no reason is given"

    def _check_seal(self, record: Metadata) -> None:
        """Raise `DamageError` if the digest of a metadata record is wrong, or was lost."""
        try:
            has_seal = check_seal(record.name, record.metadata)
        except DamageError as error:
            raise DamageError(f"the metadata record {record.name!r}: {error}") from error
        needs_seal = record.name in _SEALED and SEAL in self.metadata.get(METADATA, {})
        if needs_seal and not has_seal:
            raise DamageError(f"the metadata record {record.name!r} has no {SEAL!r}")

    def _end_at_damage(self, part: int, reason: str) -> None:
        """Note that reading ends in this file, and why."""
        self.complete = False
        self.damage = reason
        if part:
            self.damage = f"{self.files[part].name}: {reason}"

    def require_header(self) -> Header:
        """The metadata of the recording.

        Raises:
            LogError: If there is none: another program's MCAP file, or a truncated one.
        """
        if self.header is None:
            reason = f" ({self.damage})" if self.damage else ""
            raise LogError(f"{self.path} has no metadata record {METADATA!r}{reason}")
        return self.header

    @property
    def cut(self) -> str:
        """Why the end of the log may be missing; empty if it is not."""
        if not self.complete:
            return self.damage or "its end is missing"
        if self.finished or self.recovered:
            return ""
        return "the recorder did not close it"

    @property
    def part_note(self) -> str:
        """Which part of a log this is; empty if it is all of it, or if a part is lost."""
        return self.require_header().part_note(self.alone)

    @property
    def attachments(self) -> list[str]:
        """Names of the attachments."""
        return list(self._attachments)

    def attachment_record(self, name: str) -> Attachment:
        """An attachment with its media type and times.

        Raises:
            LogError: If there is no attachment of this name, or it is damaged.
        """
        if name not in self._attachments:
            available = ", ".join(self._attachments) or "none"
            raise LogError(f"{self.path} has no attachment {name}; there are: {available}")
        place = self._attachments[name]
        self._streams[0].seek(place.offset)
        data = self._streams[0].read(place.length)
        try:
            (crc,) = struct.unpack("<I", data[-4:])
            if zlib.crc32(memoryview(data)[:-4]) != crc:
                raise DamageError("an attachment is damaged: its checksum is wrong")
            record: Attachment = parse(Opcode.ATTACHMENT, data)
            listed = self.require_header().attachments
            if name in listed:
                _, digest = listed[name]
                if digest_of(record.data) != digest:
                    raise DamageError("an attachment is damaged: its digest is wrong")
        except (DamageError, struct.error) as error:
            raise LogError(f"{self.path}: {name}: {error}") from error
        return record

    def attachment(self, name: str) -> bytes:
        """Content of an attachment.

        Raises:
            LogError: If there is no attachment of this name, or it is damaged.
        """
        content: bytes = self.attachment_record(name).data
        return content

    # -- messages ----------------------------------------------------------------------------------

    def messages(self, chunks: list[ChunkPlace] | None = None) -> Iterator[LogMessage]:
        """Messages of some chunks, or of all, in file order; iteration ends at damage."""
        for messages in self.blocks(chunks):
            yield from messages

    def blocks(self, chunks: list[ChunkPlace] | None = None) -> Iterator[list[LogMessage]]:
        """Like `messages`, as one list for each chunk; if all are read, checks their number."""
        if chunks and not self.channels:  # no index; channels are declared when they are first used
            for chunk in self.chunks[: self.chunks.index(chunks[0])]:
                self._unpack(chunk)
        count = 0
        for chunk in self.chunks if chunks is None else chunks:
            messages = self._unpack(chunk)
            if messages is None:
                return
            count += len(messages)
            yield messages
        announced = self._announced_messages
        if chunks is None and self.complete and announced not in (0, count):
            self._end_at_damage(0, f"{count} messages where the file announces {announced}")

    def _unpack(self, chunk: ChunkPlace) -> list[LogMessage] | None:
        """The messages of a chunk; None if it is damaged. The last chunk is remembered."""
        if self._unpacked is None or self._unpacked.place is not chunk:
            self._unpacked = _UnpackedChunk(chunk, self._read(chunk))
        return self._unpacked.messages

    def _read(self, chunk: ChunkPlace) -> list[LogMessage] | None:
        stream = self._streams[chunk.part]
        stream.seek(chunk.offset)
        try:
            compression, data = chunk_content(stream.read(chunk.length))
            self.compressions.add(compression)
            return self._records(memoryview(data))
        except (DamageError, struct.error) as error:
            self._end_at_damage(chunk.part, str(error))
            self.good_bytes = self._file_offsets[chunk.part] + chunk.offset - _HEAD.size
            return None

    def _records(self, data: memoryview) -> list[LogMessage]:
        """The messages in an unpacked chunk; its channels and schemas are noted."""
        messages: list[LogMessage] = []
        at = 0
        size = len(data)
        topics = {i: channel.topic for i, channel in self.channels.items()}
        while at < size:
            opcode, length = _HEAD.unpack_from(data, at)
            at += _HEAD.size
            if length > size - at:
                raise DamageError("a chunk is damaged: a record is longer than the chunk")
            if opcode == Opcode.MESSAGE:
                if length < _MESSAGE.size:
                    raise DamageError("a message is cut short")
                channel, _, log_time, _ = _MESSAGE.unpack_from(data, at)
                if channel not in topics:
                    raise DamageError(f"a message belongs to channel {channel}, unknown here")
                payload = data[at + _MESSAGE.size : at + length]
                messages.append((topics[channel], log_time, payload))
            elif opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
                record = parse(opcode, bytes(data[at : at + length]))
                if isinstance(record, Channel):
                    self.channels[record.id] = record
                    topics[record.id] = record.topic
                else:
                    self.schemas[record.id] = record
            else:  # skipping a chunk of zeros nine bytes at a time would take minutes
                raise DamageError(f"a chunk is damaged: it contains a record of kind {opcode}")
            at += length
        return messages


def _check_end(stream: BinaryIO, length: int, summary_at: int) -> None:
    """Check footer, closing magic, and the checksum of everything since the messages' end."""
    footer_at = stream.tell()
    footer = stream.read(length)
    if stream.read(len(MAGIC)) != MAGIC:
        raise DamageError(CUT)
    if len(footer) != _FOOTER.size:
        raise DamageError("the index at its end is damaged")
    announced = _FOOTER.unpack(footer)[2]
    end = stream.tell()
    if announced:
        stream.seek(summary_at)
        crc = 0
        remaining = footer_at + _FOOTER.size - 4 - summary_at
        while remaining:
            piece = stream.read(min(remaining, 2**20))
            if not piece:
                raise DamageError(CUT)
            crc = zlib.crc32(piece, crc)
            remaining -= len(piece)
        if crc != announced:
            raise DamageError("the index at its end is damaged: its checksum is wrong")
    stream.seek(end)

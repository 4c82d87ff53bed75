"""Finds the chunks of a log without reading them, and takes messages out of one at a time.

The container is walked from record to record (https://mcap.dev/spec), skipping what chunks hold, so
that a whole file and one that was cut are found the same way, and a range of steps costs only the
chunks it lies in. What messages mean is not known here.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from embodichain.recording.header import (
    METADATA,
    METADATA_END,
    METADATA_RECOVERED,
    Header,
    LogError,
)
from embodichain.recording.mcap_file import MAGIC
from embodichain.recording.records import CUT, DamageError, chunk_content, parse
from embodichain.utils.errors import ConfigError

__all__ = ["ChunkFile", "ChunkPlace", "Found"]

_KEPT_LIMIT = 2**29
"""Bytes of the largest attachment or metadata record that is believed."""

_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQ")  # first and last log time, size
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_DAMAGE = (DamageError, struct.error, UnicodeDecodeError)

Found = tuple[str, int, memoryview]
"""Topic, log time in ns, payload."""


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """Where a chunk lies.

    Attributes:
        start_ns: Smallest log time in it.
        end_ns: Largest log time in it.
        size: Bytes it unpacks to.
        offset: Where its record begins, after opcode and length.
        length: Bytes of the record.
    """

    start_ns: int
    end_ns: int
    size: int
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
        self.recovered = ""
        """Why the file ends where it does, if it was recovered from a broken one."""
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
            if not opcode:  # zeros would take minutes, nine bytes at a time
                self.damage = "what follows is no record: zeros, perhaps after a power cut"
                return
            at += _HEAD.size
            if length > size - at:
                break
            try:
                self._note(opcode, at, length)
            except _DAMAGE as error:
                self.damage = f"a record is damaged ({error})"
                return
            if opcode == Opcode.FOOTER:
                self.complete = True
                return
            at += length
            self._stream.seek(at)
        self.damage = CUT

    def _note(self, opcode: int, at: int, length: int) -> None:
        """Take over what the record at `at` says."""
        if opcode == Opcode.CHUNK:
            start, end, size = _CHUNK.unpack(self._stream.read(_CHUNK.size))
            self.chunks.append(ChunkPlace(start, end, size, at, length))
        elif opcode == Opcode.METADATA and length < _KEPT_LIMIT:
            record: Any = parse((opcode, self._stream.read(length)))
            if record.name == METADATA:
                self.header = Header.from_metadata(record.metadata)
            elif record.name == METADATA_END:
                self.finished = True
            elif record.name == METADATA_RECOVERED:
                self.recovered = record.metadata.get("why", "") or "no reason is given"
        elif opcode == Opcode.ATTACHMENT and length < _KEPT_LIMIT:
            self._stream.seek(at + 16)  # after log time and creation time
            (n,) = struct.unpack("<I", self._stream.read(4))
            if n > length:
                raise DamageError("a name is longer than its record")
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
        try:
            record: Any = parse((Opcode.ATTACHMENT, self._stream.read(length)))
        except DamageError as error:
            raise LogError(f"{self.path}: {name}: {error}") from error
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
            _, data = chunk_content(self._stream.read(chunk.length))
            return self._records(memoryview(data))
        except (DamageError, struct.error) as error:
            self.complete, self.damage = False, str(error)
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
                raise DamageError("a chunk is damaged: a record is longer than the chunk")
            if opcode == 5:
                channel, _, log_time, _ = message(data, at)
                if channel not in topics:
                    raise DamageError(f"a message belongs to channel {channel}, unknown here")
                found.append((topics[channel], log_time, data[at + 22 : at + length]))
            elif opcode == Opcode.CHANNEL:
                record: Any = parse((opcode, bytes(data[at : at + length])))
                self.channels[record.id], topics[record.id] = record, record.topic
            elif opcode == Opcode.SCHEMA:
                schema: Any = parse((opcode, bytes(data[at : at + length])))
                self.schemas[schema.id] = schema
            else:  # zeros of a forged chunk would take minutes, nine bytes at a time
                raise DamageError(f"a chunk is damaged: it holds a record of kind {opcode}")
            at += length
        return found

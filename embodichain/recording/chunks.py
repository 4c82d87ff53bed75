"""Finds the chunks of a log without reading them, and takes messages out of one at a time.

The container is walked from record to record (https://mcap.dev/spec), skipping what chunks hold, so
that a whole file and one that was cut are found the same way, and a range of steps costs only the
chunks it lies in. What messages mean is not known here, but where a later file of a log (`parts`)
repeats what the simulation was.
"""

from __future__ import annotations

import math
import os
import struct
from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import accumulate
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
    check_part,
)
from embodichain.recording.mcap_file import MAGIC
from embodichain.recording.messages import is_start
from embodichain.recording.parts import first_file, missing_part, part_name
from embodichain.recording.records import CUT, DamageError, chunk_content, parse
from embodichain.recording.wire import WireError
from embodichain.utils.errors import ConfigError

__all__ = ["ChunkFile", "ChunkPlace", "Found"]

_KEPT_LIMIT = 2**29
"""Bytes of the largest attachment or metadata record that is believed."""

_WAITING = 50_000
"""Messages that wait for earlier ones at most: what a chunk says of its times may be wrong."""

_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQ")  # first and last log time, size
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time

Found = tuple[str, int, memoryview]
"""Topic, log time in ns, payload."""


class _UnknownChannelError(DamageError):
    """A message belongs to a channel that was not declared in what was read."""


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """Where a chunk lies.

    Attributes:
        start_ns: Smallest log time in it.
        end_ns: Largest log time in it.
        size: Bytes it unpacks to.
        offset: Where its record begins, after opcode and length.
        length: Bytes of the record.
        part: Number of the file it lies in, of those that were opened.
    """

    start_ns: int
    end_ns: int
    size: int
    offset: int
    length: int
    part: int = 0


class ChunkFile:
    """The chunks, attachments and metadata of a file; the messages are still in it.

    Args:
        path: The file, the manifest of several, or a run's folder. The first file of several stands
            for all of them; any other is read alone.

    Raises:
        ConfigError: If the file is missing, empty or not MCAP.
        LogError: If its metadata is of another version, or damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path = first_file(path)
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
        self.alone = ""
        """Why this file is only a part of a log, where nothing of it is lost."""
        self._attachments: dict[str, tuple[int, int]] = {}
        self._next = ""
        self._introduced = -1  # the last file that has said what it is
        self._learned = False  # whether chunks were read for their channels
        self._streams: list[BinaryIO] = []
        try:
            self._open(path)
            while self._walk() and self._next and self._go_on():
                pass
        except BaseException:
            self.close()
            raise

    def _open(self, path: Path) -> None:
        self._streams.append(path.open("rb"))
        self._stream = self._streams[-1]

    @property
    def files(self) -> list[Path]:
        """The files that were opened."""
        names = (part_name(self.path.name, part) for part in range(len(self._streams)))
        return [self.path.with_name(name) for name in names]

    def close(self) -> None:
        """Close the file."""
        for stream in self._streams:
            stream.close()

    # -- the container -----------------------------------------------------------------------------

    def _go_on(self) -> bool:
        """Open the file that continues the log, if this is to be read as a whole."""
        name, self._next = Path(self._next).name, ""
        if self.require_header().part:
            self.alone = f"it goes on in {name}"
            return False
        name = part_name(self.path.name, len(self._streams))
        path = self.path.with_name(name)
        if path.is_file():
            self.complete = self.finished = False
            self._open(path)
            return True
        says, lost = missing_part(self.path, name)
        self.complete, self.finished = not lost, not lost
        self.damage, self.alone = (says, "") if lost else ("", says)
        return False

    def _walk(self) -> bool:
        """Note what the last of the files holds; whether it has its end."""
        stream, first = self._stream, len(self._streams) == 1
        name, begins = Path(stream.name), len(self.chunks)
        prefix = "" if first else f"{name.name}: "
        magic = stream.read(len(MAGIC))
        if magic != MAGIC:
            what = "is empty" if not magic else "is not an MCAP file"
            if first:
                raise ConfigError(f"{self.path} {what}")
            self.damage = f"{prefix}{CUT if MAGIC.startswith(magic) else what}"
            return False
        size, at = os.fstat(stream.fileno()).st_size, len(MAGIC)
        while True:
            head = stream.read(_HEAD.size)
            if len(head) < _HEAD.size:
                break
            opcode, length = _HEAD.unpack(head)
            if not opcode:  # zeros would take minutes, nine bytes at a time
                self.damage = f"{prefix}what follows is no record: zeros, perhaps after a power cut"
                return False
            at += _HEAD.size
            if length > size - at:
                break
            try:
                self._note(opcode, at, length, len(self.chunks) == begins)
            except DamageError as error:
                self.damage = f"{prefix}{error}"
                return False
            except (struct.error, UnicodeDecodeError) as error:
                self.damage = f"{prefix}a record is damaged ({error})"
                return False
            if opcode == Opcode.FOOTER:
                self.complete = True
                return True
            at += length
            stream.seek(at)
        self.damage = f"{prefix}{CUT}"
        return False

    def _note(self, opcode: int, at: int, length: int, head: bool) -> None:
        """Take over what the record at `at` says."""
        stream, part = self._stream, len(self._streams) - 1
        if opcode == Opcode.CHUNK:
            if head and part and self._introduced < part:
                raise DamageError("it does not say which log it is a part of")
            start, end, size = _CHUNK.unpack(stream.read(_CHUNK.size))
            self.chunks.append(ChunkPlace(start, end, size, at, length, part))
        elif opcode == Opcode.METADATA and length < _KEPT_LIMIT:
            record: Any = parse((opcode, stream.read(length)))
            self._note_metadata(record, part)
        elif opcode == Opcode.ATTACHMENT and length < _KEPT_LIMIT and not part:
            stream.seek(at + 16)  # after log time and creation time
            (n,) = struct.unpack("<I", stream.read(4))
            if n > length:
                raise DamageError("a name is longer than its record")
            self._attachments[stream.read(n).decode()] = (at, length)

    def _note_metadata(self, record: Any, part: int) -> None:
        if record.name == METADATA:
            if part:
                check_part(self.require_header(), record.metadata, part)
            else:
                self.header = Header.from_metadata(record.metadata)
            self._introduced = part
        elif record.name == METADATA_END:
            self.finished = True
            self._next = record.metadata.get("next", "")
        elif record.name == METADATA_RECOVERED:
            self.recovered = record.metadata.get("why", "") or "no reason is given"

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
    def part_note(self) -> str:
        """Which part of a log this is, if it is not all of it and nothing is lost."""
        return self.require_header().part_note(self.alone)

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
        self._streams[0].seek(at)
        try:
            record: Any = parse((Opcode.ATTACHMENT, self._streams[0].read(length)))
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

    def messages_in_time(self, wanted: Callable[[str], bool]) -> Iterator[Found]:
        """Messages of the topics that are wanted, by log time: a file may hold them otherwise.

        Those of one time come as they lie in the file. What is damaged ends iteration.
        """
        later = [*accumulate((c.start_ns for c in reversed(self.chunks)), min)][::-1]
        waiting: list[Found] = []
        for number, found in enumerate(self.blocks()):
            waiting += [message for message in found if wanted(message[0])]
            waiting.sort(key=lambda message: message[1])
            more = number + 1 < len(later) and len(waiting) < _WAITING
            until = later[number + 1] if more else math.inf
            count = bisect_left(waiting, until, key=lambda message: message[1])
            yield from waiting[:count]
            del waiting[:count]
        yield from waiting

    def blocks(self, chunks: list[ChunkPlace] | None = None) -> Iterator[list[Found]]:
        """The same, a list for each chunk. Channels are declared in the first chunks."""
        if chunks and self.chunks and not self.channels:
            self._unpack(self.chunks[0])
        for chunk in self.chunks if chunks is None else chunks:
            found = self._unpack(chunk)
            if found is None:
                return
            yield _without_start(found) if chunk.part else found

    def _unpack(self, chunk: ChunkPlace) -> list[Found] | None:
        stream = self._streams[chunk.part]
        stream.seek(chunk.offset)
        try:
            _, data = chunk_content(stream.read(chunk.length))
            try:
                return self._records(memoryview(data))
            except _UnknownChannelError:
                if not self._learn(chunk):
                    raise
                return self._records(memoryview(data))
        except (DamageError, struct.error) as error:
            where = f"{Path(stream.name).name}: " if chunk.part else ""
            self.complete, self.damage = False, f"{where}{error}"
            return None

    def _learn(self, before: ChunkPlace) -> bool:
        """Read what precedes a chunk, once: channels may be declared when they are first used."""
        first, self._learned = not self._learned, True
        if first:
            for chunk in self.chunks[: self.chunks.index(before)]:
                self._unpack(chunk)
        return first

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
                    unknown = f"channel {channel}, unknown here"
                    raise _UnknownChannelError(f"a message belongs to {unknown}")
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


def _without_start(found: list[Found]) -> list[Found]:
    """Messages of a chunk of a later file without those that repeat what the simulation was."""
    kept: list[Found] = []
    for at, (topic, time_ns, payload) in enumerate(found):
        if topic == "/sim/write":
            try:
                if not is_start(payload):
                    return kept + found[at:]
            except WireError:
                return kept + found[at:]
        else:
            kept.append((topic, time_ns, payload))
    return kept

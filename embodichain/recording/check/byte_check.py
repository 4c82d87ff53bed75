"""`check_bytes`: whether every byte of a log is the one that its recorder wrote.

Each file is read once from its first byte to its last. Nothing in it is simulated or trusted.
What covers which bytes:

| bytes | what covers them |
|---|---|
| magic at both ends | they are compared |
| everything between the first and `DATA_END` | the checksum in `DATA_END` |
| attachments | their checksum; the digest that the metadata list |
| metadata | their digest |
| chunks | the checksum of their content; their times are those of their messages |
| message indexes | they are computed again from the chunk |
| the index at the end, the footer | the checksum in the footer |

So a file without an end has checksums and digests of all but its `HEADER`, and damage that only
the checksum of the whole shows can mostly be placed. Logs of versions up to 0.1.0 have neither
digests nor a checksum of everything: the bytes that they leave uncovered are counted.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata
from mcap.records import Header as FileHeader

from embodichain.recording.format.container.mcap_records import LIBRARIES, chunk_content, parse
from embodichain.recording.format.header import (
    METADATA,
    METADATA_END,
    METADATA_RECOVERED,
    Header,
    check_header,
)
from embodichain.recording.format.log_error import LONGEST_CHUNK, DamageError
from embodichain.recording.format.parts import first_file
from embodichain.recording.format.seals import SEAL, check_seal, digest_of
from embodichain.recording.read.chunks import MAGIC, LogReader

__all__ = ["ByteReport", "Damage", "check_bytes"]

_HEAD = struct.Struct("<BQ")
_TIMES = struct.Struct("<QQ")
_CRC = struct.Struct("<I")
_FOOTER = struct.Struct("<QQI")
_MESSAGE = struct.Struct("<HIQ")  # channel, sequence, log time
_INDEX_HEAD = struct.Struct("<HI")  # channel, bytes of the entries
_INDEX_ENTRY = struct.Struct("<QQ")  # log time, offset in the chunk
_LONGEST = {Opcode.CHUNK: LONGEST_CHUNK}
_LONGEST_OTHER = 2**31
_BEGIN = 256
"""Bytes in which the header is, with the name of the recorder."""
_MOST_NAMED = 5
"""Damaged records that a report names; it only counts the others."""
_SEALED = (METADATA_END, METADATA_RECOVERED)
"""Metadata records that have a digest if the header has one."""
_Index = dict[int, list[tuple[int, int]]]
"""Channel to log time and offset of each of its messages in a chunk."""


@dataclass(frozen=True, slots=True)
class Damage:
    """A part of a file whose bytes are not those that were written.

    Attributes:
        file: The file's name.
        kind: Kind of the record: ``metadata``, ``attachment``, ``chunk``, ``message index``, ...
        name: Its name, or its number within the file; empty if a file has only one of the kind.
        offset: Its first byte in the file.
        nbytes: Its bytes, those that one checksum covers together.
        why: How the damage shows.
    """

    file: str
    kind: str
    name: str
    offset: int
    nbytes: int
    why: str

    def __str__(self) -> str:
        """Return which record it is, where, and why."""
        record = f"{self.kind} {self.name}".rstrip()
        return f"{record} at byte {self.offset} ({self.why})"


@dataclass(slots=True)
class ByteReport:
    """Result of `check_bytes`.

    Attributes:
        nbytes: Bytes that were read.
        damage: The damaged parts, in the order of the files.
        uncovered: Bytes that nothing covers: headers and metadata of earlier versions.
        unsealed: Whether the log's metadata have no digest: an earlier version wrote them.
    """

    nbytes: int = 0
    damage: list[Damage] = field(default_factory=list)
    uncovered: int = 0
    unsealed: bool = False

    @property
    def problem(self) -> str:
        """What is damaged and where, in one line; empty if nothing is."""
        if not self.damage:
            return ""
        is_in_several_files = len({damage.file for damage in self.damage}) > 1
        parts = []
        for damage in self.damage[:_MOST_NAMED]:
            parts.append(f"{damage.file}: {damage}" if is_in_several_files else str(damage))
        if len(self.damage) > _MOST_NAMED:
            parts.append(f"and {len(self.damage) - _MOST_NAMED} more")
        nbytes = sum(damage.nbytes for damage in self.damage)
        return f"{nbytes} bytes of the file are damaged: {'; '.join(parts)}"

    @property
    def note(self) -> str:
        """What this check could not see, in one line; empty if it covers every byte."""
        if not self.unsealed:
            return ""
        reason = "an earlier version wrote this log, whose metadata have no digest"
        if not self.uncovered:
            return f"{reason}: a change before it was recovered is not found"
        return f"{reason}: a change in {self.uncovered} bytes of metadata and headers is not found"


def check_bytes(path: str | Path) -> ByteReport:
    """Read every byte of a log and compare it with the checksums and digests in it.

    A file that only ends early is not damaged: the bytes that it has are checked.

    Args:
        path: A file, the manifest of several files, or a run's folder.

    Raises:
        ConfigError: If the file is missing, empty or not MCAP.
        LogError: If it has no metadata of a log, or those of another version.
    """
    first = first_file(path)
    report = ByteReport()
    if first.is_file():
        file = _File(first, report)
        file.check()
        if report.damage and not file.looks_like_a_log:
            with LogReader(first) as reader:
                reader.require_header()  # another program's file is not a damaged log
    if report.damage:
        return report
    with LogReader(path) as reader:  # the first file's metadata are as they were written
        for later in reader.files[1:]:
            _File(later, report).check()
    return report


class _Attached(NamedTuple):
    """An attachment in a file.

    Attributes:
        offset: First byte of its record.
        nbytes: Bytes of its record.
        digest: Digest of its content.
    """

    offset: int
    nbytes: int
    digest: str


class _File:
    """One file of a log.

    Args:
        path: The file.
        report: The damage is added to it.

    Attributes:
        looks_like_a_log: Whether it has a metadata record, or the recorder's name at the beginning.
    """

    def __init__(self, path: Path, report: ByteReport) -> None:
        self._path = path
        self._report = report
        self._damage: list[Damage] = []
        self.looks_like_a_log = False
        # The header, and metadata without a digest: only the checksum of everything covers them.
        self._header_bytes = 0
        self._header_is_ours = False
        self._unsealed_bytes = 0
        self._is_sealed: bool | None = None  # whether the log's metadata have a digest
        # Attachments: what the metadata list, and what is in the file.
        self._listed: dict[str, tuple[int, str]] = {}
        self._attached: dict[str, list[_Attached]] = defaultdict(list)
        # The last chunk. Entries leave the index when their message index was found; None if the
        # chunk or one of its indexes is damaged.
        self._num_chunks = 0
        self._chunk_at = 0
        self._index: _Index | None = {}
        # The checksum of everything before DATA_END: computed, and stated there if at all.
        self._crc = 0
        self._stated_crc: int | None = None
        self._data_end_at = 0

    def check(self) -> None:
        """Read the file, and add damage and uncovered bytes to the report."""
        with self._path.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            closed = self._ends_with_magic(stream, size)
            stream.seek(0)
            self.looks_like_a_log = LIBRARIES[0].encode() in stream.read(_BEGIN)
            stream.seek(0)
            magic = stream.read(len(MAGIC))
            if magic == MAGIC or closed:
                self._crc = zlib.crc32(magic)
                if magic != MAGIC:
                    self._add(
                        "opening magic", offset=0, nbytes=len(MAGIC), why="it is not that of MCAP"
                    )
                self._records(stream, size, closed)
        self._compare_attachments()
        self._check_whole()
        self._report.nbytes += size
        self._report.damage += self._damage
        self._report.unsealed |= self._is_sealed is False

    @staticmethod
    def _ends_with_magic(stream: BinaryIO, size: int) -> bool:
        stream.seek(max(0, size - len(MAGIC)))
        return stream.read(len(MAGIC)) == MAGIC and size > len(MAGIC)

    def _add(self, kind: str, *, name: str = "", offset: int, nbytes: int, why: str) -> None:
        damage = Damage(
            file=self._path.name,
            kind=kind,
            name=name,
            offset=offset,
            nbytes=nbytes,
            why=why,
        )
        self._damage.append(damage)

    def _records(self, stream: BinaryIO, size: int, closed: bool) -> None:
        """Check record after record up to the footer, or to where a broken file ends."""
        first = True
        while True:
            at = stream.tell()
            head = stream.read(_HEAD.size)
            if len(head) < _HEAD.size:
                if closed:
                    self._add("record", offset=at, nbytes=len(head), why="a footer should be here")
                return
            opcode, length = _HEAD.unpack(head)
            longest = _LONGEST.get(opcode, _LONGEST_OTHER)
            if not opcode or length > size - at - _HEAD.size:
                # Otherwise the file was cut here.
                if closed or length > longest:
                    why = f"it says that its kind is {opcode} and that it has {length} bytes"
                    self._add("head of a record", offset=at, nbytes=_HEAD.size, why=why)
                return
            if length > longest:
                self._add(
                    "record",
                    offset=at,
                    nbytes=length,
                    why=f"{length} bytes are more than a log has",
                )
                return
            if first and opcode != Opcode.HEADER:
                self._add(
                    "head of a record",
                    offset=at,
                    nbytes=_HEAD.size,
                    why="the first one is the header",
                )
                return
            data = stream.read(length)
            if opcode == Opcode.DATA_END:
                self._data_end(at, data)
                self._summary(stream, size, closed)
                return
            self._crc = zlib.crc32(data, zlib.crc32(head, self._crc))
            self._record(opcode, at, data, first)
            first = False

    def _record(self, opcode: int, at: int, data: bytes, first: bool) -> None:
        """Check a record of the data section."""
        if opcode == Opcode.MESSAGE_INDEX:
            self._message_index(at, data)
            return
        self._end_of_indexes()
        if opcode == Opcode.HEADER and first:
            self._file_header(data)
        elif opcode == Opcode.ATTACHMENT:
            self._attachment(at, data)
        elif opcode == Opcode.METADATA:
            self._metadata(at, data)
        elif opcode == Opcode.CHUNK:
            self._chunk(at, data)
        else:
            why = f"a record of kind {opcode}, which no log has here"
            self._add("record", offset=at, nbytes=_HEAD.size + len(data), why=why)

    def _file_header(self, data: bytes) -> None:
        recorders_headers = [_encoded(FileHeader("", library)) for library in LIBRARIES]
        self._header_is_ours = data in recorders_headers
        self._header_bytes = len(data)

    def _attachment(self, at: int, data: bytes) -> None:
        nbytes = _HEAD.size + len(data)
        if zlib.crc32(memoryview(data)[:-4]) != int.from_bytes(data[-4:], "little"):
            self._add(
                "attachment",
                name=_name_in(data, 16),
                offset=at,
                nbytes=nbytes,
                why="its checksum is wrong",
            )
            return
        try:
            record: Attachment = parse(Opcode.ATTACHMENT, data)
        except DamageError as error:
            self._add("attachment", offset=at, nbytes=nbytes, why=str(error))
            return
        attached = _Attached(at, nbytes, digest_of(record.data))
        self._attached[record.name].append(attached)

    def _compare_attachments(self) -> None:
        """Compare the attachments with the list in the metadata."""
        damaged = {damage.name for damage in self._damage if damage.kind == "attachment"}
        for name, (_, digest) in self._listed.items():
            records = self._attached[name]
            for record in records:
                if record.digest != digest:
                    why = "its digest is wrong"
                    self._add(
                        "attachment",
                        name=repr(name),
                        offset=record.offset,
                        nbytes=record.nbytes,
                        why=why,
                    )
            if not records and repr(name) not in damaged:
                why = "the metadata list it, but it is missing"
                self._add("attachment", name=repr(name), offset=0, nbytes=0, why=why)

    def _metadata(self, at: int, data: bytes) -> None:
        nbytes = _HEAD.size + len(data)
        name = _name_in(data, 0)
        self.looks_like_a_log = True
        try:
            record: Metadata = parse(Opcode.METADATA, data)
            if _encoded(record) != data:
                raise DamageError("its lengths are wrong")
            if record.name == METADATA:
                has_seal = check_header(record.metadata)
                self._is_sealed = has_seal
                if has_seal:
                    self._listed = Header.from_metadata(record.metadata).attachments
            else:
                has_seal = check_seal(record.name, record.metadata)
                if self._is_sealed and not has_seal and record.name in _SEALED:
                    raise DamageError(f"it has no {SEAL!r}")
        except DamageError as error:
            self._add("metadata", name=name, offset=at, nbytes=nbytes, why=str(error))
            return
        if not has_seal:
            self._unsealed_bytes += len(data)

    def _chunk(self, at: int, data: bytes) -> None:
        number = str(self._num_chunks)
        self._chunk_at = at
        self._num_chunks += 1
        try:
            _, content = chunk_content(data)
            index = _index_of(content)
            times = [time_ns for entries in index.values() for time_ns, _ in entries]
            if not times:
                times = [0]  # as the MCAP specification says
            if _TIMES.unpack_from(data) != (min(times), max(times)):
                raise DamageError("its times are not those of its messages")
        except (DamageError, struct.error) as error:
            self._add(
                "chunk", name=number, offset=at, nbytes=_HEAD.size + len(data), why=str(error)
            )
            self._index = None  # its message indexes cannot be checked
            return
        self._index = index

    def _message_index(self, at: int, data: bytes) -> None:
        """Compare a message index with the chunk that it follows."""
        if self._index is None:
            return
        nbytes = _HEAD.size + len(data)
        try:
            channel, length = _INDEX_HEAD.unpack_from(data)
            entries = list(_INDEX_ENTRY.iter_unpack(data[_INDEX_HEAD.size :]))
        except struct.error:
            channel = -1
            length = 0
            entries = []
        has_right_length = length == len(data) - _INDEX_HEAD.size
        if not has_right_length or self._index.pop(channel, None) != entries:
            self._add(
                "message index",
                offset=at,
                nbytes=nbytes,
                why="it is not that of the chunk before it",
            )
            self._index = None

    def _end_of_indexes(self) -> None:
        """After the last index of a chunk: every channel in it must have had one."""
        if self._index:
            channels = ", ".join(map(str, self._index))
            why = f"there is none of channel {channels} of the chunk"
            self._add("message index", offset=self._chunk_at, nbytes=0, why=why)
        self._index = {}

    def _data_end(self, at: int, data: bytes) -> None:
        self._end_of_indexes()
        self._data_end_at = at
        if len(data) == _CRC.size:
            (self._stated_crc,) = _CRC.unpack(data)
        else:
            self._add(
                "DATA_END", offset=at, nbytes=_HEAD.size + len(data), why="its length is wrong"
            )

    def _check_whole(self) -> None:
        """Check the bytes that only the checksum of everything covers, and count uncovered ones.

        That checksum does not show where the damage is, so it is reported only if nothing else
        shows the damage.
        """
        if not self._stated_crc and not self._is_sealed:
            self._report.uncovered += self._header_bytes + self._unsealed_bytes
            return
        if self._stated_crc == self._crc or self._damage:
            return
        at = self._data_end_at
        if not self._header_is_ours:
            nbytes = _HEAD.size + self._header_bytes
            self._add(
                "header", offset=len(MAGIC), nbytes=nbytes, why="it is not that of a recorder"
            )
        elif self._stated_crc == 0:
            self._add(
                "DATA_END", offset=at, nbytes=_HEAD.size + _CRC.size, why="it has no checksum"
            )
        elif self._stated_crc is not None:
            nbytes = at + _HEAD.size + _CRC.size
            why = "its checksum is wrong, although that of each record in it is right"
            self._add("data section", offset=0, nbytes=nbytes, why=why)

    def _summary(self, stream: BinaryIO, size: int, closed: bool) -> None:
        """Check the index at the end, the footer, and that nothing follows."""
        begin = stream.tell()
        crc = 0
        while True:
            at = stream.tell()
            head = stream.read(_HEAD.size)
            opcode = 0
            length = 0
            if len(head) == _HEAD.size:
                opcode, length = _HEAD.unpack(head)
            if not opcode or length > size - at - _HEAD.size or length > _LONGEST_OTHER:
                if closed:
                    self._add(
                        "index",
                        offset=begin,
                        nbytes=size - begin,
                        why="a record in it has a wrong head",
                    )
                return
            data = stream.read(length)
            if opcode == Opcode.FOOTER:
                break
            crc = zlib.crc32(data, zlib.crc32(head, crc))
        if length != _FOOTER.size:
            self._add("footer", offset=at, nbytes=_HEAD.size + length, why="its length is wrong")
            return
        crc = zlib.crc32(data[: -_CRC.size], zlib.crc32(head, crc))
        if crc != _FOOTER.unpack(data)[2]:
            nbytes = at + _HEAD.size + length - begin
            self._add(
                "index and footer", offset=begin, nbytes=nbytes, why="their checksum is wrong"
            )
        end = stream.tell()
        magic = stream.read(len(MAGIC))
        if len(magic) == len(MAGIC) and magic != MAGIC:
            self._add("closing magic", offset=end, nbytes=len(MAGIC), why="it is not that of MCAP")
        remaining = size - stream.tell()
        if remaining and magic == MAGIC:
            self._add("rest", offset=stream.tell(), nbytes=remaining, why="the file ends before it")


def _encoded(record: Metadata | FileHeader) -> bytes:
    """The content of a record as the `mcap` library writes it."""
    builder: Any = RecordBuilder()
    record.write(builder)
    content: bytes = builder.end()
    return content[_HEAD.size :]


def _name_in(data: bytes, at: int) -> str:
    """The text whose length is at `at`, for a message; empty if there cannot be one."""
    try:
        (length,) = struct.unpack_from("<I", data, at)
        name = data[at + 4 : at + 4 + length].decode()
    except (struct.error, UnicodeDecodeError):
        return ""
    return repr(name) if length < 200 else ""


def _index_of(content: bytes) -> _Index:
    """Channel to log time and offset of its messages in a chunk.

    Raises:
        DamageError: If the chunk contains records that no log has in chunks.
    """
    index: _Index = defaultdict(list)
    at = 0
    size = len(content)
    while at < size:
        opcode, length = _HEAD.unpack_from(content, at)
        if length > size - at - _HEAD.size:
            raise DamageError("a record in it is longer than the chunk")
        if opcode == Opcode.MESSAGE:
            channel, _, time_ns = _MESSAGE.unpack_from(content, at + _HEAD.size)
            index[channel].append((time_ns, at))
        elif opcode not in (Opcode.CHANNEL, Opcode.SCHEMA):
            raise DamageError(f"it contains a record of kind {opcode}")
        at += _HEAD.size + length
    return dict(index)

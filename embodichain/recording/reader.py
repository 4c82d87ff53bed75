"""Reads a log from front to back, also one that ends in the middle; nothing in it is executed.

Files in which a log goes on are read as one: see `parts`.

Only records come out here: how they are parsed safely is `records`, what they mean is known in
`summary` and `replay`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Message, Metadata, Schema, Statistics

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
from embodichain.recording.records import (
    DamageError,
    Record,
    blocks,
    chunk_content,
    parse,
    records_in_chunk,
)
from embodichain.recording.wire import WireError
from embodichain.utils.errors import ConfigError

__all__ = ["LogReader"]


@dataclass
class LogReader:
    """One pass over a log, in the order in which it was written.

    Chunks are read one at a time, so memory does not grow with the file. Where the file is damaged
    or ends early, iteration stops and `damage` says why; CRCs vouch for what came before.

    Args:
        path: The file, the manifest of several, or a run's folder. The first file of several stands
            for all of them; any other is read alone.

    Raises:
        ConfigError: If the file is missing, empty or not MCAP.
    """

    path: Path
    channels: dict[int, Channel] = field(default_factory=dict, init=False)
    schemas: dict[int, Schema] = field(default_factory=dict, init=False)
    attachments: dict[str, bytes] = field(default_factory=dict, init=False)
    header: Header | None = field(default=None, init=False)
    statistics: Statistics | None = field(default=None, init=False)
    compressions: set[str] = field(default_factory=set, init=False)
    finished: bool = field(default=False, init=False)
    """Whether the recorder closed the log itself."""
    recovered: str = field(default="", init=False)
    """Why the file ends where it does, if it was saved from a broken one; see `recover`."""
    complete: bool = field(default=False, init=False)
    """Whether the file has its end and all that was announced; known after the last message."""
    damage: str = field(default="", init=False)
    good_bytes: int = field(default=0, init=False)
    """Bytes from the start up to the end of the last record that was good."""
    total_bytes: int = field(default=0, init=False)
    """Bytes of all files that were opened."""
    files: list[Path] = field(default_factory=list, init=False)
    """Files that were opened."""
    alone: str = field(default="", init=False)
    """Why this file is only a part of a log, where nothing of it is lost; known at the end."""

    def __post_init__(self) -> None:
        self.path = first_file(self.path)
        if not self.path.is_file():
            what = "is not a file" if self.path.exists() else "does not exist"
            raise ConfigError(f"{self.path} {what}")
        self._stream: BinaryIO = self._opened(self.path)
        magic = self._stream.read(len(MAGIC))
        if magic != MAGIC:
            self.close()
            what = "is empty" if not magic else "is not an MCAP file"
            raise ConfigError(f"{self.path} {what}")
        self._next = ""  # the file that continues this one
        self._introduced = False  # whether the file that is open has said what it is

    def _opened(self, path: Path) -> BinaryIO:
        stream = path.open("rb")
        self.files.append(path)
        self.total_bytes += path.stat().st_size
        return stream

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def __enter__(self) -> LogReader:
        """Return the reader."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        tb: TracebackType | None,
    ) -> None:
        """Close the file."""
        self.close()

    def messages(self) -> Iterator[tuple[str, Message]]:
        """Yield (topic, message) in file order.

        Raises:
            LogError: If the file is not a log of embodichain's that this version reads.
        """
        for record in self.records():
            if isinstance(record, Message):
                yield self.channels[record.channel_id].topic, record

    def records(self) -> Iterator[Record]:
        """Yield everything that was recorded, in file order: messages, and what belongs to them.

        Raises:
            LogError: As `messages` does.
        """
        self.good_bytes = before = 0
        while True:
            try:
                yield from self._file_records(before)
            except DamageError as error:
                where = f"{self.files[-1].name}: " if len(self.files) > 1 else ""
                self.complete, self.damage = False, f"{where}{error}"
            except OSError as error:
                self.complete, self.damage = False, f"the disk could not be read ({error})"
            before = self.good_bytes
            if not self.complete or not self._next or not self._go_on():
                return

    def _file_records(self, before: int) -> Iterator[Record]:
        """Everything in the file that is open; of a later one not what the first has said."""
        read, first, self.complete = 0, len(self.files) == 1, False
        starts = not first
        for block in blocks(self._stream):
            for record in self._open(block):
                if isinstance(record, Message):
                    if record.channel_id not in self.channels:
                        unknown = f"channel {record.channel_id}, unknown here"
                        raise DamageError(f"a message belongs to {unknown}")
                    if not (first or self._introduced):
                        raise DamageError("it does not say which log it is a part of")
                    read += 1
                    starts = starts and self._is_start(record)
                    if starts and self._is_write(record):
                        continue
                elif not self._take(record, first):
                    continue
                yield record
            self.complete = block[0] == Opcode.FOOTER
            self.good_bytes = before + self._stream.tell()
        self._check_count(read)

    def _is_write(self, message: Message) -> bool:
        return self.channels[message.channel_id].topic == "/sim/write"

    def _is_start(self, message: Message) -> bool:
        """Whether a later file may still be repeating what the simulation was at its start."""
        try:
            return not self._is_write(message) or is_start(message.data)
        except WireError:
            return False

    def _go_on(self) -> bool:
        """Open the file that continues the log, if this is to be read as a whole."""
        header, name = self.require_header(), self._next
        self._next = ""
        if header.part:
            self.alone = f"it goes on in {Path(name).name}"
            return False
        name = part_name(self.path.name, len(self.files))
        path = self.path.with_name(name)
        if not path.is_file():
            says, lost = missing_part(self.path, name)
            self.complete, self.finished = not lost, not lost
            self.damage, self.alone = (says, "") if lost else ("", says)
            return False
        self._stream.close()
        self._stream = self._opened(path)
        self.complete = self.finished = self._introduced = False
        self.statistics = None
        return True

    def _continues(self) -> bool:
        """Whether the end of this file is not the end of what is read."""
        if not self._next or self.require_header().part:
            return False
        name = part_name(self.path.name, len(self.files))
        return self.path.with_name(name).is_file() or missing_part(self.path, name)[1]

    def _open(self, block: tuple[int, bytes]) -> Iterator[Record]:
        """The records of one block; those of a chunk."""
        if block[0] == Opcode.CHUNK:
            compression, content = chunk_content(block[1])
            self.compressions.add(compression)
            yield from records_in_chunk(content)
            return
        record = parse(block)
        if record is not None:
            yield record

    def _take(self, record: Record, first: bool) -> bool:
        """Remember what a record says; whether it is news, and not only another file's."""
        # The index repeats schemas and channels; what stood with the messages counts.
        if isinstance(record, Channel):
            self.channels.setdefault(record.id, record)
        elif isinstance(record, Schema):
            self.schemas.setdefault(record.id, record)
        elif isinstance(record, Attachment):
            if first:
                self.attachments[record.name] = record.data
            return first
        elif isinstance(record, Metadata):
            return self._take_metadata(record, first)
        elif isinstance(record, Statistics):
            self.statistics = record
        return True

    def _take_metadata(self, record: Metadata, first: bool) -> bool:
        if record.name == METADATA:
            if first:
                self.header = Header.from_metadata(record.metadata)
            else:
                check_part(self.require_header(), record.metadata, len(self.files) - 1)
            self._introduced = True
            return first
        if record.name == METADATA_END:
            self.finished = True
            self._next = record.metadata.get("next", "")
            return not self._continues()
        if record.name == METADATA_RECOVERED:
            self.recovered = record.metadata.get("why", "") or "no reason is given"
        return True

    @property
    def part_note(self) -> str:
        """Which part of a log was read, if it is not all of it and nothing is lost; at the end."""
        return self.header.part_note(self.alone) if self.header is not None else ""

    def _check_count(self, read: int) -> None:
        if self.statistics is not None and self.statistics.message_count != read:
            self.complete = False
            self.damage = (
                f"{read} messages where the file announces {self.statistics.message_count}"
            )

    def require_header(self) -> Header:
        """The metadata of the recording.

        Raises:
            LogError: If there is none: another program's MCAP, or a file cut before it.
        """
        if self.header is None:
            why = f" ({self.damage})" if self.damage else ""
            raise LogError(f"{self.path} has no metadata record {METADATA!r}{why}")
        return self.header

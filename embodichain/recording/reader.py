"""Reads a log from front to back, also one that ends in the middle; nothing in it is executed.

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
)
from embodichain.recording.mcap_file import MAGIC
from embodichain.recording.records import (
    DamageError,
    Record,
    blocks,
    chunk_content,
    parse,
    records_in_chunk,
)
from embodichain.utils.errors import ConfigError

__all__ = ["LogReader"]


@dataclass
class LogReader:
    """One pass over a log, in the order in which it was written.

    Chunks are read one at a time, so memory does not grow with the file. Where the file is damaged
    or ends early, iteration stops and `damage` says why; CRCs vouch for what came before.

    Args:
        path: The file.

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

    def __post_init__(self) -> None:
        self.path = Path(self.path)
        if not self.path.is_file():
            what = "is not a file" if self.path.exists() else "does not exist"
            raise ConfigError(f"{self.path} {what}")
        self._stream: BinaryIO = self.path.open("rb")
        magic = self._stream.read(len(MAGIC))
        if magic != MAGIC:
            self.close()
            what = "is empty" if not magic else "is not an MCAP file"
            raise ConfigError(f"{self.path} {what}")
        self._stream.seek(0)

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
        read = 0
        try:
            for block in blocks(self._stream):
                for record in self._open(block):
                    if isinstance(record, Message):
                        if record.channel_id not in self.channels:
                            unknown = f"channel {record.channel_id}, unknown here"
                            raise DamageError(f"a message belongs to {unknown}")
                        read += 1
                    else:
                        self._take(record)
                    yield record
                self.complete = block[0] == Opcode.FOOTER
                self.good_bytes = self._stream.tell()
        except DamageError as error:
            self.complete, self.damage = False, str(error)
        except OSError as error:
            self.complete, self.damage = False, f"the disk could not be read ({error})"
        else:
            self._check_count(read)

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

    def _take(self, record: Record) -> None:
        # The index repeats schemas and channels; what stood with the messages counts.
        if isinstance(record, Channel):
            self.channels.setdefault(record.id, record)
        elif isinstance(record, Schema):
            self.schemas.setdefault(record.id, record)
        elif isinstance(record, Attachment):
            self.attachments[record.name] = record.data
        elif isinstance(record, Metadata):
            self._take_metadata(record)
        elif isinstance(record, Statistics):
            self.statistics = record

    def _take_metadata(self, record: Metadata) -> None:
        if record.name == METADATA:
            self.header = Header.from_metadata(record.metadata)
        elif record.name == METADATA_END:
            self.finished = True
        elif record.name == METADATA_RECOVERED:
            self.recovered = record.metadata.get("why", "") or "no reason is given"

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

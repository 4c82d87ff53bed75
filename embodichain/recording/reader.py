"""Reads a log from front to back, also one that ends in the middle; nothing in it is executed.

Only records come out here: what they mean is known in `summary` and `verify`.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

import zstandard
from mcap.exceptions import McapError, RecordLengthLimitExceeded, UnsupportedCompressionError
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    DataEnd,
    Footer,
    Message,
    Metadata,
    Schema,
    Statistics,
)
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk

from embodichain.recording.header import METADATA, METADATA_END, Header, LogError
from embodichain.recording.mcap_file import MAGIC
from embodichain.utils.errors import ConfigError

__all__ = ["LogReader"]

RECORD_LIMIT = 2**31
"""Bytes of the largest record that is believed; a longer one is damage."""

_DAMAGE = (
    McapError,
    CRCValidationError,
    struct.error,
    zlib.error,
    zstandard.ZstdError,
    EOFError,
    IndexError,
    KeyError,
    MemoryError,
    OverflowError,
    RuntimeError,  # lz4's
    UnicodeDecodeError,
)


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
    complete: bool = field(default=False, init=False)
    """Whether the file has its end and all that was announced; known after the last message."""
    damage: str = field(default="", init=False)

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
        read = 0
        records = StreamReader(
            self._stream, emit_chunks=True, record_size_limit=RECORD_LIMIT
        ).records
        while True:
            try:
                record = next(records, None)
                if record is None:
                    break
                found = breakup_chunk(record, True) if isinstance(record, Chunk) else [record]
            except _DAMAGE as error:
                self.complete, self.damage = False, _describe(error)
                return
            if isinstance(record, Chunk):
                self.compressions.add(record.compression or "none")
            for item in found:
                if not isinstance(item, Message):
                    self._take(item)
                    continue
                channel = self.channels.get(item.channel_id)
                if channel is None:
                    self.damage = f"a message belongs to channel {item.channel_id}, unknown here"
                    return
                read += 1
                yield channel.topic, item
        self._check_count(read)

    def _take(self, record: object) -> None:
        if isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Attachment):
            self.attachments[record.name] = record.data
        elif isinstance(record, Metadata):
            self._take_metadata(record)
        elif isinstance(record, Statistics):
            self.statistics = record
        elif isinstance(record, (DataEnd, Footer)):
            self.complete = isinstance(record, Footer)

    def _take_metadata(self, record: Metadata) -> None:
        if record.name == METADATA:
            self.header = Header.from_metadata(record.metadata)
        elif record.name == METADATA_END:
            self.finished = True

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


def _describe(error: BaseException) -> str:
    if isinstance(error, CRCValidationError):
        return "a chunk is damaged: its checksum is wrong"
    if isinstance(error, UnsupportedCompressionError):
        return str(error)
    if isinstance(error, RecordLengthLimitExceeded):
        return "a record has an impossible length"
    name = type(error).__name__
    if name == "EndOfFile":
        return "the file ends early: it was not closed, or cut"
    return f"a record is damaged ({name}: {error})"

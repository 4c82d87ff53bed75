"""`recover`: what can be read of a broken log, as a clean file with an index.

The broken file is only read, and nothing that exists is overwritten.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Attachment, Channel, Message, Metadata, Schema

from embodichain.recording.header import METADATA_RECOVERED, LogError
from embodichain.recording.mcap_file import McapFile
from embodichain.recording.parts import first_file
from embodichain.recording.reader import LogReader
from embodichain.recording.records import Record
from embodichain.utils.errors import ConfigError

__all__ = ["Recovery", "recover"]


@dataclass(frozen=True, slots=True)
class Recovery:
    """What was saved.

    Attributes:
        source: The broken file.
        path: The new one.
        messages: Messages in it.
        steps: Whole control steps in it.
        attachments: Names of its attachments.
        nbytes: Its size.
        damage: Why the source ends there; empty if it was whole.
        lost_bytes: Bytes of the source behind the last block that was read.
    """

    source: Path
    path: Path
    messages: int
    steps: int
    attachments: list[str]
    nbytes: int
    damage: str
    lost_bytes: int


def recover(source: str | Path, target: str | Path) -> Recovery:
    """Copy a log up to where it is good: messages, attachments and metadata, with a new index.

    One that lies in several files becomes one file.

    Args:
        source: A log that was cut or damaged; a whole one is copied.
        target: A new file. It appears under this name when it is complete.

    Raises:
        ConfigError: If `source` is no log, or `target` exists or cannot be made.
        LogError: If not even the metadata of `source` can be read.
        OSError: If the new file cannot be written; nothing is left of it.
    """
    source, target = first_file(source), Path(target)
    with LogReader(source) as reader:
        if os.path.lexists(target):
            raise ConfigError(f"{target} exists; recover writes a new file")
        if not target.parent.is_dir():
            raise ConfigError(f"the folder {target.parent} does not exist")
        temporary = target.with_name(f".{target.name}.{os.getpid()}")
        try:
            with temporary.open("xb", buffering=0) as stream:
                copy = _Copy(reader, McapFile(stream, "zstd-fast", library="embodichain recover"))
                copy.all_records()
                os.fsync(stream.fileno())
            _publish(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)
        lost = 0 if reader.complete else reader.total_bytes - reader.good_bytes
        names = list(reader.attachments)
        nbytes = target.stat().st_size
        return Recovery(source, target, copy.messages, copy.steps, names, nbytes, copy.why, lost)


class _Copy:
    """Writes what a reader yields."""

    def __init__(self, reader: LogReader, file: McapFile) -> None:
        self._reader, self._file = reader, file
        self._schemas: dict[int, int] = {}
        self._channels: dict[int, int] = {}
        self.messages = self.steps = 0
        self.why = ""

    def all_records(self) -> None:
        """Copy up to the first damage, and close the file."""
        reader = self._reader
        for record in reader.records():
            self._add(record)
        reader.require_header()
        self.why = reader.damage or ("" if reader.complete else "its end is missing")
        if not self.why and not reader.finished and not reader.recovered:
            self.why = "the recorder did not close it"
        if self.why:
            values = {"why": self.why, "steps": str(self.steps), "source": reader.path.name}
            self._file.metadata(METADATA_RECOVERED, values)
        self._file.finish()

    def _add(self, record: Record) -> None:
        reader, file = self._reader, self._file
        if isinstance(record, Message):
            file.message(self._channels[record.channel_id], record.log_time, (record.data,))
            self.messages += 1
            self.steps += reader.channels[record.channel_id].topic == "/sim/step"
        elif isinstance(record, Schema):
            if record.id not in self._schemas:
                self._schemas[record.id] = file.schema(record.name, record.data)
        elif isinstance(record, Channel):
            if record.id not in self._channels:
                if record.message_encoding != "protobuf" or record.schema_id not in self._schemas:
                    raise LogError(f"{reader.path}: the channel {record.topic} is not a log's")
                schema = self._schemas[record.schema_id]
                self._channels[record.id] = file.channel(record.topic, schema)
        elif isinstance(record, Attachment):
            file.attachment(record.name, record.media_type, record.data, record.log_time)
        elif isinstance(record, Metadata):
            file.metadata(record.name, record.metadata)


def _publish(temporary: Path, target: Path) -> None:
    """Give a file its name, unless that is taken by now."""
    try:
        os.link(temporary, target)
    except FileExistsError:
        raise ConfigError(f"{target} exists; recover writes a new file") from None
    except OSError:  # a file system without links: claim the name, then take its place
        try:
            target.open("xb").close()
        except FileExistsError:
            raise ConfigError(f"{target} exists; recover writes a new file") from None
        temporary.replace(target)

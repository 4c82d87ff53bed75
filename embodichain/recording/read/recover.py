"""`recover`: copies the readable part of a broken log to a new file with an index.

The broken file is not changed, and no existing file is overwritten.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

from embodichain.recording.format.container.mcap_records import LIBRARIES
from embodichain.recording.format.container.mcap_writer import McapWriter
from embodichain.recording.format.header import METADATA, METADATA_END, METADATA_RECOVERED
from embodichain.recording.format.log_error import DamageError, LogError
from embodichain.recording.format.messages.block import unpack_steps
from embodichain.recording.format.messages.schema import STEPS_TOPIC
from embodichain.recording.format.parts import first_file
from embodichain.recording.format.seals import SEAL, sealed
from embodichain.recording.read.chunks import LogReader
from embodichain.recording.read.trajectory import outcomes
from embodichain.utils.errors import ConfigError
from embodichain.utils.system.atomic import atomic_file

__all__ = ["Recovery", "recover"]


@dataclass(frozen=True, slots=True)
class Recovery:
    """Result of `recover`.

    Attributes:
        source: The broken file.
        path: The new file.
        messages: Number of messages in the new file.
        steps: Number of complete control steps in it.
        attachments: Names of its attachments.
        nbytes: Its size.
        damage: Why the source could not be read further; empty if it was complete.
        lost_bytes: Bytes of the source after the last block that was read.
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
    """Copy a log up to the first damage: messages, attachments and metadata, with a new index.

    A log in several files becomes one file.

    Args:
        source: A log that was cut or damaged; a complete one is copied.
        target: A new file. It gets this name when it is complete.

    Raises:
        ConfigError: If `source` is not a log, or `target` exists or cannot be created.
        LogError: If the metadata of `source` cannot be read.
        OSError: If the new file cannot be written; the partial file is removed.
    """
    source = first_file(source)
    target = Path(target)
    with LogReader(source) as reader:
        if os.path.lexists(target):
            raise ConfigError(f"{target} exists; recover writes a new file")
        if not target.parent.is_dir():
            raise ConfigError(f"the folder {target.parent} does not exist")
        try:
            with atomic_file(target, new=True) as temporary, temporary.open("xb") as stream:
                copy = _Copy(reader, McapWriter(stream, "lz4", LIBRARIES[1]))
                copy.all_records()
        except FileExistsError:
            # Another program has created it in the meantime.
            raise ConfigError(f"{target} exists; recover writes a new file") from None
        return Recovery(
            source=source,
            path=target,
            messages=copy.messages,
            steps=copy.steps,
            attachments=copy.attachments,
            nbytes=target.stat().st_size,
            damage=copy.damage,
            lost_bytes=0 if reader.complete else reader.total_bytes - reader.good_bytes,
        )


class _Copy:
    """Copies the readable records of a log to a new file.

    Attributes:
        attachments: Names of the copied attachments.
        messages: Number of copied messages.
        steps: Number of control steps in them.
        damage: Why no more was copied; empty if the log was complete.
    """

    def __init__(self, reader: LogReader, writer: McapWriter) -> None:
        self._reader = reader
        self._writer = writer
        self._schemas: dict[int, int] = {}  # id in the log to id in the new file
        self._channels: dict[str, int] = {}  # topic to id in the new file
        self.attachments: list[str] = []
        self.messages = 0
        self.steps = 0
        self.damage = ""

    def all_records(self) -> None:
        """Copy up to the first damage, and close the file.

        Raises:
            LogError: If there is no metadata, or a channel does not belong to a log.
        """
        reader = self._reader
        writer = self._writer
        header = reader.require_header()
        damaged = [name for name in reader.attachments if not self._attach(name)]
        writer.metadata(METADATA, self._metadata())
        try:
            for topic, time_ns, data in reader.messages():
                if topic == STEPS_TOPIC:
                    message_runs = unpack_steps(
                        data,
                        num_envs=header.num_envs,
                        moved=header.moved_width,
                        nstate=header.nstate,
                        is_read=outcomes,
                    )
                    self.steps += sum(run.steps for run in message_runs)
                writer.message(self._channel(topic), time_ns, bytes(data))
                self.messages += 1
            self.damage = reader.cut
        except DamageError as error:
            self.damage = f"a message is damaged: {error}"
        if not self.damage and damaged:
            self.damage = f"the attachment {damaged[0]} is damaged"
        if reader.recovered:
            writer.metadata(METADATA_RECOVERED, reader.metadata[METADATA_RECOVERED])
        if reader.finished:
            writer.metadata(METADATA_END, reader.metadata[METADATA_END])
        if self.damage:
            values = {"why": self.damage, "steps": str(self.steps), "source": reader.path.name}
            writer.metadata(METADATA_RECOVERED, sealed(METADATA_RECOVERED, values))
        writer.finish()

    def _metadata(self) -> dict[str, str]:
        """The log's metadata, which list only the attachments that are in the new file."""
        values = self._reader.metadata[METADATA]
        if SEAL not in values:
            return values  # of an earlier version, which listed none
        listed = self._reader.require_header().attachments
        copied = {name: listed[name] for name in listed if name in self.attachments}
        return sealed(METADATA, {**values, "attachments": json.dumps(copied)})

    def _attach(self, name: str) -> bool:
        """Copy an attachment; return whether it is undamaged."""
        try:
            record = self._reader.attachment_record(name)
        except LogError:
            return False
        self._writer.attachment(record.name, record.media_type, record.data, record.log_time)
        self.attachments.append(name)
        return True

    def _channel(self, topic: str) -> int:
        """The new file's channel of a topic.

        Raises:
            LogError: If it is not a topic of a log.
        """
        if topic not in self._channels:
            channel = next(c for c in self._reader.channels.values() if c.topic == topic)
            schema = self._reader.schemas.get(channel.schema_id)
            if channel.message_encoding != "protobuf" or schema is None:
                raise LogError(f"{self._reader.path}: the channel {topic} is not a log's")
            if schema.id not in self._schemas:
                self._schemas[schema.id] = self._writer.schema(
                    schema.name, schema.encoding, schema.data
                )
            schema_id = self._schemas[schema.id]
            self._channels[topic] = self._writer.channel(topic, "protobuf", schema_id)
        return self._channels[topic]

"""Writes a log anew with something changed, by the library's own writer: every CRC is right."""

import json
import zipfile

import zstandard
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from embodichain.recording.format.container.unpacking import unpacked_size
from embodichain.recording.format.seals import SEAL, digest_of, sealed


def rewrite(source, target, message=None, attachment=None, metadata=None, seal=True, crcs=True):
    """Copy a log; `message(topic, data)`, `attachment(name, data)`, `metadata(name, dict)` return
    what to write instead. The digests in the metadata are those of what is written, unless `seal`
    is False; without `crcs` the data section has no checksum."""
    with source.open("rb") as stream, target.open("wb") as out:
        writer = Writer(out, compression=CompressionType.ZSTD, enable_data_crcs=crcs)
        writer.start()
        schemas, channels, topics, attached = {}, {}, {}, {}
        for record in StreamReader(stream).records:
            if isinstance(record, Schema) and record.id not in schemas:
                schemas[record.id] = writer.register_schema(
                    record.name, record.encoding, record.data
                )
            elif isinstance(record, Channel) and record.id not in channels:
                topics[record.id] = record.topic
                channels[record.id] = writer.register_channel(
                    record.topic, record.message_encoding, schemas[record.schema_id]
                )
            elif isinstance(record, Message):
                data = record.data
                if message is not None:
                    data = message(topics[record.channel_id], data)
                writer.add_message(
                    channels[record.channel_id], record.log_time, data, record.publish_time
                )
            elif isinstance(record, Attachment):
                data = record.data if attachment is None else attachment(record.name, record.data)
                attached[record.name] = data
                writer.add_attachment(0, record.log_time, record.name, record.media_type, data)
            elif isinstance(record, Metadata):
                values = record.metadata
                if metadata is not None:
                    values = metadata(record.name, dict(values))
                if seal and SEAL in values:
                    values = _sealed(record.name, values, attached)
                writer.add_metadata(record.name, values)
        writer.finish()
    return target


def _sealed(name, values, attached):
    if "attachments" in values:
        listed = {n: (_size(n, data), digest_of(data)) for n, data in attached.items()}
        values = {**values, "attachments": json.dumps(listed)}
    return sealed(name, values)


def _size(name, data):
    """To what an attachment unpacks; its own size where it is not what its name says."""
    try:
        return unpacked_size(name, data)
    except (zstandard.ZstdError, zipfile.BadZipFile):
        return len(data)


def as_before(source, target):
    """Copy a log as version 0.1.0 wrote it: without digests and a checksum of everything."""

    def metadata(name, values):
        return {key: value for key, value in values.items() if key not in (SEAL, "attachments")}

    return rewrite(source, target, metadata=metadata, crcs=False)

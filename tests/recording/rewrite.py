"""Writes a log anew with something changed, by the library's own writer: every CRC is right."""

from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer


def rewrite(source, target, message=None, attachment=None, metadata=None):
    """Copy a log; `message(topic, data)`, `attachment(name, data)`, `metadata(name, dict)` return
    what to write instead."""
    with source.open("rb") as stream, target.open("wb") as out:
        writer = Writer(out, compression=CompressionType.ZSTD)
        writer.start()
        schemas, channels, topics = {}, {}, {}
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
                writer.add_attachment(0, record.log_time, record.name, record.media_type, data)
            elif isinstance(record, Metadata):
                values = record.metadata
                if metadata is not None:
                    values = metadata(record.name, dict(values))
                writer.add_metadata(record.name, values)
        writer.finish()
    return target

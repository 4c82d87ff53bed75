"""Reads `/env_I/metrics`: scalars whose names are in the message's own schema."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from google.protobuf import descriptor_pb2
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from embodichain.recording.chunks import LogReader
from embodichain.recording.log_error import LogError
from embodichain.recording.schema import scalars_class

__all__ = ["read_metrics"]


def read_metrics(
    reader: LogReader, env: int
) -> tuple[NDArray[np.int64], dict[str, NDArray[np.float64]]]:
    """Sampled steps (S,), and name to (S,) values, of an environment; empty if it has none.

    Raises:
        LogError: If a message or the schema is damaged.
    """
    header, topic = reader.require_header(), f"/env_{env}/metrics"
    found = [(time_ns, data) for this, time_ns, data in reader.messages() if this == topic]
    try:
        names = _names(reader, topic)
        message = scalars_class("Metrics", names)
        rows = [message.FromString(bytes(data)) for _, data in found]
    except (DecodeError, TypeError, ValueError) as error:
        raise LogError(f"{reader.path}: a message of {topic} is damaged: {error}") from error
    times = np.array([time_ns for time_ns, _ in found], np.uint64).astype(np.int64)
    values = {name: np.array([getattr(row, name) for row in rows], np.float64) for name in names}
    return (times - header.start_ns) // header.period_ns, values


def _names(reader: LogReader, topic: str) -> Sequence[str]:
    """Names of the fields, in order of their numbers, from the schema of a channel."""
    for channel in reader.channels.values():
        if channel.topic == topic and channel.schema_id in reader.schemas:
            declared = descriptor_pb2.FileDescriptorSet()
            declared.ParseFromString(reader.schemas[channel.schema_id].data)
            if len(declared.file) != 1 or len(declared.file[0].message_type) != 1:
                raise ValueError("its schema is not of one message")
            fields = declared.file[0].message_type[0].field
            if [field.number for field in fields] != list(range(1, len(fields) + 1)):
                raise ValueError("the fields of its schema are not numbered from 1")
            return [field.name for field in fields]
    return ()

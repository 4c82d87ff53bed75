"""Reads `/env_I/metrics`: scalars whose names stand in the message's own schema."""

from __future__ import annotations

from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from embodichain.recording import wire
from embodichain.recording.chunks import ChunkFile
from embodichain.recording.header import LogError

__all__ = ["read_metrics"]


def read_metrics(
    file: ChunkFile, env: int
) -> tuple[NDArray[np.int64], dict[str, NDArray[np.float64]]]:
    """Sampled steps (S,), and name to (S,) values, of an environment; empty if it has none.

    Raises:
        LogError: If the file says what cannot be.
    """
    header, topic = file.require_header(), f"/env_{env}/metrics"
    times: list[int] = []
    rows: list[dict[int, Any]] = []
    try:
        for found, time_ns, payload in file.messages():
            if found == topic:
                times.append(time_ns)
                rows.append({n: values[-1] for n, values in wire.parse(payload).items()})
        names = _names(file, topic)
    except (wire.WireError, DecodeError) as error:
        raise LogError(f"{file.path}: a message of {topic} is damaged: {error}") from error
    # Zeros are left out of a message.
    values = {
        name: np.array([float(row.get(number, 0.0)) for row in rows])
        for number, name in names.items()
    }
    return (np.array(times, np.int64) - header.start_ns) // header.period_ns, values


def _names(file: ChunkFile, topic: str) -> dict[int, str]:
    """Field number to name, from the schema of a channel."""
    for channel in file.channels.values():
        if channel.topic == topic and channel.schema_id in file.schemas:
            declared = descriptor_pb2.FileDescriptorSet()
            declared.ParseFromString(file.schemas[channel.schema_id].data)
            return {f.number: f.name for f in declared.file[0].message_type[0].field}
    return {}

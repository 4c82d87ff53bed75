"""Content of a log besides states and steps: events, writes, metrics of viewed environments."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import F64
from embodichain.recording.format.log_error import LogError
from embodichain.recording.format.messages.block import DRAWN, CallKind
from embodichain.recording.format.messages.schema import scalars_class
from embodichain.recording.read.chunks import LogReader
from embodichain.recording.read.trajectory import Span, columns_of, needed_chunks, runs
from embodichain.utils.array_types import EnvIds

__all__ = ["LogEvent", "LogWrite", "read_events", "read_metrics", "read_writes"]


@dataclass(frozen=True, slots=True)
class LogEvent:
    """A term of the event manager fired.

    Attributes:
        step: Number of control steps finished before.
        term: The term.
        mode: ``startup``, ``reset``, ``interval``, ``command``.
        env_ids: (n,) environments; None is all.
        drawn: Drawn values: name to (n, ...) array.
    """

    step: int
    term: str
    mode: str
    env_ids: EnvIds | None
    drawn: dict[str, NDArray[np.float64]]


@dataclass(frozen=True, slots=True)
class LogWrite:
    """A write to the simulation outside physics.

    Attributes:
        step: Number of control steps finished before.
        op: ``state``, ``model``, ``reset`` or ``set_const``, as in `lab.sim.engine.api.Write`.
        field: Component of the state, or model field; empty for ``set_const``.
        env_ids: (n,) environments; None is all.
        columns: (k,) columns within the field, or a slice of them.
        values: (n, k) values; for ``reset`` the resulting rows; None for ``set_const``.
    """

    step: int
    op: str
    field: str
    env_ids: EnvIds | None
    columns: NDArray[np.int64] | slice
    values: F64 | None


def read_events(reader: LogReader) -> Iterator[LogEvent]:
    """Yield the events of a log.

    Raises:
        LogError: If a message is damaged.
    """
    for step, kind, arrays in _calls(reader, "event"):
        env_ids = arrays.pop("env_ids", None)
        drawn = {name.removeprefix(DRAWN): values for name, values in arrays.items()}
        yield LogEvent(step, term=kind.name, mode=kind.mode, env_ids=env_ids, drawn=drawn)


def read_writes(reader: LogReader) -> Iterator[LogWrite]:
    """Yield the writes of a log.

    Raises:
        LogError: If a message is damaged.
    """
    for step, kind, arrays in _calls(reader, "write"):
        yield LogWrite(
            step,
            op=kind.mode,
            field=kind.name,
            env_ids=arrays.get("env_ids"),
            columns=columns_of(kind.columns),
            values=arrays.get("values"),
        )


def _calls(reader: LogReader, kind: str) -> Iterator[tuple[int, CallKind, dict[str, Any]]]:
    """Control step, kind and arrays of every call of a kind."""
    for run in runs(reader, is_read=lambda call: call.kind == kind):
        calls = run.of_kind(kind)
        for t in range(run.count):
            for call in calls:
                arrays = {name: values[t] for name, values in call.arrays.items()}
                yield run.first + t, call.kind, arrays


def read_metrics(
    reader: LogReader, env: int, span: Span | None = None
) -> tuple[NDArray[np.int64], dict[str, NDArray[np.float64]]]:
    """(S,) sampled steps of an environment, and name to (S,) values; empty if it has none.

    Args:
        reader: The log.
        env: The environment.
        span: The control steps; some before and after them may be returned too. None is all.

    Raises:
        LogError: If a message or the schema is damaged.
    """
    header = reader.require_header()
    topic = f"/env_{env}/metrics"
    times_ns = []
    messages = []
    chunks = None if span is None else needed_chunks(reader, span)
    for message_topic, time_ns, data in reader.messages(chunks):
        if span is not None and span.ends_before((time_ns - header.start_ns) // header.period_ns):
            break
        if message_topic == topic:
            times_ns.append(time_ns)
            messages.append(data)
    try:
        names = _field_names(reader, topic)
        message_type = scalars_class("Metrics", names)
        rows = [message_type.FromString(bytes(data)) for data in messages]
    except (DecodeError, TypeError, ValueError) as error:
        raise LogError(f"{reader.path}: a message of {topic} is damaged: {error}") from error
    # A damaged time may need all 64 bits.
    times = np.array(times_ns, np.uint64).astype(np.int64)
    steps = (times - header.start_ns) // header.period_ns
    values = {name: np.array([getattr(row, name) for row in rows], np.float64) for name in names}
    return steps, values


def _field_names(reader: LogReader, topic: str) -> Sequence[str]:
    """Names of the fields, in order of their numbers, from the schema of a channel."""
    for channel in reader.channels.values():
        if channel.topic != topic or channel.schema_id not in reader.schemas:
            continue
        descriptors = descriptor_pb2.FileDescriptorSet()
        descriptors.ParseFromString(reader.schemas[channel.schema_id].data)
        if len(descriptors.file) != 1 or len(descriptors.file[0].message_type) != 1:
            raise ValueError("its schema is not of one message")
        fields = descriptors.file[0].message_type[0].field
        if [field.number for field in fields] != list(range(1, len(fields) + 1)):
            raise ValueError("the fields of its schema are not numbered from 1")
        return [field.name for field in fields]
    return ()

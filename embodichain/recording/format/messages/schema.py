"""Schemas of the channels as protobuf descriptors: the log's own messages, and Foxglove's.

The log's own messages are declared here without protoc. A file contains the descriptors of its
channels, so any MCAP reader can decode it.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.descriptor import FileDescriptor

__all__ = [
    "MESSAGES",
    "PICTURES_TOPIC",
    "START_TOPIC",
    "STEPS_TOPIC",
    "descriptor_set",
    "identifier",
    "message_class",
    "scalars_class",
    "scalars_descriptor_set",
]

STEPS_TOPIC = "/sim/steps"
"""Control steps, as `embodichain.Steps`."""
START_TOPIC = "/sim/start"
"""State of the simulation between two control steps, as `embodichain.Steps` with one call."""

PICTURES_TOPIC = "/pictures"
"""Hashes of the first pictures of episodes, as `embodichain.Pictures`."""

_F = descriptor_pb2.FieldDescriptorProto
_KINDS = {
    "bool": _F.TYPE_BOOL,
    "bytes": _F.TYPE_BYTES,
    "double": _F.TYPE_DOUBLE,
    "int64": _F.TYPE_INT64,
    "string": _F.TYPE_STRING,
    "uint32": _F.TYPE_UINT32,
    "uint64": _F.TYPE_UINT64,
}
_PACKAGE = "embodichain"
_FILE = "embodichain/log.proto"

MESSAGES: Mapping[str, Sequence[str]] = {
    # `block` defines the calls of a run, and the places of their arrays in `data`.
    "Array": (
        "string name = 1",
        "string dtype = 2",
        "repeated uint32 shape = 3",
        "uint64 offset = 4",
        "bool single = 5",
        "bool differs = 6",
        "uint64 base = 7",
        "bool base_single = 8",
    ),
    "Call": (
        "string kind = 1",
        "string name = 2",
        "string mode = 3",
        "uint32 nstep = 4",
        "bool some_columns = 5",
        "repeated uint32 columns = 6",
        "repeated Array arrays = 7",
        "repeated uint32 steps = 8",
    ),
    "Steps": (
        "uint64 first = 1",
        "uint32 count = 2",
        "repeated Call calls = 3",
        "bytes data = 4",  # must be the last field: see `block.pack_steps`
    ),
    # First pictures of episodes that begin with a control step, as one camera draws them.
    # `pictures` defines what is hashed; `sha256` has 32 bytes for each environment.
    "Pictures": (
        "uint64 step = 1",
        "string camera = 2",
        "uint32 width = 3",
        "uint32 height = 4",
        "double near = 5",
        "double far = 6",
        "string look = 7",
        "repeated string outputs = 8",
        "string renderer = 9",
        "repeated uint32 env_ids = 10",
        "bytes sha256 = 11",
    ),
    # Episodes that ended in a control step, one entry each. Flags are one byte each, tables are
    # (n, names), row-major. `success` is empty if the task does not define it.
    "Episodes": (
        "uint64 step = 1",
        "repeated uint32 env_ids = 2",
        "repeated int64 episode_id = 3",
        "repeated uint32 length = 4",
        "repeated double total_reward = 5",
        "bytes terminated = 6",
        "bytes truncated = 7",
        "bytes success = 8",
        "repeated string reason = 9",
        "bytes reasons = 10",
        "repeated string reward_term = 11",
        "repeated double reward_sums = 12",
        "repeated string metric = 13",
        "repeated double metrics = 14",
        # Draws of events and delays: `drawn` is (n, sum of the widths), `was_drawn` (n, draws).
        "repeated string draw = 15",
        "repeated uint32 draw_width = 16",
        "repeated double drawn = 17",
        "bytes was_drawn = 18",
    ),
    # Episodes that count, where a run decides later than at their ends, one entry each.
    "Counted": (
        "repeated uint32 env_ids = 1",
        "repeated int64 episode_id = 2",
    ),
}


def _add_field(message: descriptor_pb2.DescriptorProto, declaration: str) -> None:
    type_and_name, number = declaration.split(" = ")
    words = type_and_name.split()
    is_repeated = words[0] == "repeated"
    kind, name = words[-2:]
    field = message.field.add(name=name, number=int(number))
    field.label = _F.LABEL_REPEATED if is_repeated else _F.LABEL_OPTIONAL
    if kind in _KINDS:
        field.type = _KINDS[kind]
    else:
        field.type = _F.TYPE_MESSAGE
        field.type_name = f".{_PACKAGE}.{kind}"


@cache
def _own_file() -> descriptor_pb2.FileDescriptorProto:
    file = descriptor_pb2.FileDescriptorProto(name=_FILE, package=_PACKAGE, syntax="proto3")
    for name, declarations in MESSAGES.items():
        message = file.message_type.add(name=name)
        for declaration in declarations:
            _add_field(message, declaration)
    return file


def _class(file: descriptor_pb2.FileDescriptorProto, name: str) -> Any:
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.{name}"))


@cache
def message_class(name: str) -> Any:
    """The protobuf class of one of the log's own messages (``Steps``, ``Episodes``)."""
    return _class(_own_file(), name)


def descriptor_set(name: str) -> bytes:
    """Serialized `FileDescriptorSet` of ``embodichain.NAME`` or ``foxglove.NAME``.

    Raises:
        KeyError: If there is no such message.
    """
    package, _, short = name.partition(".")
    result = descriptor_pb2.FileDescriptorSet()
    if package == _PACKAGE:
        if short not in MESSAGES:
            raise KeyError(f"no message {name!r}; there are {', '.join(MESSAGES)}")
        result.file.append(_own_file())
    else:
        module = importlib.import_module(f"foxglove_schemas_protobuf.{short}_pb2")
        _append(result, module.DESCRIPTOR, set())
    return result.SerializeToString(deterministic=True)


def _append(result: descriptor_pb2.FileDescriptorSet, file: FileDescriptor, seen: set[str]) -> None:
    if file.name in seen:
        return
    seen.add(file.name)
    for dependency in file.dependencies:
        _append(result, dependency, seen)
    file.CopyToProto(result.file.add())


def _scalars_file(message: str, names: Sequence[str]) -> descriptor_pb2.FileDescriptorProto:
    file = descriptor_pb2.FileDescriptorProto(
        name=f"{_PACKAGE}/{message.lower()}.proto", package=_PACKAGE, syntax="proto3"
    )
    declared = file.message_type.add(name=message)
    for number, name in enumerate(names, start=1):
        _add_field(declared, f"double {name} = {number}")
    return file


def scalars_descriptor_set(message: str, names: Sequence[str]) -> bytes:
    """Schema of a message of a run's scalars: a double field for each name, numbered from 1."""
    result = descriptor_pb2.FileDescriptorSet(file=[_scalars_file(message, names)])
    return result.SerializeToString(deterministic=True)


def identifier(name: str) -> str:
    """Return a legal protobuf field name."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name).lower()


def scalars_class(message: str, names: Sequence[str]) -> Any:
    """The protobuf class of the message that `scalars_descriptor_set` declares."""
    return _class(_scalars_file(message, names), message)

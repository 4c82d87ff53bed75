"""Schemas of the channels: our own messages, declared here without protoc, and Foxglove's.

Declared as protobuf descriptors, so that any MCAP reader can decode the file from itself. How the
bytes are made quickly is in `messages`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.descriptor import FileDescriptor

__all__ = ["MESSAGES", "descriptor_set", "message_class", "scalars_descriptor_set"]

_F = descriptor_pb2.FieldDescriptorProto
_KINDS = {
    "bytes": _F.TYPE_BYTES,
    "double": _F.TYPE_DOUBLE,
    "fixed32": _F.TYPE_FIXED32,
    "fixed64": _F.TYPE_FIXED64,
    "sfixed64": _F.TYPE_SFIXED64,
    "string": _F.TYPE_STRING,
    "uint32": _F.TYPE_UINT32,
    "uint64": _F.TYPE_UINT64,
}
_PACKAGE = "embodichain"
_FILE = "embodichain/log.proto"

MESSAGES: Mapping[str, Sequence[str]] = {
    # Rows of the integration state as physics receives them, environments in order. `width` is the
    # number of columns: the ones that the metadata names, or all, or those that physics writes; its
    # inputs follow from the state before and the writes since. `call` counts physics calls; `nstep`
    # physics steps follow, none after the last row. No `env_ids` means all environments.
    "BatchedState": (
        "uint64 step = 1",
        "uint32 num_envs = 2",
        "uint32 width = 3",
        "repeated double state = 4",
        "uint64 call = 5",
        "uint32 nstep = 6",
        "repeated fixed32 env_ids = 7",
    ),
    # One control step. `hash` is of the rows that physics call `call` returned.
    "Step": (
        "uint64 step = 1",
        "uint64 call = 2",
        "uint32 num_envs = 3",
        "uint32 action_width = 4",
        "repeated double action = 5",
        "repeated double reward = 6",
        "bytes terminated = 7",
        "bytes truncated = 8",
        "repeated sfixed64 episode_id = 9",
        "repeated fixed64 hash = 10",
        "repeated fixed32 failed = 11",
    ),
    # A physics call that is not the one of its control step: settling in a reset event, say.
    "PhysicsCall": (
        "uint64 step = 1",
        "uint64 call = 2",
        "repeated fixed32 env_ids = 3",
        "repeated fixed64 hash = 4",
        "repeated fixed32 failed = 5",
    ),
    # A write outside physics, made before physics call `call`. `phase`: before or after the
    # control step's physics. No `env_ids`: all; no `columns`: all. `values` is (n, k) by rows.
    "Write": (
        "uint64 step = 1",
        "uint64 call = 2",
        "string phase = 3",
        "string op = 4",
        "string field = 5",
        "repeated fixed32 env_ids = 6",
        "repeated fixed32 columns = 7",
        "repeated double values = 8",
    ),
    "Drawn": ("string name = 1", "repeated uint32 shape = 2", "repeated double values = 3"),
    # A term of the event manager fired. No `env_ids`: everywhere.
    "Event": (
        "uint64 step = 1",
        "uint64 call = 2",
        "string term = 3",
        "string mode = 4",
        "repeated fixed32 env_ids = 5",
        "repeated Drawn drawn = 6",
    ),
    # Episodes that ended in a step, one column for each: flags are a byte each, tables (n, names)
    # by rows. `success` is absent where the task does not say.
    "Episodes": (
        "uint64 step = 1",
        "repeated fixed32 env_ids = 2",
        "repeated sfixed64 episode_id = 3",
        "repeated fixed32 length = 4",
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
    ),
}


def _add_field(message: descriptor_pb2.DescriptorProto, declaration: str) -> None:
    left, number = declaration.split(" = ")
    words = left.split()
    repeated = words[0] == "repeated"
    kind, name = words[-2:]
    field = message.field.add(name=name, number=int(number), json_name=_json_name(name))
    field.label = _F.LABEL_REPEATED if repeated else _F.LABEL_OPTIONAL
    if kind in _KINDS:
        field.type = _KINDS[kind]
    else:
        field.type = _F.TYPE_MESSAGE
        field.type_name = f".{_PACKAGE}.{kind}"


def _json_name(name: str) -> str:
    head, *tail = name.split("_")
    return head + "".join(word.capitalize() for word in tail)


@cache
def _own_file() -> descriptor_pb2.FileDescriptorProto:
    file = descriptor_pb2.FileDescriptorProto(name=_FILE, package=_PACKAGE, syntax="proto3")
    for name, declarations in MESSAGES.items():
        message = file.message_type.add(name=name)
        for declaration in declarations:
            _add_field(message, declaration)
    return file


def message_class(name: str) -> Any:
    """Protobuf's class of one of our messages: what other readers make of the schema."""
    pool = descriptor_pool.DescriptorPool()
    pool.Add(_own_file())
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.{name}"))


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
        from embodichain.recording.foxglove import messages

        _append(result, getattr(messages, short).DESCRIPTOR.file, set())
    return result.SerializeToString(deterministic=True)


def _append(result: descriptor_pb2.FileDescriptorSet, file: FileDescriptor, seen: set[str]) -> None:
    if file.name in seen:
        return
    seen.add(file.name)
    for dependency in file.dependencies:
        _append(result, dependency, seen)
    file.CopyToProto(result.file.add())


def scalars_descriptor_set(message: str, names: Sequence[str]) -> bytes:
    """Schema of a message of this run's own scalars: one double field a name, numbered from 1."""
    file = descriptor_pb2.FileDescriptorProto(
        name=f"{_PACKAGE}/{message.lower()}.proto", package=_PACKAGE, syntax="proto3"
    )
    declared = file.message_type.add(name=message)
    for number, name in enumerate(names, start=1):
        _add_field(declared, f"double {name} = {number}")
    result = descriptor_pb2.FileDescriptorSet(file=[file])
    return result.SerializeToString(deterministic=True)

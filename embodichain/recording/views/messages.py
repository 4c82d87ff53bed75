"""Foxglove's published message classes (foxglove-schemas-protobuf), and where messages go."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

__all__ = [
    "Color",
    "FrameTransforms",
    "JointStates",
    "Log",
    "Pose",
    "Quaternion",
    "SceneUpdate",
    "Sink",
    "Vector3",
    "set_time",
]


class Sink(Protocol):
    """Where messages go: a file, or connected viewers."""

    def channel(self, topic: str, schema: str, data: bytes | None = None) -> None:
        """Declare a channel; `data` is the schema's FileDescriptorSet if `schema` has none."""

    def send(self, time_ns: int, messages: Sequence[tuple[str, bytes]]) -> None:
        """Write or send serialized messages of one time, each with its topic."""


def set_time(timestamp: Any, time_ns: int) -> None:
    """Set a protobuf Timestamp to nanoseconds since the epoch."""
    timestamp.seconds, timestamp.nanos = divmod(time_ns, 1_000_000_000)

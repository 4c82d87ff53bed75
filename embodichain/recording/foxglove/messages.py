"""Foxglove's published message classes that we write, under one roof.

They come from the package foxglove-schemas-protobuf; nothing is declared here.
"""

from foxglove_schemas_protobuf.ArrowPrimitive_pb2 import ArrowPrimitive
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.ModelPrimitive_pb2 import ModelPrimitive
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp

__all__ = [
    "ArrowPrimitive",
    "Color",
    "CubePrimitive",
    "CylinderPrimitive",
    "FrameTransform",
    "FrameTransforms",
    "JointState",
    "JointStates",
    "Log",
    "ModelPrimitive",
    "Pose",
    "Quaternion",
    "SceneEntity",
    "SceneUpdate",
    "SpherePrimitive",
    "Timestamp",
    "Vector3",
    "timestamp",
]


def timestamp(ns: int) -> Timestamp:
    """Nanoseconds since the epoch as protobuf's Timestamp."""
    return Timestamp(seconds=ns // 1_000_000_000, nanos=ns % 1_000_000_000)

"""A ROS 2 bag (MCAP, profile ``ros2``): joint states, transforms, robot description.

For each environment ``/env_I/joint_states`` and ``/env_I/robot_description``; one ``/tf``. Frames
and links are named ``env_I/uid/link`` and hang on ``env_I``. rosbags has the message types.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from embodichain.recording.api import Log
from embodichain.recording.export.formats import Part, required
from embodichain.recording.export.poses import poses
from embodichain.recording.export.urdf import urdf
from embodichain.recording.views.motion import frame_names, scalar_joints

__all__ = ["write"]

_LATCHED = """\
- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline: {sec: 0, nsec: 0}
  lifespan: {sec: 0, nsec: 0}
  liveliness: 1
  liveliness_lease_duration: {sec: 0, nsec: 0}
  avoid_ros_namespace_conventions: false
"""
"""Quality of service of what late subscribers get too (ROS 2: transient local)."""


def write(log: Log, part: Part, path: Path) -> None:
    """Write the bag: the environment that is named, else those that were viewed.

    Raises:
        ConfigError: If rosbags is not installed.
    """
    types: Any = required("rosbags.typesys", "ros2")
    envs = [part.env] if part.env is not None else log.header.view_envs or [0]
    with path.open("xb") as stream:
        bag = _Bag(Writer(stream, compression=CompressionType.ZSTD), types)
        for _ in zip(*(_messages(bag, log, env, part) for env in envs), strict=True):
            pass  # each has written one control step
        bag.writer.finish()  # type: ignore[no-untyped-call]


class _Bag:
    """Channels of a bag, declared when they are first written to."""

    def __init__(self, writer: Writer, types: Any) -> None:
        self.writer = writer
        self._store = types.get_typestore(types.Stores.ROS2_HUMBLE)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        writer.start(profile="ros2", library="embodichain")

    def make(self, kind: str, *fields: Any) -> Any:
        """Return a message of a type, from its fields in order."""
        package, name = kind.split("/")
        return self._store.types[f"{package}/msg/{name}"](*fields)

    def header(self, frame_id: str = "") -> Any:
        """Return a `std_msgs/Header`."""
        return self.make("std_msgs/Header", self.make("builtin_interfaces/Time", 0, 0), frame_id)

    def add(self, topic: str, time_ns: int, message: Any, qos: str = "") -> None:
        """Write a message."""
        kind = message.__msgtype__
        if kind not in self._schemas:
            definition, _ = self._store.generate_msgdef(kind, ros_version=2)
            self._schemas[kind] = self.writer.register_schema(kind, "ros2msg", definition.encode())
        if topic not in self._channels:
            metadata = {"offered_qos_profiles": qos}
            self._channels[topic] = self.writer.register_channel(
                topic, "cdr", self._schemas[kind], metadata
            )
        data = bytes(self._store.serialize_cdr(message, kind))
        self.writer.add_message(self._channels[topic], time_ns, data, time_ns)


def _messages(bag: _Bag, log: Log, env_id: int, part: Part) -> Iterator[None]:
    """Write the messages of one environment, one control step at a time."""
    root, *names = frame_names(log.model, env_id)
    joints = scalar_joints(log.model)
    ids = np.array(list(joints.values()), np.int64)
    qpos, qvel = log.model.jnt_qposadr[ids], log.model.jnt_dofadr[ids]
    none = np.zeros(0)
    state = bag.make("sensor_msgs/JointState", bag.header(), list(joints), none, none, none)
    frames = [_frame(bag, root, name) for name in names]
    tf = bag.make("tf2_msgs/TFMessage", frames)
    stamps = [state.header.stamp, *(frame.header.stamp for frame in frames)]
    described = False
    for step, data, _ in poses(log, env_id, part):
        time_ns = log.header.start_ns + step * log.header.period_ns
        if not described:
            text = bag.make("std_msgs/String", urdf(log.model, env_id))
            bag.add(f"/{root}/robot_description", time_ns, text, _LATCHED)
            described = True
        for stamp in stamps:
            stamp.sec, stamp.nanosec = divmod(time_ns, 1_000_000_000)
        state.position, state.velocity = data.qpos[qpos], data.qvel[qvel]
        bag.add(f"/{root}/joint_states", time_ns, state)
        positions, rotations = data.xpos[1:].tolist(), data.xquat[1:].tolist()
        for frame, xyz, wxyz in zip(frames, positions, rotations, strict=True):
            moved, turned = frame.transform.translation, frame.transform.rotation
            moved.x, moved.y, moved.z = xyz
            turned.w, turned.x, turned.y, turned.z = wxyz
        bag.add("/tf", time_ns, tf)
        yield


def _frame(bag: _Bag, parent: str, name: str) -> Any:
    translation = bag.make("geometry_msgs/Vector3", 0.0, 0.0, 0.0)
    rotation = bag.make("geometry_msgs/Quaternion", 0.0, 0.0, 0.0, 1.0)
    transform = bag.make("geometry_msgs/Transform", translation, rotation)
    return bag.make("geometry_msgs/TransformStamped", bag.header(parent), name, transform)

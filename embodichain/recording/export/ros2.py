"""A ROS 2 bag (MCAP, profile ``ros2``): joint states, transforms, robot description.

For each environment ``/env_I/joint_states`` and ``/env_I/robot_description``; one ``/tf``. Frames
and links are named ``env_I/uid/link`` and hang on ``env_I``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mcap.writer import CompressionType, Writer

from embodichain.recording.api import Log
from embodichain.recording.arrays import LogArrays
from embodichain.recording.export.cdr import CdrTemplate
from embodichain.recording.export.formats import Part
from embodichain.recording.export.poses import INPUTS, Poses
from embodichain.recording.export.urdf import urdf
from embodichain.recording.foxglove.frames import frame_names

__all__ = ["write"]

# Fields of the messages of ROS 2, in its own notation; readers find types by them.
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id\n"
_DEFINITIONS = {
    "std_msgs/Header": _HEADER,
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/TransformStamped": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/Transform transform\n",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\n"
    "geometry_msgs/Quaternion rotation\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
}
_TIME = ("std_msgs/Header", "builtin_interfaces/Time")
_TYPES = {
    "sensor_msgs/msg/JointState": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
        "float64[] effort\n",
        _TIME,
    ),
    "tf2_msgs/msg/TFMessage": (
        "geometry_msgs/TransformStamped[] transforms\n",
        ("geometry_msgs/TransformStamped", *_TIME, "geometry_msgs/Transform",
         "geometry_msgs/Vector3", "geometry_msgs/Quaternion"),
    ),
    "std_msgs/msg/String": ("string data\n", ()),
}  # fmt: skip
_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_LATCHED = (
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n  deadline:\n    sec: 0\n"
    "    nsec: 0\n  lifespan:\n    sec: 0\n    nsec: 0\n  liveliness: 1\n"
    "  liveliness_lease_duration:\n    sec: 0\n    nsec: 0\n"
    "  avoid_ros_namespace_conventions: false\n"
)
"""Quality of service of what who comes late shall still get (ROS 2: transient local)."""


def write(log: Log, part: Part, path: Path) -> None:
    """Write the bag: the environment that is named, else those that were viewed."""
    envs = [part.env] if part.env is not None else log.header.view_envs or [0]
    fields = [name for name in (*INPUTS, "qvel") if name in log.columns]
    parts = log.parts(fields, envs, part.episode, part.start, part.stop)
    with path.open("xb") as stream:
        bag = _Bag(Writer(stream, compression=CompressionType.ZSTD))
        makers = [_Environment(bag, log, env, i) for i, env in enumerate(envs)]
        for data in parts:
            for maker in makers:
                maker.add(data)
        bag.writer.finish()  # type: ignore[no-untyped-call]


class _Bag:
    """Channels of a bag, declared when they are first written to."""

    def __init__(self, writer: Writer) -> None:
        self.writer = writer
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        writer.start(profile="ros2", library="embodichain")

    def add(self, topic: str, kind: str, time_ns: int, data: bytes, qos: str = "") -> None:
        """Write a message."""
        if kind not in self._schemas:
            text, needed = _TYPES[kind]
            named = (f"{'=' * 80}\nMSG: {name}\n{_DEFINITIONS[name]}" for name in needed)
            definition = "".join([text, *named]).encode()
            self._schemas[kind] = self.writer.register_schema(kind, "ros2msg", definition)
        if topic not in self._channels:
            metadata = {"offered_qos_profiles": qos}
            self._channels[topic] = self.writer.register_channel(
                topic, "cdr", self._schemas[kind], metadata
            )
        self.writer.add_message(self._channels[topic], time_ns, data, time_ns)


class _Environment:
    """Turns the states of one environment into messages."""

    def __init__(self, bag: _Bag, log: Log, env_id: int, column: int) -> None:
        self._bag, self._column, self._header = bag, column, log.header
        self._root = f"/env_{env_id}"
        self._poses = Poses(log, env_id)
        self._model = log.model
        model = log.model
        ids = [j for j in range(model.njnt) if int(model.jnt_type[j]) in _SCALAR]
        self._qpos = np.array([model.jnt_qposadr[j] for j in ids], np.int64)
        self._qvel = np.array([model.jnt_dofadr[j] for j in ids], np.int64)
        names = [model.joint(j).name or f"joint_{j}" for j in ids]
        self._joints = CdrTemplate().header().texts(names)
        self._joints.uint(len(ids)).doubles(len(ids)).uint(len(ids)).doubles(len(ids)).uint(0)
        self._transforms = _transforms(frame_names(model, env_id))
        self._described = False
        self._description = CdrTemplate().text(urdf(model, env_id))

    def add(self, data: LogArrays) -> None:
        """Write the steps of `data`."""
        for index, (step, poses) in enumerate(self._poses.of(data, self._column)):
            time_ns = self._header.start_ns + step * self._header.period_ns
            if not self._described:
                self._described = True
                topic, said = f"{self._root}/robot_description", self._description.fill(time_ns)
                self._bag.add(topic, "std_msgs/msg/String", time_ns, said, _LATCHED)
            numbers = np.empty(len(self._qpos) + len(self._qvel))
            if len(self._qpos):
                numbers[: len(self._qpos)] = data["qpos"][index, self._column, self._qpos]
                numbers[len(self._qpos) :] = data["qvel"][index, self._column, self._qvel]
            joints = self._joints.fill(time_ns, numbers)
            topic = f"{self._root}/joint_states"
            self._bag.add(topic, "sensor_msgs/msg/JointState", time_ns, joints)
            ordered: Any = poses[:, [0, 1, 2, 4, 5, 6, 3]]  # ROS writes quaternions xyzw
            self._bag.add(
                "/tf",
                "tf2_msgs/msg/TFMessage",
                time_ns,
                self._transforms.fill(time_ns, ordered.ravel()),
            )


def _transforms(names: Sequence[str]) -> CdrTemplate:
    """Every body's frame hangs on its environment's."""
    template = CdrTemplate().uint(len(names) - 1)
    for name in names[1:]:
        template.header(names[0]).text(name).doubles(7)
    return template

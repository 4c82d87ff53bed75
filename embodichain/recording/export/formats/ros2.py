"""A ROS 2 bag (MCAP, profile ``ros2``): joint states, transforms, robot description as URDF.

For each environment ``/env_I/joint_states`` and ``/env_I/robot_description``; one ``/tf``. Frames
and links are named ``env_I/uid/link``; their parent is ``env_I``. rosbags has the message types.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

import mujoco
import numpy as np

from embodichain.lab.sim.engine.api import F64
from embodichain.recording.export.format_register import log_format, required
from embodichain.recording.export.log_parts import Part, poses
from embodichain.recording.format.container.mcap_writer import McapWriter
from embodichain.recording.read.api import Log
from embodichain.recording.views.channels import frame_names, scalar_joints
from embodichain.recording.views.shapes import Shape, shapes
from embodichain.utils.math import quat_multiply, quat_rotate, quat_to_rpy

__all__ = ["urdf", "write_ros2"]

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
"""Quality of service of topics that late subscribers also receive (ROS 2: transient local)."""
_ENDLESS = 1e9
"""Metres that a slide without a range may move: in a URDF each prismatic joint has a limit."""
_ZERO, _UNIT = np.zeros(3), np.array([1.0, 0, 0, 0])


@log_format("ros2", suffix=".mcap", requires="embodichain[ros2]")
def write_ros2(log: Log, part: Part, path: Path) -> None:
    """Write the bag of the selected environment, or of the viewed ones.

    Raises:
        ConfigError: If rosbags is not installed.
    """
    types: Any = required("rosbags.typesys", "ros2")
    with path.open("xb") as stream:
        bag = _Bag(McapWriter(stream, "zstd", "embodichain", profile="ros2"), types)
        steps = (_write_env(bag, log, env, part) for env in part.envs_of(log))
        for _ in zip(*steps, strict=True):
            pass  # each iteration writes one control step of each environment
        bag.writer.finish()


class _Bag:
    """Channels of a bag, declared at the first message."""

    def __init__(self, writer: McapWriter, types: Any) -> None:
        self.writer = writer
        self._store = types.get_typestore(types.Stores.ROS2_HUMBLE)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def make(self, kind: str, *fields: Any) -> Any:
        """Return a message of a type, from its fields in order."""
        package, name = kind.split("/")
        return self._store.types[f"{package}/msg/{name}"](*fields)

    def header(self, frame_id: str = "") -> Any:
        """Return a `std_msgs/Header`."""
        return self.make("std_msgs/Header", self.make("builtin_interfaces/Time", 0, 0), frame_id)

    def frame(self, parent: str, name: str) -> Any:
        """Return a `geometry_msgs/TransformStamped`."""
        translation = self.make("geometry_msgs/Vector3", 0.0, 0.0, 0.0)
        rotation = self.make("geometry_msgs/Quaternion", 0.0, 0.0, 0.0, 1.0)
        transform = self.make("geometry_msgs/Transform", translation, rotation)
        return self.make("geometry_msgs/TransformStamped", self.header(parent), name, transform)

    def add(self, topic: str, time_ns: int, message: Any, qos: str = "") -> None:
        """Write a message."""
        kind = message.__msgtype__
        if kind not in self._schemas:
            definition, _ = self._store.generate_msgdef(kind, ros_version=2)
            self._schemas[kind] = self.writer.schema(kind, "ros2msg", definition.encode())
        if topic not in self._channels:
            metadata = {"offered_qos_profiles": qos}
            self._channels[topic] = self.writer.channel(topic, "cdr", self._schemas[kind], metadata)
        data = bytes(self._store.serialize_cdr(message, kind))
        self.writer.message(self._channels[topic], time_ns, data)


def _write_env(bag: _Bag, log: Log, env_id: int, part: Part) -> Iterator[None]:
    """Write the messages of one environment, one control step at a time."""
    root, *names = frame_names(log.model, env_id)
    joints = scalar_joints(log.model)
    ids = np.array(list(joints.values()), np.int64)
    qpos, qvel = log.model.jnt_qposadr[ids], log.model.jnt_dofadr[ids]
    none = np.zeros(0)
    state = bag.make("sensor_msgs/JointState", bag.header(), list(joints), none, none, none)
    frames = [bag.frame(root, name) for name in names]
    tf = bag.make("tf2_msgs/TFMessage", frames)
    stamps = [state.header.stamp, *(frame.header.stamp for frame in frames)]
    for index, (step, data, _) in enumerate(poses(log, env_id, part)):
        time_ns = log.header.start_ns + step * log.header.period_ns
        if index == 0:
            text = bag.make("std_msgs/String", urdf(log.model, env_id))
            bag.add(f"/{root}/robot_description", time_ns, text, _LATCHED)
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


# -- robot description -----------------------------------------------------------------------------


def urdf(model: mujoco.MjModel, env_id: int) -> str:
    """The compiled model as URDF: every body is a link with the name of its frame in `/tf`.

    The root is the link ``env_I``. A hinge without a range is ``continuous``, a slide without one
    has a limit of `_ENDLESS`. Primitives keep their shape; a mesh is replaced by its bounding
    box, because the description is a single string without files.
    """
    names, by_body = frame_names(model, env_id), dict[int, list[Shape]]()
    for shape in shapes(model):
        by_body.setdefault(shape.body, []).append(shape)
    robot = Element("robot", name=names[0])
    SubElement(robot, "link", name=names[0])
    for body in range(1, model.nbody):
        link = SubElement(robot, "link", name=names[body])
        if model.body_mass[body]:
            inertial = SubElement(link, "inertial")
            _add_origin(inertial, model.body_ipos[body], model.body_iquat[body])
            SubElement(inertial, "mass", value=_text(model.body_mass[body]))
            x, y, z = map(_text, model.body_inertia[body])
            SubElement(inertial, "inertia", ixx=x, iyy=y, izz=z, ixy="0", ixz="0", iyz="0")
        for shape in by_body.get(body, ()):
            _add_visuals(link, model, shape)
        _add_joints(robot, model, body, names)
    text: str = tostring(robot, encoding="unicode")
    return text


def _add_joints(robot: Element, model: mujoco.MjModel, body: int, names: list[str]) -> None:
    """Connect a body to its parent by a chain of its joints."""
    parent = names[int(model.body_parentid[body])]
    pos, quat = model.body_pos[body].copy(), model.body_quat[body].copy()
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    joints, scalar = range(first, first + count), scalar_joints(model)
    if int(model.body_mocapid[body]) >= 0 or not set(joints) <= set(scalar.values()):
        _join(robot, f"{names[body]}_floating", "floating", parent, names[body], pos, quat)
        return
    left = _ZERO  # translation from the current frame to the body's frame
    for number, joint in enumerate(joints):
        anchor = model.jnt_pos[joint]
        pos = pos + quat_rotate(quat, left + anchor)
        left = -anchor
        axis, zero = model.jnt_axis[joint], float(model.qpos0[model.jnt_qposadr[joint]])
        # A URDF joint is zero at qpos 0, not at the model's reference pose.
        if int(model.jnt_type[joint]) == mujoco.mjtJoint.mjJNT_HINGE:
            kind = "revolute" if model.jnt_limited[joint] else "continuous"
            turn = np.empty(4)
            mujoco.mju_axisAngle2Quat(turn, axis, -zero)
            quat = quat_multiply(quat, turn)
        else:
            kind = "prismatic"
            pos = pos - quat_rotate(quat, zero * axis)
        is_last = number == count - 1 and not left.any()
        child = names[body] if is_last else f"{names[body]}_joint_{number}"
        if not is_last:
            SubElement(robot, "link", name=child)
        name = model.joint(joint).name or f"joint_{joint}"
        made = _join(robot, name, kind, parent, child, pos, quat)
        SubElement(made, "axis", xyz=_text(axis))
        ends = model.jnt_range[joint] if model.jnt_limited[joint] else (-_ENDLESS, _ENDLESS)
        if kind != "continuous":
            low, high = map(_text, ends)
            SubElement(made, "limit", lower=low, upper=high, effort="0", velocity="0")
        parent, pos, quat = child, _ZERO, _UNIT
    if parent != names[body]:
        _join(robot, f"{names[body]}_fixed", "fixed", parent, names[body], pos + left, quat)


def _join(
    robot: Element, name: str, kind: str, parent: str, child: str, pos: F64, quat: F64
) -> Element:
    made = SubElement(robot, "joint", name=name, type=kind)
    SubElement(made, "parent", link=parent)
    SubElement(made, "child", link=child)
    _add_origin(made, pos, quat)
    return made


def _add_visuals(link: Element, model: mujoco.MjModel, shape: Shape) -> None:
    """Add a shape; a capsule is a cylinder with two spheres, a mesh its bounding box."""
    radius, _, half = shape.half
    kind = int(model.geom_type[shape.geom])
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        return
    ball = "sphere", {"radius": _text(radius)}
    if shape.kind in ("cylinder", "capsule"):
        rod = "cylinder", {"radius": _text(radius), "length": _text(2 * half)}
        ends = (-half, half) if shape.kind == "capsule" else ()
        parts = [(_ZERO, rod), *((np.array([0, 0, end]), ball) for end in ends)]
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        parts = [(_ZERO, ball)]
    else:
        box = model.geom_aabb[shape.geom]
        parts = [(box[:3], ("box", {"size": _text(2 * box[3:])}))]
    for offset, (tag, attributes) in parts:
        visual = SubElement(link, "visual")
        _add_origin(visual, shape.pos + quat_rotate(shape.quat, offset), shape.quat)
        SubElement(SubElement(visual, "geometry"), tag, attributes)
        material = SubElement(visual, "material", name=f"geom_{shape.geom}")
        SubElement(material, "color", rgba=_text(shape.rgba))


def _add_origin(owner: Element, pos: F64, quat: F64) -> None:
    SubElement(owner, "origin", xyz=_text(pos), rpy=_text(quat_to_rpy(quat)))


def _text(values: Any) -> str:
    """Format numbers for URDF without loss of precision."""
    return " ".join(repr(value) for value in np.atleast_1d(values).tolist())

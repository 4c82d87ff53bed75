"""A ROS 2 bag (MCAP, profile ``ros2``): joint states, transforms, robot description as URDF.

For each environment ``/env_I/joint_states`` and ``/env_I/robot_description``; one ``/tf``. Frames
and links are named ``env_I/uid/link``; their parent is ``env_I``. rosbags has the message types.
The bag's metadata ``drawn`` has what was drawn for each episode that ended.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement, tostring

import mujoco
import numpy as np

from embodichain.lab.sim.engine.api import F64
from embodichain.recording.export.format_register import log_format, required
from embodichain.recording.export.log_parts import Part, episodes_with_draws, poses
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
_NO_TRANSLATION = np.zeros(3)
_NO_ROTATION = np.array([1.0, 0, 0, 0])


@log_format("ros2", suffix=".mcap", requires="embodichain[ros2]")
def write_ros2(log: Log, part: Part, path: Path) -> None:
    """Write the bag of the selected environment, or of the viewed ones.

    Raises:
        ConfigError: If rosbags is not installed.
    """
    types: Any = required("rosbags.typesys", "ros2")
    with path.open("xb") as stream:
        bag = _Bag(McapWriter(stream, "zstd", "embodichain", profile="ros2"), types)
        writers = [_write_env(bag, log, env, part) for env in part.envs_of(log)]
        # Each iteration writes one control step of each environment, so that messages are in order.
        for _ in zip(*writers, strict=True):
            pass
        drawn = _drawn_text(log, part)
        if drawn:
            bag.writer.metadata("drawn", drawn)
        bag.writer.finish()


def _drawn_text(log: Log, part: Part) -> dict[str, str]:
    """``env_I/episode_K`` -> what was drawn for the episode, as JSON."""
    envs = part.envs_of(log)
    return {
        f"env_{episode.env}/episode_{episode.episode}": json.dumps(episode.drawn)
        for episode in episodes_with_draws(log, part)
        if episode.env in envs
    }


class _Bag:
    """Channels of a bag, declared at the first message.

    Args:
        writer: Writer of the file.
        types: The module ``rosbags.typesys``.
    """

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
    model = log.model
    root, *names = frame_names(model, env_id)
    joints = scalar_joints(model)
    joint_ids = np.array(list(joints.values()), np.int64)
    qpos_ids = model.jnt_qposadr[joint_ids]
    qvel_ids = model.jnt_dofadr[joint_ids]

    # Two messages, whose times and numbers are replaced in each step.
    empty = np.zeros(0)
    state = bag.make("sensor_msgs/JointState", bag.header(), list(joints), empty, empty, empty)
    frames = [bag.frame(root, name) for name in names]
    tf = bag.make("tf2_msgs/TFMessage", frames)
    stamps = [state.header.stamp, *(frame.header.stamp for frame in frames)]

    is_first = True
    for step, data, _ in poses(log, env_id, part):
        time_ns = log.header.start_ns + step * log.header.period_ns
        if is_first:
            text = bag.make("std_msgs/String", urdf(model, env_id))
            bag.add(f"/{root}/robot_description", time_ns, text, _LATCHED)
            is_first = False
        for stamp in stamps:
            stamp.sec, stamp.nanosec = divmod(time_ns, 1_000_000_000)
        state.position = data.qpos[qpos_ids]
        state.velocity = data.qvel[qvel_ids]
        bag.add(f"/{root}/joint_states", time_ns, state)
        positions = data.xpos[1:].tolist()
        quats = data.xquat[1:].tolist()
        for frame, position, quat in zip(frames, positions, quats, strict=True):
            _set_transform(frame.transform, position, quat)
        bag.add("/tf", time_ns, tf)
        yield


def _set_transform(transform: Any, position: list[float], quat: list[float]) -> None:
    """Set a `geometry_msgs/Transform` to a position in metres and a quaternion wxyz."""
    translation = transform.translation
    translation.x, translation.y, translation.z = position
    rotation = transform.rotation
    rotation.w, rotation.x, rotation.y, rotation.z = quat


# -- robot description -----------------------------------------------------------------------------


def urdf(model: mujoco.MjModel, env_id: int) -> str:
    """The compiled model as URDF: every body is a link with the name of its frame in `/tf`.

    The root is the link ``env_I``. A hinge without a range is ``continuous``, a slide without one
    has a limit of `_ENDLESS`. Primitives keep their shape; a mesh is replaced by its bounding
    box, because the description is a single string without files.
    """
    names = frame_names(model, env_id)
    shapes_of: dict[int, list[Shape]] = {}
    for shape in shapes(model):
        shapes_of.setdefault(shape.body, []).append(shape)
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
        for shape in shapes_of.get(body, []):
            _add_visuals(link, model, shape)
        _add_joints(robot, model, body, names)
    return tostring(robot, encoding="unicode")


def _add_joints(robot: Element, model: mujoco.MjModel, body: int, names: list[str]) -> None:
    """Connect a body to its parent by a chain of its joints.

    Between two joints of a body there is a link without mass.
    """
    link = names[body]
    parent = names[int(model.body_parentid[body])]
    pos = model.body_pos[body].copy()
    quat = model.body_quat[body].copy()
    first = int(model.body_jntadr[body])
    count = int(model.body_jntnum[body])
    joints = range(first, first + count)
    is_mocap = int(model.body_mocapid[body]) >= 0
    if is_mocap or not set(joints) <= set(scalar_joints(model).values()):
        _add_joint(
            robot,
            f"{link}_floating",
            kind="floating",
            parent=parent,
            child=link,
            pos=pos,
            quat=quat,
        )
        return
    to_body = _NO_TRANSLATION  # from the current frame to the body's frame
    for number, joint in enumerate(joints):
        anchor = model.jnt_pos[joint]
        pos = pos + quat_rotate(quat, to_body + anchor)
        to_body = -anchor
        axis = model.jnt_axis[joint]
        is_limited = bool(model.jnt_limited[joint])
        # A URDF joint is zero at qpos 0, not at the model's reference pose.
        reference = float(model.qpos0[model.jnt_qposadr[joint]])
        if int(model.jnt_type[joint]) == mujoco.mjtJoint.mjJNT_HINGE:
            kind = "revolute" if is_limited else "continuous"
            rotation = np.empty(4)
            mujoco.mju_axisAngle2Quat(rotation, axis, -reference)
            quat = quat_multiply(quat, rotation)
        else:
            kind = "prismatic"
            pos = pos - quat_rotate(quat, reference * axis)
        if number == count - 1 and not to_body.any():
            child = link
        else:
            child = f"{link}_joint_{number}"
            SubElement(robot, "link", name=child)
        name = model.joint(joint).name or f"joint_{joint}"
        element = _add_joint(robot, name, kind=kind, parent=parent, child=child, pos=pos, quat=quat)
        SubElement(element, "axis", xyz=_text(axis))
        if kind != "continuous":
            low, high = model.jnt_range[joint] if is_limited else (-_ENDLESS, _ENDLESS)
            SubElement(
                element,
                "limit",
                lower=_text(low),
                upper=_text(high),
                effort="0",
                velocity="0",
            )
        parent = child
        pos = _NO_TRANSLATION
        quat = _NO_ROTATION
    if parent != link:
        _add_joint(
            robot,
            f"{link}_fixed",
            kind="fixed",
            parent=parent,
            child=link,
            pos=pos + to_body,
            quat=quat,
        )


def _add_joint(
    robot: Element, name: str, *, kind: str, parent: str, child: str, pos: F64, quat: F64
) -> Element:
    """Add a joint between two links; its origin is in the frame of the parent."""
    joint = SubElement(robot, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    _add_origin(joint, pos, quat)
    return joint


class _Visual(NamedTuple):
    """A geometry of a URDF.

    Attributes:
        tag: Name of its element.
        attributes: Its sizes.
        offset: (3,) its centre in the shape's frame, metres.
    """

    tag: str
    attributes: dict[str, str]
    offset: F64 = _NO_TRANSLATION


def _add_visuals(link: Element, model: mujoco.MjModel, shape: Shape) -> None:
    """Add the geometries of a shape."""
    for visual in _visuals(model, shape):
        element = SubElement(link, "visual")
        center = shape.pos + quat_rotate(shape.quat, visual.offset)
        _add_origin(element, center, shape.quat)
        geometry = SubElement(element, "geometry")
        SubElement(geometry, visual.tag, visual.attributes)
        material = SubElement(element, "material", name=f"geom_{shape.geom}")
        SubElement(material, "color", rgba=_text(shape.rgba))


def _visuals(model: mujoco.MjModel, shape: Shape) -> list[_Visual]:
    """Geometries of a shape: a capsule is a cylinder with two spheres, a mesh its bounding box."""
    geom_type = int(model.geom_type[shape.geom])
    if geom_type == mujoco.mjtGeom.mjGEOM_PLANE:
        return []
    radius, _, half_length = shape.half
    if shape.kind in ("cylinder", "capsule"):
        sizes = {"radius": _text(radius), "length": _text(2 * half_length)}
        visuals = [_Visual("cylinder", sizes)]
        if shape.kind == "capsule":
            for end in (-half_length, half_length):
                cap = _Visual("sphere", {"radius": _text(radius)}, np.array([0, 0, end]))
                visuals.append(cap)
        return visuals
    if geom_type == mujoco.mjtGeom.mjGEOM_SPHERE:
        return [_Visual("sphere", {"radius": _text(radius)})]
    box = model.geom_aabb[shape.geom]
    return [_Visual("box", {"size": _text(2 * box[3:])}, box[:3])]


def _add_origin(owner: Element, pos: F64, quat: F64) -> None:
    SubElement(owner, "origin", xyz=_text(pos), rpy=_text(quat_to_rpy(quat)))


def _text(values: Any) -> str:
    """Format numbers for URDF without loss of precision."""
    return " ".join(repr(value) for value in np.atleast_1d(values).tolist())

"""A compiled model as URDF: what programs of the ROS world know of a robot.

Every body is a link, named as its frame in `/tf`. Primitives keep their shape; a mesh is shown as
the box around it, because a description that is one string cannot carry files.
"""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement, tostring

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.recording.views.motion import frame_names
from embodichain.recording.views.shapes import Shape, shapes
from embodichain.utils.math import quat_multiply, quat_rotate

__all__ = ["urdf"]

_ZERO, _UNIT = np.zeros(3), np.array([1.0, 0, 0, 0])
_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_SPHERE, _PLANE = int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_PLANE)

Floats = NDArray[np.float64]


def urdf(model: mujoco.MjModel, env_id: int) -> str:
    """The description of one environment: everything in it hangs on the link ``env_I``.

    Args:
        model: The model.
        env_id: The environment, whose name links carry.
    """
    names, by_body = frame_names(model, env_id), dict[int, list[Shape]]()
    for shape in shapes(model):
        by_body.setdefault(shape.body, []).append(shape)
    robot = Element("robot", name=names[0])
    SubElement(robot, "link", name=names[0])
    for body in range(1, model.nbody):
        link = SubElement(robot, "link", name=names[body])
        _inertial(link, model, body)
        for shape in by_body.get(body, ()):
            _visual(link, model, shape)
        _joints(robot, model, body, names)
    text: str = tostring(robot, encoding="unicode")
    return text


def _joints(robot: Element, model: mujoco.MjModel, body: int, names: list[str]) -> None:
    """Join a body to its parent: as many joints, one after the other, as it has."""
    parent = names[int(model.body_parentid[body])]
    pos, quat = model.body_pos[body].copy(), model.body_quat[body].copy()
    first = int(model.body_jntadr[body])
    count = int(model.body_jntnum[body])
    joints = range(first, first + count)
    scalar = all(int(model.jnt_type[j]) in (_HINGE, _SLIDE) for j in joints)
    if not scalar or int(model.body_mocapid[body]) >= 0:
        _join(robot, f"{names[body]}_floating", "floating", parent, names[body], pos, quat)
        return
    left = _ZERO  # from the frame that was reached back to the body's own
    for number, joint in enumerate(joints):
        anchor = model.jnt_pos[joint]
        pos = pos + quat_rotate(quat, left + anchor)
        left = -anchor
        axis, zero = model.jnt_axis[joint], float(model.qpos0[model.jnt_qposadr[joint]])
        hinge = int(model.jnt_type[joint]) == _HINGE
        if hinge:  # the joint's zero is where qpos is 0, not where the model was drawn
            quat = quat_multiply(quat, _turn(axis, -zero))
        else:
            pos = pos - quat_rotate(quat, zero * axis)
        whole = number == count - 1 and not left.any()
        child = names[body] if whole else f"{names[body]}_joint_{number}"
        if not whole:
            SubElement(robot, "link", name=child)
        name = model.joint(joint).name or f"joint_{joint}"
        made = _join(robot, name, _kind(model, joint, hinge), parent, child, pos, quat)
        SubElement(made, "axis", xyz=_text(axis))
        if model.jnt_limited[joint]:
            low, high = model.jnt_range[joint]
            SubElement(
                made, "limit", lower=_number(low), upper=_number(high), effort="0", velocity="0"
            )
        parent, pos, quat = child, _ZERO, _UNIT
    if parent != names[body]:
        _join(robot, f"{names[body]}_fixed", "fixed", parent, names[body], pos + left, quat)


def _kind(model: mujoco.MjModel, joint: int, hinge: bool) -> str:
    if not hinge:
        return "prismatic"
    return "revolute" if model.jnt_limited[joint] else "continuous"


def _join(
    robot: Element, name: str, kind: str, parent: str, child: str, pos: Floats, quat: Floats
) -> Element:
    made = SubElement(robot, "joint", name=name, type=kind)
    SubElement(made, "parent", link=parent)
    SubElement(made, "child", link=child)
    _origin(made, pos, quat)
    return made


def _inertial(link: Element, model: mujoco.MjModel, body: int) -> None:
    if not model.body_mass[body]:
        return
    inertial = SubElement(link, "inertial")
    _origin(inertial, model.body_ipos[body], model.body_iquat[body])
    SubElement(inertial, "mass", value=_number(model.body_mass[body]))
    x, y, z = (_number(v) for v in model.body_inertia[body])
    SubElement(inertial, "inertia", ixx=x, iyy=y, izz=z, ixy="0", ixz="0", iyz="0")


def _visual(link: Element, model: mujoco.MjModel, shape: Shape) -> None:
    """Add a shape: primitives keep theirs, anything else is the box around it."""
    radius, _, half = shape.half.tolist()
    ball = "sphere", {"radius": _number(radius)}
    if int(model.geom_type[shape.geom]) == _PLANE:
        return
    if shape.kind in ("cylinder", "capsule"):
        rod = "cylinder", {"radius": _number(radius), "length": _number(2 * half)}
        ends = (-half, half) if shape.kind == "capsule" else ()
        parts = [(_ZERO, rod), *((np.array([0, 0, end]), ball) for end in ends)]
    elif int(model.geom_type[shape.geom]) == _SPHERE:
        parts = [(_ZERO, ball)]
    else:
        box = model.geom_aabb[shape.geom]
        parts = [(box[:3], ("box", {"size": _text(2 * box[3:])}))]
    for offset, (tag, attributes) in parts:
        visual = SubElement(link, "visual")
        _origin(visual, shape.pos + quat_rotate(shape.quat, offset), shape.quat)
        SubElement(SubElement(visual, "geometry"), tag, attributes)
        colour = SubElement(visual, "material", name=f"geom_{shape.geom}")
        SubElement(colour, "color", rgba=_text(shape.rgba))


def _origin(owner: Element, pos: Floats, quat: Floats) -> None:
    w, x, y, z = quat
    # Roll, pitch, yaw about fixed axes: R = Rz(yaw) Ry(pitch) Rx(roll).
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    SubElement(owner, "origin", xyz=_text(pos), rpy=_text(np.array([roll, pitch, yaw])))


def _turn(axis: Floats, angle: float) -> Floats:
    out = np.empty(4)
    mujoco.mju_axisAngle2Quat(out, axis, angle)
    return out


def _number(value: float) -> str:
    return repr(float(value))


def _text(values: Floats) -> str:
    return " ".join(map(_number, values))

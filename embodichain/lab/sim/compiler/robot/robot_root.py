"""The root of a robot: what is made of the top-level bodies and of the world of its file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import ArticulationCfg
from embodichain.lab.sim.compiler.geoms.poses import given_pose, initial_pose
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.robot.files.robot_joints import JOINT_TRANSMISSIONS
from embodichain.lab.sim.compiler.robot.floors import Plane, move_to_world
from embodichain.utils.errors import ConfigError
from embodichain.utils.math import quat_conjugate, quat_multiply, quat_rotate

__all__ = [
    "ROOT_NAME",
    "Placement",
    "Root",
    "bind_to_body",
    "leave_out_lights",
    "leave_out_sizes",
    "place",
    "remove_free_joint",
    "set_root",
    "take_sizes",
]

ROOT_NAME = "root"
"""Name of the body that is added where the file's world moves with the robot."""
_NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])
_FREE = mujoco.mjtJoint.mjJNT_FREE
_BODIES = (mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_XBODY)
_WORLD = ("", "world")
"""Names of the world in an equality."""


@dataclass(frozen=True, eq=False)
class Root:
    """A robot's root.

    Attributes:
        spec: The spec to use from now on.
        name: The body that has the robot's pose.
        wrapped: Whether it was added, as the parent of everything in the file's world.
        notes: Messages for the user, one line each.
    """

    spec: mujoco.MjSpec
    name: str
    wrapped: bool
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Placement:
    """Where a robot is at the start; positions (3,) in metres, quaternions (4,) wxyz.

    Attributes:
        world_pos, world_quat: The origin of its file's world, in the scene.
        root_pos, root_quat: Its root, in the scene.
        turn: The rotation from the root's orientation in the file to that in the scene.
    """

    world_pos: F64
    world_quat: F64
    root_pos: F64
    root_quat: F64
    turn: F64

    @property
    def is_unmoved(self) -> bool:
        """Whether the file's world is that of the scene."""
        return not self.world_pos.any() and np.array_equal(self.world_quat, _NO_TURN)


def place(cfg: ArticulationCfg, file_pose: F64) -> Placement:
    """Return where a robot is at the start.

    The pose of a floating base is absolute, position and rotation separately; what is not given is
    the file's. That of a fixed base is the pose of the file's world.

    Args:
        cfg: Its config.
        file_pose: (7,) pose of its root in the file's world: x, y, z, qw, qx, qy, qz.
    """
    pos = file_pose[:3]
    quat = file_pose[3:]
    if cfg.fix_base:
        world_pos, world_quat = initial_pose(cfg)
        root_pos = world_pos + quat_rotate(world_quat, pos)
        root_quat = quat_multiply(world_quat, quat)
        return Placement(world_pos, world_quat, root_pos, root_quat, world_quat)
    given_pos, given_quat = given_pose(cfg)
    root_pos = pos if given_pos is None else given_pos
    root_quat = quat if given_quat is None else given_quat
    turn = _NO_TURN if given_quat is None else quat_multiply(given_quat, quat_conjugate(quat))
    return Placement(np.zeros(3), _NO_TURN, root_pos, root_quat, turn)


def leave_out_lights(spec: mujoco.MjSpec) -> list[str]:
    """Remove a file's lights, for the scene has its own; return a message about them."""
    names = [repr(light.name or "unnamed") for light in spec.lights]
    if not names:
        return []
    for light in list(spec.lights):
        spec.delete(light)
    return [f"lights left out: {', '.join(names)}"]


def leave_out_sizes(spec: mujoco.MjSpec) -> list[str]:
    """Remove sizes that a scene of several files cannot take from one; return a message."""
    sizes = [f"{name}={getattr(spec, name)}" for name in _OWN_SIZES if getattr(spec, name) > 0]
    for name in _OWN_SIZES:
        # MuJoCo's own values: -1 lets it choose.
        setattr(spec, name, 0 if name == "nuserdata" else -1)
    return [f"<size> left out: {', '.join(sizes)}"] if sizes else []


def set_root(
    spec: mujoco.MjSpec, fixed: bool, planes: Mapping[str, Plane], start: F64 | None
) -> Root:
    """Make the root a mocap or free body.

    A fixed base is a mocap body, so its pose is state and can differ between environments. It has
    no degrees of freedom and behaves as if fixed to the world, with one exception: MuJoCo lets the
    children of a fixed body collide with it, but not those of a mocap body
    (see `set_self_collision`).

    The root is the file's top-level body if there is one alone and nothing else is in the file's
    world. Else a body is added whose children are all of them, and to which the file's world
    moves: its shapes, its sites, and the ends of equalities in the world. Planes stay in the world.

    A floating base is the body with the file's free joint, which is kept as it is; what else is in
    the file's world stays where the file has it. Only a file without a free joint gets one.

    Args:
        spec: The file; it changes.
        fixed: Whether the base is fixed.
        planes: Planes of the file's world.
        start: (7,) pose of the body with the free joint at the start: x, y, z, qw, qx, qy, qz; None
            is the file's.

    Raises:
        ConfigError: If the file has no bodies, several that float, or shapes in its world that
            would float.
    """
    top_bodies = list(spec.worldbody.bodies)
    if not top_bodies:
        raise ConfigError("the file contains no bodies")
    free_joints = {
        body.name: joint for body in top_bodies for joint in body.joints if joint.type == _FREE
    }
    if len(free_joints) > 1:
        names = ", ".join(map(repr, free_joints))
        raise ConfigError(
            f"one articulation is one tree, but {len(free_joints)} bodies of the file float: "
            f"{names}; make all but one objects, or take the file as scene.fpath"
        )
    if free_joints and not fixed:
        return Root(spec, next(iter(free_joints)), wrapped=False, notes=())
    notes: list[str] = []
    for name, joint in free_joints.items():
        left_out = remove_free_joint(spec, joint)
        if left_out:
            notes.append(f"fix_base is true; left out with its free joint: {', '.join(left_out)}")
        body = spec.body(name)
        if start is not None and body.frame is None:
            body.pos = start[:3]
            body.quat = start[3:]
    needs_wrapper = len(top_bodies) > 1 or bool(top_bodies[0].joints)
    if fixed:
        needs_wrapper = needs_wrapper or _has_fixed_elements(spec, planes)
        if needs_wrapper:
            notes += _fix_mocap_bodies(top_bodies)
    else:
        notes += _fix_mocap_bodies(top_bodies)
        if needs_wrapper:
            _check_floating_shapes(spec, planes)
    if needs_wrapper:
        spec, root = _wrapped(spec, planes)
    else:
        root = top_bodies[0]
    root.mocap = fixed
    if not fixed:
        root.add_freejoint(name="free")
    return Root(spec, root.name, needs_wrapper, tuple(notes))


def _check_floating_shapes(spec: mujoco.MjSpec, planes: Mapping[str, Plane]) -> None:
    """Refuse shapes of the file's world that would float with a base that is added.

    Raises:
        ConfigError: If there are any.
    """
    shapes = [repr(geom.name) for geom in spec.worldbody.geoms if geom.name not in planes]
    if shapes:
        raise ConfigError(
            "fix_base is false, and shapes of the file's world would float along: "
            f"{', '.join(shapes)}; fix_base: true fixes them, or take them out of the file"
        )


def remove_free_joint(spec: mujoco.MjSpec, joint: mujoco.MjsJoint) -> list[str]:
    """Remove a free joint, and the actuators and sensors on it, whose names are returned."""
    name = joint.name
    actuators = [
        actuator
        for actuator in spec.actuators
        if int(actuator.trntype) in JOINT_TRANSMISSIONS and actuator.target == name
    ]
    actuator_names = {actuator.name for actuator in actuators}
    removed: list[str] = []
    for sensor in list(spec.sensors):
        reads_joint = sensor.objtype == mujoco.mjtObj.mjOBJ_JOINT and sensor.objname == name
        reads_actuator = (
            sensor.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR and sensor.objname in actuator_names
        )
        if reads_joint or reads_actuator:
            removed.append(f"sensor {sensor.name!r}")
            spec.delete(sensor)
    for actuator in actuators:
        removed.append(f"actuator {actuator.name!r}")
        spec.delete(actuator)
    spec.delete(joint)
    return removed


def _fix_mocap_bodies(top_bodies: Sequence[mujoco.MjsBody]) -> list[str]:
    """Make mocap bodies beside others bodies of the robot; return a message about them."""
    if len(top_bodies) == 1:
        return []
    mocap = [body for body in top_bodies if body.mocap]
    for body in mocap:
        body.mocap = False
    names = ", ".join(repr(body.name) for body in mocap)
    return [f"mocap bodies are fixed to its base: {names}"] if mocap else []


def _has_fixed_elements(spec: mujoco.MjSpec, planes: Mapping[str, Plane]) -> bool:
    """Whether anything of a file's world has to move with the base."""
    world = spec.worldbody
    has_shapes = any(geom.name not in planes for geom in world.geoms)
    has_anchors = any(_is_anchored(equality) for equality in spec.equalities)
    return has_shapes or bool(world.sites) or has_anchors


def _is_anchored(equality: mujoco.MjsEquality) -> bool:
    """Whether an end of a connect or weld is in the world."""
    joins_bodies = equality.type in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
    if not joins_bodies or equality.objtype not in _BODIES:
        return False
    return equality.name1 in _WORLD or equality.name2 in _WORLD


def _wrapped(
    spec: mujoco.MjSpec, planes: Mapping[str, Plane]
) -> tuple[mujoco.MjSpec, mujoco.MjsBody]:
    """Attach the whole world of a spec, but for its planes, to a new body in a new spec."""
    outer = mujoco.MjSpec()
    outer.compiler.fusestatic = False
    name = ROOT_NAME
    while spec.body(name) is not None:
        name = f"{name}_"
    root = outer.worldbody.add_body(name=name)
    outer.option = spec.option
    take_sizes(outer, spec)
    outer.attach(spec, frame=root.add_frame(), prefix="")
    for plane, (pos, quat) in planes.items():
        move_to_world(outer, plane, pos, quat)
    bind_to_body(list(outer.equalities), name, np.zeros(3), _NO_TURN)
    for exclude in list(outer.excludes):  # the world's shapes are the root's now
        names = [name if n == "world" else n for n in (exclude.bodyname1, exclude.bodyname2)]
        if name in names:
            outer.add_exclude(bodyname1=names[0], bodyname2=names[1])
    return outer, root


_OWN_SIZES = ("nconmax", "njmax", "nstack", "nuserdata")
"""Sizes that a scene of several files cannot take from one."""
_SHARED_SIZES = (
    "memory",
    "nuser_body",
    "nuser_jnt",
    "nuser_geom",
    "nuser_site",
    "nuser_cam",
    "nuser_tendon",
    "nuser_actuator",
    "nuser_sensor",
)
"""Sizes of which a scene takes the largest of its files."""


def take_sizes(parent: mujoco.MjSpec, child: mujoco.MjSpec) -> None:
    """Raise the sizes of a model to those of one to be attached to it, which gives them up."""
    for name in _SHARED_SIZES:
        setattr(parent, name, max(getattr(parent, name), getattr(child, name)))
        setattr(child, name, -1)


def bind_to_body(equalities: Sequence[mujoco.MjsEquality], body: str, pos: F64, quat: F64) -> None:
    """Let the ends of equalities that are in the world be on a body.

    Args:
        equalities: They change.
        body: The body.
        pos: (3,) metres, the origin of the file's world in the body's frame.
        quat: (4,) wxyz, the file's world in the body's frame.
    """
    for equality in equalities:
        if not _is_anchored(equality):
            continue
        data = np.array(equality.data)
        is_weld = equality.type == mujoco.mjtEq.mjEQ_WELD
        has_relpose = is_weld and bool(data[6:10].any())  # else MuJoCo computes it
        if equality.name1 in _WORLD:
            equality.name1 = body
            if not is_weld:
                data[:3] = pos + quat_rotate(quat, data[:3])
            elif has_relpose:  # the pose of the second body in the first one's frame
                data[3:6] = pos + quat_rotate(quat, data[3:6])
                data[6:10] = quat_multiply(quat, data[6:10])
        else:
            equality.name2 = body
            if has_relpose:
                data[6:10] = quat_multiply(data[6:10], quat_conjugate(quat))
                data[3:6] -= quat_rotate(data[6:10], pos)
            if is_weld:  # its anchor is in the second body's frame
                data[:3] = pos + quat_rotate(quat, data[:3])
        equality.data = data

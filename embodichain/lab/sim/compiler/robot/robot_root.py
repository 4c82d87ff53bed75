"""The root of a robot: what is made of the top-level bodies and of the world of its file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import ArticulationCfg
from embodichain.lab.sim.compiler.geoms.poses import given_pose, initial_pose
from embodichain.lab.sim.compiler.index import F64
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
    pos, quat = file_pose[:3], file_pose[3:]
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
    lights = [light.name or "unnamed" for light in spec.lights]
    for light in list(spec.lights):
        spec.delete(light)
    return [f"lights left out: {', '.join(map(repr, lights))}"] if lights else []


def leave_out_sizes(spec: mujoco.MjSpec) -> list[str]:
    """Remove sizes that a scene of several files cannot take from one; return a message."""
    given = [f"{name}={getattr(spec, name)}" for name in _OWN_SIZES if getattr(spec, name) > 0]
    for name in _OWN_SIZES:
        setattr(spec, name, 0 if name == "nuserdata" else -1)
    return [f"<size> left out: {', '.join(given)}"] if given else []


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
    tops = list(spec.worldbody.bodies)
    if not tops:
        raise ConfigError("the file contains no bodies")
    free = {body.name: joint for body in tops for joint in body.joints if joint.type == _FREE}
    if len(free) > 1:
        names = ", ".join(map(repr, free))
        message = f"one articulation is one tree, but {len(free)} bodies of the file float: {names}"
        raise ConfigError(f"{message}; make all but one objects, or take the file as scene.fpath")
    if free and not fixed:
        return Root(spec, next(iter(free)), wrapped=False, notes=())
    notes: list[str] = []
    for name, joint in free.items():
        left_out = remove_free_joint(spec, joint)
        if left_out:
            notes.append(f"fix_base is true; left out with its free joint: {', '.join(left_out)}")
        if start is not None and spec.body(name).frame is None:
            body = spec.body(name)
            body.pos, body.quat = start[:3], start[3:]
    wrap = len(tops) > 1 or bool(tops[0].joints)
    if fixed:
        wrap = wrap or _holds_something(spec, planes)
    else:
        notes += _fixed_mocap(tops)
    shapes = [geom.name for geom in spec.worldbody.geoms if geom.name not in planes]
    if wrap and not fixed and shapes:
        listed = ", ".join(map(repr, shapes))
        message = f"fix_base is false, and shapes of the file's world would float along: {listed}"
        raise ConfigError(f"{message}; fix_base: true fixes them, or take them out of the file")
    if wrap:
        notes += _fixed_mocap(tops) if fixed else []
        spec, root = _wrapped(spec, planes)
    else:
        root = tops[0]
    root.mocap = fixed
    if not fixed:
        root.add_freejoint(name="free")
    return Root(spec, root.name, wrap, tuple(notes))


def remove_free_joint(spec: mujoco.MjSpec, joint: mujoco.MjsJoint) -> list[str]:
    """Remove a free joint, and the actuators and sensors on it, whose names are returned."""
    name = joint.name
    removed: list[str] = []
    on_joint = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    actuators = [a for a in spec.actuators if a.trntype in on_joint and a.target == name]
    names = {actuator.name for actuator in actuators}
    for sensor in list(spec.sensors):
        on_it = sensor.objtype == mujoco.mjtObj.mjOBJ_JOINT and sensor.objname == name
        on_actuator = sensor.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR and sensor.objname in names
        if on_it or on_actuator:
            removed.append(f"sensor {sensor.name!r}")
            spec.delete(sensor)
    for actuator in actuators:
        removed.append(f"actuator {actuator.name!r}")
        spec.delete(actuator)
    spec.delete(joint)
    return removed


def _fixed_mocap(tops: Sequence[mujoco.MjsBody]) -> list[str]:
    """Make mocap bodies bodies of the robot; return a message about them."""
    mocap = [body for body in tops if body.mocap and len(tops) > 1]
    for body in mocap:
        body.mocap = False
    names = ", ".join(repr(body.name) for body in mocap)
    return [f"mocap bodies are fixed to its base: {names}"] if mocap else []


def _holds_something(spec: mujoco.MjSpec, planes: Mapping[str, Plane]) -> bool:
    """Whether anything of a file's world has to move with the base."""
    world = spec.worldbody
    shapes = any(geom.name not in planes for geom in world.geoms)
    anchored = any(_is_anchored(equality) for equality in spec.equalities)
    return shapes or bool(world.sites) or anchored


def _is_anchored(equality: mujoco.MjsEquality) -> bool:
    """Whether an end of a connect or weld is in the world."""
    of_bodies = equality.type in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
    if not of_bodies or equality.objtype not in _BODIES:
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


_OWN_SIZES = "nconmax", "njmax", "nstack", "nuserdata"
_SIZES = (
    *("memory", "nuser_body", "nuser_jnt", "nuser_geom", "nuser_site", "nuser_cam"),
    *("nuser_tendon", "nuser_actuator", "nuser_sensor"),
)


def take_sizes(parent: mujoco.MjSpec, child: mujoco.MjSpec) -> None:
    """Raise the sizes of a model to those of one to be attached to it, which gives them up."""
    for name in _SIZES:
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
        weld = equality.type == mujoco.mjtEq.mjEQ_WELD
        given = weld and bool(data[6:10].any())  # a relpose; else MuJoCo computes it
        if equality.name1 in _WORLD:
            equality.name1 = body
            if not weld:
                data[:3] = pos + quat_rotate(quat, data[:3])
            elif given:  # the pose of the second body in the first one's frame
                data[3:6] = pos + quat_rotate(quat, data[3:6])
                data[6:10] = quat_multiply(quat, data[6:10])
        else:
            equality.name2 = body
            if given:
                data[6:10] = quat_multiply(data[6:10], quat_conjugate(quat))
                data[3:6] -= quat_rotate(data[6:10], pos)
            if weld:  # its anchor is in the second body's frame
                data[:3] = pos + quat_rotate(quat, data[:3])
        equality.data = data

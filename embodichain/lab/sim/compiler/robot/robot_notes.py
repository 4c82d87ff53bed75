"""Messages about a robot's file and its config: what has no effect, is left out, or will not do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import ArticulationCfg
from embodichain.lab.sim.compiler.geoms.poses import initial_pose
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import exact_pattern, match
from embodichain.lab.sim.compiler.robot.drives.pd_drives import DriveGains
from embodichain.lab.sim.compiler.robot.files.joint_couplings import JointCoupling
from embodichain.lab.sim.compiler.robot.files.robot_files import ModelFile
from embodichain.lab.sim.compiler.robot.files.robot_joints import FileJoints, movable_joints
from embodichain.utils.math import quat_conjugate, quat_rotate
from embodichain.utils.suggest import listing

__all__ = [
    "driven_mimics",
    "fixed_free_joints",
    "implausible_size",
    "overloaded_drives",
    "starts_beyond_limits",
    "without_effort",
    "without_velocity",
]

_LARGEST_ROBOT = 10.0
"""Metres: what is larger was most probably drawn in millimetres."""


def implausible_size(path: Path, model: mujoco.MjModel, qpos: F64) -> list[str]:
    """Return a message about a robot that is too large to be meant so.

    Args:
        path: Its file.
        model: The robot.
        qpos: (D,) its initial positions.
    """
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[movable_joints(model)]] = qpos
    mujoco.mj_kinematics(model, data)
    unbounded = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)
    # What is on the world itself is a room around the robot.
    is_part = ~np.isin(model.geom_type, unbounded) & (model.geom_bodyid > 0)
    parts = np.flatnonzero(is_part)
    if not len(parts):
        return []
    boxes = np.array([_box_around(model, data, int(geom)) for geom in parts])
    size = boxes[:, 1].max(axis=0) - boxes[:, 0].min(axis=0)
    largest = int(np.argmax(size))
    if size[largest] <= _LARGEST_ROBOT:
        return []
    dimension = "high" if largest == 2 else "long"
    text = f"{path}: the robot is {size[largest]:.3g} m {dimension}"
    is_mesh = model.geom_type[parts] == mujoco.mjtGeom.mjGEOM_MESH
    is_large = np.ptp(boxes, axis=1).max(axis=1) > 0.5 * _LARGEST_ROBOT
    meshes = {model.mesh(model.geom_dataid[i]).name for i in parts[is_mesh & is_large]}
    if not meshes:
        return [f"{text}: are its lengths in millimetres? Those of a URDF or MJCF are in metres"]
    scale = 'scale="0.001 0.001 0.001"'
    names = listing(sorted(meshes))
    return [f"{text}: are its meshes in millimetres? Write {scale} into <mesh> of {names}"]


def _box_around(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> F64:
    """(2, 3) the lowest and the highest coordinates of a shape, m."""
    axes = data.geom_xmat[geom].reshape(3, 3)
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        start = model.mesh_vertadr[mesh]
        vertices = model.mesh_vert[start : start + model.mesh_vertnum[mesh]] @ axes.T
        low = vertices.min(axis=0)
        high = vertices.max(axis=0)
    else:
        middle, half_size = np.split(model.geom_aabb[geom], 2)
        half = np.abs(axes) @ half_size
        low = axes @ middle - half
        high = axes @ middle + half
    box: F64 = data.geom_xpos[geom] + np.array([low, high])
    return box


def fixed_free_joints(cfg: ArticulationCfg, file: ModelFile) -> list[str]:
    """Return a message about free joints of the file that `fix_base` leaves out."""
    free = [
        f"{joint.name!r} of {body.name!r}"
        for body in file.spec.worldbody.bodies
        for joint in body.joints
        if joint.type == mujoco.mjtJoint.mjJNT_FREE
    ]
    if not cfg.fix_base or not free:
        return []
    why = "the base is fixed (fix_base: true, the default); fix_base: false lets it float"
    return [f"{file.path}: free joint {', '.join(free)} left out: {why}"]


def without_effort(
    cfg: ArticulationCfg, joints: FileJoints, mimics: Sequence[JointCoupling]
) -> list[str]:
    """Return a message about joints of URDF files whose effort limit, which is taken, is 0."""
    if cfg.drive_pros.max_effort != "file":
        return []
    place_of_zero = joints.limits.zero_effort
    driven = _leaders_with(place_of_zero, joints, mimics)
    if not driven:
        return []
    fact = _zero_is_no_limit("effort", "N", {name: place_of_zero[name] for name in driven})
    return [f"{fact}, in N m or N; a joint that shall not push needs stiffness 0 and damping 0"]


def without_velocity(
    cfg: ArticulationCfg, joints: FileJoints, mimics: Sequence[JointCoupling]
) -> list[str]:
    """Return a message about joints of URDF files whose velocity limit, which is taken, is 0."""
    if cfg.drive_pros.max_velocity != "file":
        return []
    place_of_zero = joints.limits.zero_velocity
    driven = _leaders_with(place_of_zero, joints, mimics)
    if not driven:
        return []
    fact = _zero_is_no_limit("velocity", "SPEED", {name: place_of_zero[name] for name in driven})
    return [f"{fact}, in rad/s or m/s"]


def _zero_is_no_limit(limit: str, value: str, places: Mapping[str, str]) -> str:
    """Say that a limit of 0 is not one, and where to write the right one.

    Args:
        limit: The attribute in the file: ``effort`` or ``velocity``.
        value: What is written in its place.
        places: Joints with such a limit -> file and line.
    """
    joints = ", ".join(f"{name!r} ({place})" for name, place in places.items())
    entries = ", ".join(f"{exact_pattern(name)}: {value}" for name in places)
    return (
        f'{limit}="0" is taken as no limit for joints {joints}: write their limits into the file, '
        f"or drive_pros.max_{limit}: {{{entries}}}"
    )


def _leaders_with(
    place_of_zero: Mapping[str, str], joints: FileJoints, mimics: Sequence[JointCoupling]
) -> list[str]:
    """The joints with a limit of 0 that do not follow others."""
    followers = {mimic.joint for mimic in mimics}
    return [
        name for i, name in enumerate(joints.names) if name in place_of_zero and i not in followers
    ]


def driven_mimics(
    cfg: ArticulationCfg,
    file: ModelFile,
    names: Sequence[str],
    mimics: Sequence[JointCoupling],
    parts: Mapping[str, Sequence[int]],
) -> list[str]:
    """Return a message about entries of `drive_pros` that pick mimic joints only."""
    leader_of = {mimic.joint: mimic.leader for mimic in mimics}
    idle_entries: list[str] = []
    for field in ("stiffness", "damping", "max_effort"):
        value = getattr(cfg.drive_pros, field)
        if not isinstance(value, Mapping):
            continue
        for pattern in value:
            picked = parts.get(pattern) or match(pattern, names, "joint", field)[0]
            if picked and all(i in leader_of for i in picked):
                pairs = ", ".join(f"{names[i]!r} mimics {names[leader_of[i]]!r}" for i in picked)
                idle_entries.append(f"{field}.{pattern} ({pairs})")
    if not idle_entries:
        return []
    entries = "; ".join(idle_entries)
    return [f"{file.path}: drive_pros has no effect on joints that follow: {entries}"]


def starts_beyond_limits(file: ModelFile, joints: FileJoints, qpos: F64) -> list[str]:
    """Return a message about joints of an MJCF that start where its limits push them back.

    Args:
        file: The file.
        joints: Its joints.
        qpos: (D,) the start; what the config gives is within the limits.
    """
    beyond = [
        f"{joint.name} {position:g} of [{joint.lower:g}, {joint.upper:g}]"
        for joint, position in zip(joints.rows, qpos.tolist(), strict=True)
        if not joint.is_urdf and (position < joint.lower or position > joint.upper)
    ]
    if not beyond:
        return []
    return [f"{file.path}: joints start outside their limits, as in the file: {', '.join(beyond)}"]


def overloaded_drives(
    cfg: ArticulationCfg, model: mujoco.MjModel, gains: DriveGains, qpos: F64
) -> list[str]:
    """Return a message if drives cannot bear the weight at the initial position."""
    data = mujoco.MjData(model)
    joints = movable_joints(model)
    data.qpos[model.jnt_qposadr[joints]] = qpos
    gravity = model.opt.gravity.copy()
    down = np.array([0.0, 0.0, -9.81])
    # The model is the robot alone, whose base is the world: gravity turns in its place.
    model.opt.gravity = quat_rotate(quat_conjugate(initial_pose(cfg)[1]), down)
    mujoco.mj_forward(model, data)
    model.opt.gravity = gravity
    needed = np.abs(data.qfrc_bias - data.qfrc_passive)[model.jnt_dofadr[joints]]
    weak = np.flatnonzero(gains.driven & (needed > gains.max_effort))
    if not len(weak):
        return []
    names = ", ".join(
        f"{model.joint(joints[i]).name} {needed[i]:.4g} of {gains.max_effort[i]:.4g}" for i in weak
    )
    advice = "the robot sinks; give it a lighter tool, a larger max_effort, or gravcomp"
    return [f"its weight at the initial position is more than drives bear ({names}): {advice}"]

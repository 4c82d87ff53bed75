"""`bent_home`, `lowest_point`: the initial pose of a new task's arm whose zero pose is stretched.

An arm at full stretch, or at the ends of its joints, moves its tool in two directions only.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

    from embodichain.cli.new_task.new_reach import ToolReach

__all__ = ["bent_home", "lowest_point"]

_BENDS = (0.4, 0.8, 1.2)
"""Angles in rad by which joints are bent from the first pose."""
_MOST_JOINTS = 6
"""Joints of the chain to the tool that are bent: 3 ** 6 poses are enough."""
_MOST_TRIALS = 8
"""Poses of each bend whose reach is computed, the most movable first."""
_MARGIN = 0.05
"""Share of a joint's range that is left free at both ends."""
_LOWER = 1e-3
"""Distance in metres by which a robot may hang lower than at first."""


def bent_home(
    reach: ToolReach, hinges: NDArray[np.bool_], sufficient_radius: float
) -> NDArray[np.float64]:
    """The pose nearest to the first one from which the tool reaches a cube that is large enough.

    A pose is left out if links touch that did not before, or if the robot hangs lower.

    Args:
        reach: The robot at its first pose.
        hinges: (K,) which of its joints turn; the others stay.
        sufficient_radius: Half of the side of that cube, m.

    Returns:
        (K,) joint positions, rad or m: of the largest cube if none is large enough.
    """
    start = reach.home
    first_contacts = _contacts(reach, start)
    first_lowest = lowest_point(reach.model, reach.data)
    best_pose = start
    best_radius = reach.radius(start, sufficient_radius)
    bendable = _chain(reach, hinges)
    for bend in _BENDS:
        poses = _bent_poses(reach, bendable, bend)
        poses.sort(key=lambda pose: (-_movability(reach, pose), np.abs(pose - start).sum()))
        trials = 0
        for pose in poses:
            if trials == _MOST_TRIALS or best_radius >= sufficient_radius:
                break
            new_contacts = _contacts(reach, pose) - first_contacts
            hangs_lower = lowest_point(reach.model, reach.data) < first_lowest - _LOWER
            if new_contacts or hangs_lower:
                continue
            trials += 1
            radius = reach.radius(pose, sufficient_radius)
            if radius > best_radius:
                best_pose = pose
                best_radius = radius
    return best_pose


def lowest_point(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Height of the lowest moving point, m: of boxes around cylinders and ellipsoids, a corner."""
    import mujoco

    heights = []
    for i, kind in enumerate(model.geom_type):
        is_fixed = model.body_treeid[model.geom_bodyid[i]] < 0  # to the world
        if is_fixed or kind == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        upwards = data.geom_xmat[i].reshape(3, 3)[2]
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[i]
            start = model.mesh_vertadr[mesh]
            vertices = model.mesh_vert[start : start + model.mesh_vertnum[mesh]]
            low = (vertices @ upwards).min()
        elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
            low = -model.geom_size[i, 0]
        elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            low = -model.geom_size[i, 0] - model.geom_size[i, 1] * abs(upwards[2])
        else:
            middle, half_size = np.split(model.geom_aabb[i], 2)
            low = upwards @ middle - np.abs(upwards) @ half_size
        heights.append(float(data.geom_xpos[i, 2] + low))
    return min(heights, default=0.0)


def _chain(reach: ToolReach, hinges: NDArray[np.bool_]) -> list[int]:
    """Hinges that move the tool, without the first: it turns the whole arm."""
    moves_tool = np.zeros(len(hinges), bool)
    for bend in (0.0, 0.3):  # a joint whose axis goes through the tool is seen when others bend
        reach.place(np.clip(reach.home + bend, reach.low, reach.high))
        moves_tool |= np.linalg.norm(reach.jacobian(), axis=0) > 1e-6
    chain = np.flatnonzero(moves_tool & hinges)
    return [int(i) for i in chain[1 : 1 + _MOST_JOINTS]]


def _bent_poses(reach: ToolReach, joints: list[int], bend: float) -> list[NDArray[np.float64]]:
    """Poses inside of the joints' ranges in which each joint is straight or bent to one side."""
    span = reach.high - reach.low
    margin = _MARGIN * np.where(np.isfinite(span), span, 0.0)
    poses = []
    for signs in itertools.product((0.0, -1.0, 1.0), repeat=len(joints)):
        pose = reach.home.copy()
        pose[joints] += bend * np.array(signs)
        is_inside = (pose >= reach.low + margin) & (pose <= reach.high - margin)
        if is_inside[joints].all():
            poses.append(pose)
    return poses


def _movability(reach: ToolReach, pose: NDArray[np.float64]) -> float:
    """The least velocity of the tool in a direction by joints at 1 rad/s, m/s, rounded."""
    reach.place(pose)
    velocities = np.linalg.svd(reach.jacobian()[reach.axes], compute_uv=False)
    return round(float(velocities.min(initial=np.inf)), 2)


def _contacts(reach: ToolReach, pose: NDArray[np.float64]) -> set[tuple[int, int]]:
    """Pairs of geoms in contact at a pose; `reach.data` is left there."""
    import mujoco

    reach.place(pose)
    mujoco.mj_collision(reach.model, reach.data)
    contacts = reach.data.contact
    return set(zip(contacts.geom1.tolist(), contacts.geom2.tolist(), strict=True))

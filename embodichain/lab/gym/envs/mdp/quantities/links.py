"""Observations of several links of an entity at once; L is their number."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.registry import quantity
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp._rotations import pose_matrix

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.api import F64

__all__ = ["link_pose", "link_velocity"]


def _one_or_all(values: F64) -> F64:
    """(N, L, ...), without L if that is 1."""
    return values[:, 0] if values.shape[1] == 1 else values


@quantity("observation")
def link_pose(
    env: TermContext, of: ResolvedEntity, to_matrix: bool = False, in_root_frame: bool = False
) -> F64:
    """Poses of the picked links, x, y, z, qw, qx, qy, qz: metres, wxyz.

    (N, 7) of one link, (N, L, 7) of L; as matrices (N, 4, 4) or (N, L, 4, 4). Isaac Lab's
    ``body_pose_w``.

    Args:
        of: The robot and links of it; without links its root.
        to_matrix: Whether to give matrices.
        in_root_frame: Whether poses are relative to the robot's root, instead of in the
            environment's frame.

    Example:
        ``{func: link_pose, params: {of: {uid: ur10, link_names: [ee_link]}}}``
    """
    position, quat = of.link_poses(in_root_frame)
    if to_matrix:
        return _one_or_all(pose_matrix(position, quat))
    return _one_or_all(np.concatenate([position, quat], axis=2))


@quantity("observation")
def link_velocity(env: TermContext, of: ResolvedEntity, in_root_frame: bool = False) -> F64:
    """Linear velocity of the picked links' origins in m/s, then angular in rad/s.

    (N, 6) of one link, (N, L, 6) of L. Isaac Lab's ``body_link_vel_w``.

    Args:
        of: The robot and links of it; without links its root.
        in_root_frame: Whether velocities are those minus the root's, in the root's axes, instead of
            in world axes.

    Example:
        ``{func: link_velocity, params: {of: {uid: ur10, link_names: [ee_link]}}}``
    """
    return _one_or_all(np.concatenate(of.link_velocities(in_root_frame), axis=2))

"""Quantities of two entities, or links: distances, angles, poses of one relative to the other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Angle, Body, Positive
from embodichain.lab.gym.envs.managers.terms.registry import quantity
from embodichain.lab.gym.envs.mdp._rows import angle_between, norm
from embodichain.lab.gym.envs.mdp.quantities.bodies import Rotation, as_rotation, pose_matrix, tilt
from embodichain.utils.math import quat_conjugate, quat_multiply, rotate_back

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.utils.array_types import Floats

__all__ = [
    "angle",
    "distance",
    "relative_orientation",
    "relative_pose",
    "relative_position",
    "relative_velocity",
    "within_pose",
]


@quantity()
def distance(env: TermContext, from_: Body, to: Body, use_xy_only: bool = False) -> Floats:
    """(N,) distance between the origins of two entities, m.

    Args:
        use_xy_only: Whether heights are ignored.

    Example:
        ``{func: distance, params: {from: {uid: ur10, link_names: [ee_link]}, to: {uid: goal}}}``
    """
    if use_xy_only:
        return norm(from_.vector_to(to)[:, :2])
    return from_.distance_to(to)


@quantity()
def angle(env: TermContext, from_: Body, to: Body | None = None) -> Floats:
    """(N,) angle of the rotation from one orientation to another, rad in [0, pi].

    Args:
        to: Likewise; None gives the angle of the z axis from the vertical, as `tilt`.

    Example:
        ``{func: angle, params: {from: {uid: ur10, link_names: [ee_link]}, to: {uid: goal}}}``
    """
    if to is None:
        return tilt(env, from_)
    return angle_between(from_.orientation(), to.orientation())


@quantity("reward", "metric", "termination")
def within_pose(
    env: TermContext,
    from_: Body,
    to: Body,
    position_threshold: Positive,
    orientation_threshold: Angle,
) -> NDArray[np.bool_]:
    """True where the positions and the orientations of two entities are close.

    Args:
        position_threshold: Metres.
        orientation_threshold: Radians, of the rotation from the first to the second.

    Example:
        ``{func: within_pose, params: {from: {uid: cube}, to: {uid: goal}, position_threshold:
        0.05, orientation_threshold: 0.1}}``
    """
    is_near: NDArray[np.bool_] = distance(env, from_, to) < position_threshold
    return is_near & (angle(env, from_, to) < orientation_threshold)


@quantity()
def relative_position(
    env: TermContext, from_: Body, to: Body, in_source_frame: bool = False
) -> Floats:
    """(N, 3) position of `to` minus that of `from`, m.

    Args:
        in_source_frame: Whether the vector is in the axes of `from`, instead of the environment's.

    Example:
        ``{func: relative_position, params: {from: {uid: ur10, link_names: [ee_link]}, to: {uid:
        goal}}}``
    """
    delta = from_.vector_to(to)
    return rotate_back(from_.axes(), delta) if in_source_frame else delta


@quantity("observation")
def relative_orientation(
    env: TermContext, from_: Body, to: Body, representation: Rotation = "quat"
) -> Floats:
    """Orientation of `to` in the frame of `from`: conj(q_from) q_to.

    Args:
        representation: ``quat`` (N, 4) wxyz with w >= 0; ``matrix`` (N, 3, 3); ``rot6d`` (N, 6),
            the matrix's first column, then its second (Zhou et al., CVPR 2019).

    Example:
        ``{func: relative_orientation, params: {from: {uid: cube}, to: {uid: goal}}}``
    """
    quat = quat_multiply(quat_conjugate(from_.orientation()), to.orientation())
    return as_rotation(quat, representation)


@quantity("observation")
def relative_pose(
    env: TermContext, from_: Body, to: Body, representation: Rotation = "quat"
) -> Floats:
    """Pose of `to` in the frame of `from`: position in m, then orientation.

    Args:
        representation: ``quat`` gives (N, 7), wxyz with w >= 0; ``rot6d`` (N, 9); ``matrix``
            (N, 4, 4).

    Example:
        ``{func: relative_pose, params: {from: {uid: cube}, to: {uid: goal}, representation:
        rot6d}}``
    """
    position = rotate_back(from_.axes(), from_.vector_to(to))
    quat = quat_multiply(quat_conjugate(from_.orientation()), to.orientation())
    if representation == "matrix":
        return pose_matrix(position, quat)
    return np.concatenate([position, as_rotation(quat, representation)], axis=1)


@quantity()
def relative_velocity(
    env: TermContext, from_: Body, to: Body, in_source_frame: bool = False
) -> Floats:
    """(N, 6) velocity of `to` minus that of `from`: linear m/s, then angular rad/s.

    The difference of the velocities of the two origins; the rotation of `from` is not subtracted.

    Args:
        in_source_frame: Whether it is in the axes of `from`, instead of the world's.

    Example:
        ``{func: relative_velocity, params: {from: {uid: ur10, link_names: [ee_link]}, to: {uid:
        cube}}}``
    """
    linear = to.linear_velocity() - from_.linear_velocity()
    angular = to.angular_velocity() - from_.angular_velocity()
    if in_source_frame:
        axes = from_.axes()
        linear = rotate_back(axes, linear)
        angular = rotate_back(axes, angular)
    return np.concatenate([linear, angular], axis=1)

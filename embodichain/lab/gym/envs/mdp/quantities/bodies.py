"""Quantities of one entity, or of one link, site or geom of it: position, orientation and velocity.

Robots' bases above all. Axes are the environment's unless `frame` says otherwise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from embodichain.lab.gym.envs.managers.param_types import Body, Frames, Positive, Vec3, Whole
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.managers.terms.registry import quantity
from embodichain.lab.gym.envs.mdp._rows import norm, squares, total
from embodichain.lab.gym.envs.mdp.shapes import Rate, gaussian_kernel
from embodichain.lab.sim.reads.body_motion import Frame
from embodichain.utils.arrays import contiguous, rows_at, zeros
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import quat_to_matrix

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.utils.array_types import Floats

__all__ = [
    "Heading",
    "LinkAcceleration",
    "Rotation",
    "angular_velocity",
    "as_rotation",
    "at_rest",
    "heading",
    "height",
    "linear_velocity",
    "link_pose",
    "link_velocity",
    "orientation",
    "pose_matrix",
    "position",
    "projected_gravity",
    "root_quat_w",
    "shape_index",
    "speed",
    "tilt",
    "unique_quat",
    "upright",
    "velocity",
    "yaw",
]

Rotation = Literal["quat", "matrix", "rot6d"]
Heading = Literal["yaw", "sin_cos"]


def unique_quat(quat: Floats) -> Floats:
    """The one of q and -q (the same rotation) with w >= 0, (..., 4)."""
    return np.where(quat[..., :1] < 0.0, -quat, quat)


def as_rotation(quat: Floats, kind: Rotation) -> Floats:
    """Orientations as quaternions with w >= 0, matrices, or six numbers.

    Six numbers are the first column of the matrix, then the second: a form without jumps (Zhou et
    al., "On the continuity of rotation representations in neural networks", CVPR 2019).

    Args:
        quat: (..., 4) unit wxyz.
        kind: The form.

    Returns:
        (..., 4), (..., 3, 3) or (..., 6).
    """
    if kind == "quat":
        return unique_quat(quat)
    matrix = quat_to_matrix(quat)
    if kind == "matrix":
        return matrix
    return np.concatenate([matrix[..., 0], matrix[..., 1]], axis=-1)


def heading(quat: Floats, kind: Heading) -> Floats:
    """Direction of the x axis in the horizontal plane, about z from the world's x axis.

    Args:
        quat: (N, 4) unit wxyz.
        kind: ``yaw``, the angle in (-pi, pi]; or ``sin_cos``, its sine and cosine, without a jump.

    Returns:
        (N, 1) rad or (N, 2); yaw 0 where the x axis is vertical.
    """
    w, x, y, z = (quat[:, i] for i in range(4))
    # The x axis in the horizontal plane: cosine and sine of the angle, times its length there.
    ahead = 1.0 - 2.0 * (y * y + z * z)
    left = 2.0 * (x * y + w * z)
    if kind == "yaw":
        return np.arctan2(left, ahead)[:, None]
    length = np.sqrt(ahead * ahead + left * left)
    is_vertical = length == 0.0
    length = np.where(is_vertical, 1.0, length)
    sine = left / length
    cosine = np.where(is_vertical, 1.0, ahead / length)
    return np.stack([sine, cosine], axis=1)


def pose_matrix(position: Floats, quat: Floats) -> Floats:
    """(..., 4, 4) of positions (..., 3) and unit wxyz quaternions (..., 4)."""
    matrix = zeros((*position.shape[:-1], 4, 4), position)
    matrix[..., :3, :3] = quat_to_matrix(quat)
    matrix[..., :3, 3] = position
    matrix[..., 3, 3] = 1.0
    return matrix


Axes = Annotated[
    Literal["xyz", "xy", "xz", "yz", "x", "y", "z"],
    Field(description="The columns: letters of xyz."),
]


_COLUMNS = {
    "xyz": slice(0, 3),
    "xy": slice(0, 2),
    "xz": slice(0, 3, 2),
    "yz": slice(1, 3),
    "x": slice(0, 1),
    "y": slice(1, 2),
    "z": slice(2, 3),
}


def _pick_axes(vectors: Floats, axes: Axes) -> Floats:
    """Columns of (N, 3) vectors, picked by their letters: a view."""
    return vectors[:, _COLUMNS[axes]]


@quantity()
def position(env: TermContext, of: Body, axes: Axes = "xyz") -> Floats:
    """(N, 3) position of an entity's origin in the environment's frame, m.

    Example:
        ``{func: position, params: {of: {uid: cube}}}``
    """
    return _pick_axes(of.position(), axes)


@quantity()
def height(env: TermContext, of: Body, above: float = 0.0) -> Floats:
    """(N,) height of an entity's origin above a level, m.

    Args:
        above: The level, metres above z = 0.

    Example:
        ``{func: height, params: {of: {uid: cube}, above: 0.05}}``
    """
    return of.position()[:, 2] - above


@quantity()
def shape_index(env: TermContext, entity_cfg: Whole, one_hot: bool = False) -> Floats:
    """(N,) number of the shape that an object has, in the order of its `any_of`, from 0.

    Args:
        entity_cfg: A rigid object with `any_of`.
        one_hot: Whether to return (N, K) instead: 1 in the column of the shape, else 0.

    Raises:
        ConfigError: If the object has no `any_of`.

    Example:
        ``{func: shape_index, params: {of: {uid: thing}, one_hot: true}}``
    """
    names = getattr(entity_cfg.asset, "shape_names", ())
    if not names:
        message = f"{entity_cfg.uid!r} has no any_of: there is one shape"
        raise ConfigError([Problem("entity_cfg.uid", message)])
    number = entity_cfg.rigid_object.read_shape()
    if one_hot:
        return rows_at(np.eye(len(names)), number)
    return number.astype(np.float64)


@quantity("observation")
def orientation(env: TermContext, of: Body, representation: Rotation = "rot6d") -> Floats:
    """Orientation of an entity in the environment's frame, in a chosen representation.

    Args:
        representation: ``quat`` (N, 4) wxyz with w >= 0; ``matrix`` (N, 3, 3); ``rot6d`` (N, 6),
            the matrix's first column, then its second (Zhou et al., CVPR 2019): continuous.

    Example:
        ``{func: orientation, params: {of: {uid: cube}, representation: rot6d}}``
    """
    return as_rotation(of.orientation(), representation)


@quantity("observation")
def root_quat_w(env: TermContext, of: Body, make_quat_unique: bool = False) -> Floats:
    """(N, 4) orientation of the root in the environment's frame, wxyz.

    Isaac Lab's and mjlab's observation of the same name.

    Args:
        of: The robot or object.
        make_quat_unique: Whether to take the one of q and -q that has w >= 0.

    Example:
        ``{func: root_quat_w, params: {of: {uid: go}, make_quat_unique: true}}``
    """
    quat = of.orientation()
    return unique_quat(quat) if make_quat_unique else quat


@quantity()
def yaw(env: TermContext, of: Body, representation: Heading = "yaw") -> Floats:
    """Heading of an entity: the direction of its x axis in the horizontal plane.

    Args:
        representation: ``yaw`` (N, 1), the angle in (-pi, pi] rad about z; ``sin_cos`` (N, 2), its
            sine and cosine, which are continuous.

    Example:
        ``{func: yaw, params: {of: {uid: cube}, representation: sin_cos}}``
    """
    return heading(of.orientation(), representation)


@quantity()
def projected_gravity(env: TermContext, of: Body, axes: Axes = "xyz") -> Floats:
    """(N, 3) the unit vector of gravity in a body's axes: (0, 0, -1) when upright.

    It measures roll and pitch, and not yaw. It follows the scene's gravity, also where an event
    draws it, as Isaac Lab's does; without gravity it is (0, 0, 0).

    Example:
        ``{func: projected_gravity, params: {of: {uid: go}}}``
    """
    return _pick_axes(of.gravity(), axes)


@quantity()
def tilt(
    env: TermContext, of: Body, upwards: Literal["world", "against_gravity"] = "world"
) -> Floats:
    """(N,) angle of a body's z axis from the vertical, rad: 0 when upright, pi upside down.

    Args:
        upwards: The vertical: the ``world``'s z axis, or ``against_gravity``, the arc cosine of
            minus the z column of `projected_gravity`; pi / 2 where there is no gravity.

    Example:
        ``{func: tilt, params: {of: {uid: go}}}``
    """
    if upwards == "against_gravity":
        down = projected_gravity(env, of)[:, 2]
        return np.arccos(contiguous(np.minimum(np.maximum(-down, -1.0), 1.0)))
    up = of.axes()[:, 2]
    # Exact at both ends, unlike an arc cosine. With the copy, rounding does not depend on N.
    return np.arctan2(norm(up[:, :2]), contiguous(up[:, 2]))


@quantity()
def upright(env: TermContext, of: Body, std: Positive | None = None) -> Floats:
    """(N,) uprightness of a body's z axis: (1 + cos(tilt)) / 2, or exp(-sin^2(tilt) / std^2).

    The second is mjlab's of the same name; it is the same upright and upside down.

    Args:
        std: The width of the second formula; None is the first.

    Example:
        ``{func: upright, params: {of: {uid: go}, std: 0.45}}``
    """
    if std is None:
        return 0.5 * (1.0 + of.axes()[:, 2, 2])
    return gaussian_kernel(squares(of.axes()[:, 2, :2]), std)


@quantity()
def linear_velocity(
    env: TermContext, of: Body, frame: Frame = "world", axes: Axes = "xyz"
) -> Floats:
    """(N, 3) linear velocity of an entity's origin, m/s.

    Isaac Lab's is that of the root link's centre of mass; mjlab's ``link`` velocities are the same.

    Args:
        frame: The axes: of the ``world``, of the ``body`` itself, or of its heading (``yaw``),
            which are level and turned to where its x axis points.

    Example:
        ``{func: linear_velocity, params: {of: {uid: go}, frame: body}}``
    """
    return _pick_axes(of.linear_velocity(frame), axes)


@quantity()
def angular_velocity(
    env: TermContext, of: Body, frame: Frame = "world", axes: Axes = "xyz"
) -> Floats:
    """(N, 3) angular velocity of an entity, rad/s; with ``frame: body`` that of a gyroscope.

    Args:
        frame: The axes: of the ``world``, of the ``body`` itself, or of its heading (``yaw``).

    Example:
        ``{func: angular_velocity, params: {of: {uid: go}, frame: body}}``
    """
    return _pick_axes(of.angular_velocity(frame), axes)


@quantity("reward", "metric", name="link_acceleration")
class LinkAcceleration(Term):
    """(N, L) lengths of the linear accelerations of picked links' origins, m/s^2.

    The change of velocity since the last control step, by its duration; 0 in the first step of an
    episode.

    Args:
        of: The robot or object; without links, sites or geoms all of its links.

    Example:
        ``{func: link_acceleration, shape: l1, weight: -0.001, params: {of: {uid: go}}}``
    """

    def __init__(self, env: TermContext, of: Frames) -> None:
        if not of.frame_names and of.is_articulation:
            of = env.scene_entity({"uid": of.uid, "link_names": ".*"})
        self._engine = env.sim.engine
        self._frames = of.frames
        self._rate = Rate(env)

    def __call__(self) -> Floats:
        """(N, L) m/s^2."""
        linear, _ = self._frames.velocities(self._engine)
        acceleration = self._rate(linear.reshape(len(linear), -1)).reshape(linear.shape)
        x, y, z = (acceleration[..., i] for i in range(3))
        return np.sqrt(x * x + y * y + z * z)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Forget the velocities of these environments."""
        self._rate.reset(env_ids)

    def state_dict(self) -> dict[str, Any]:
        """The velocities of the last step (copies)."""
        return self._rate.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._rate.load_state_dict(state)


@quantity()
def velocity(env: TermContext, of: Body) -> Floats:
    """(N, 6) linear velocity of an entity's origin in m/s, then angular in rad/s, world axes.

    Example:
        ``{func: velocity, params: {of: {uid: cube}}}``
    """
    return np.concatenate([of.linear_velocity(), of.angular_velocity()], axis=1)


@quantity()
def speed(
    env: TermContext,
    of: Body,
    direction: Vec3 | None = None,
    frame: Literal["world", "body"] = "world",
) -> Floats:
    """(N,) length of an entity's linear velocity, or its component along a direction, m/s.

    Args:
        of: The entity, or a link, site or geom of one; the velocity is that of its origin.
        direction: A vector of any length; None gives the length of the velocity.
        frame: The axes of `direction`.

    Example:
        ``{func: speed, params: {of: {uid: go}, direction: [1, 0, 0], frame: body}}``

    Raises:
        ConfigError: If the direction is zero.
    """
    if direction is None:
        return norm(of.linear_velocity())
    vector = np.asarray(direction, np.float64)
    length = float(norm(vector[None])[0])
    if length == 0.0:
        raise ConfigError([Problem("direction", "must not be zero")])
    return total(of.linear_velocity(frame) * (vector / length))


@quantity("reward", "metric", "termination")
def at_rest(
    env: TermContext,
    of: Body,
    linear_threshold: Positive | None = None,
    angular_threshold: Positive | None = None,
) -> NDArray[np.bool_]:
    """True where the linear and angular speed of an entity are below thresholds.

    Args:
        linear_threshold: m/s; None means no condition.
        angular_threshold: rad/s; None means no condition.

    Example:
        ``{func: at_rest, params: {of: {uid: cube}, linear_threshold: 0.01, angular_threshold:
        0.1}}``

    Raises:
        ConfigError: If neither is given.
    """
    if linear_threshold is None and angular_threshold is None:
        raise ConfigError([Problem("", "give linear_threshold, angular_threshold or both")])
    linear_limit = np.inf if linear_threshold is None else linear_threshold
    angular_limit = np.inf if angular_threshold is None else angular_threshold
    is_slow: NDArray[np.bool_] = norm(of.linear_velocity()) < linear_limit
    return is_slow & (norm(of.angular_velocity()) < angular_limit)


def _one_or_all(values: Floats) -> Floats:
    """(N, L, ...), without L if that is 1."""
    return values[:, 0] if values.shape[1] == 1 else values


@quantity("observation")
def link_pose(
    env: TermContext, of: Frames, to_matrix: bool = False, in_root_frame: bool = False
) -> Floats:
    """Poses of the picked links, sites or geoms, x, y, z, qw, qx, qy, qz: metres, wxyz.

    (N, 7) of one link, (N, L, 7) of L; as matrices (N, 4, 4) or (N, L, 4, 4). Isaac Lab's
    ``body_pose_w``.

    Args:
        of: The robot, and links, sites or geoms of it; without them its root.
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
def link_velocity(env: TermContext, of: Frames, in_root_frame: bool = False) -> Floats:
    """Linear velocity of picked links', sites' or geoms' origins in m/s, then angular in rad/s.

    (N, 6) of one link, (N, L, 6) of L. Isaac Lab's ``body_link_vel_w``.

    Args:
        of: The robot, and links, sites or geoms of it; without them its root.
        in_root_frame: Whether the root's velocity is subtracted and the axes are the root's,
            instead of the world's.

    Example:
        ``{func: link_velocity, params: {of: {uid: ur10, link_names: [ee_link]}}}``
    """
    return _one_or_all(np.concatenate(of.link_velocities(in_root_frame), axis=2))

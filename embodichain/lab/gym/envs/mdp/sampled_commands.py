"""Command terms: velocities, poses and joint positions that are drawn uniformly."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import (
    Body,
    Box3,
    NonNegative,
    Range,
    UnitInterval,
    Whole,
)
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import CommandMarker, CommandTerm, Uniform
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.gym.envs.mdp._rows import angle_between, norm
from embodichain.lab.gym.envs.mdp.quantities.bodies import heading, unique_quat
from embodichain.lab.sim.compiler.names import match_every
from embodichain.utils.configclass import configclass
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import quat_multiply, quat_rotate, rpy_to_quat, wrapped

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.utils.array_types import Floats

__all__ = [
    "UniformJointPositionCommand",
    "UniformPoseCommand",
    "UniformVelocityCommand",
    "VelocityRanges",
]


@configclass
class VelocityRanges:
    """[low, high] of each column; `heading` is needed by environments that turn to a heading."""

    lin_vel_x: Range = (0.0, 0.0)
    """m/s, forward."""
    lin_vel_y: Range = (0.0, 0.0)
    """m/s, to the left."""
    ang_vel_z: Range = (0.0, 0.0)
    """rad/s, counter-clockwise."""
    heading: Range | None = None
    """rad, direction of the robot's x axis in the plane."""


@register_term("command", name="uniform_velocity")
class UniformVelocityCommand(CommandTerm):
    """(N, 3) velocity [vx, vy, wz] in the robot's heading frame, m/s and rad/s, drawn uniformly.

    Isaac Lab's ``UniformVelocityCommand``. The metrics ``error_vel_xy`` (m/s) and ``error_vel_yaw``
    (rad/s) are the distances of the root's velocity in its heading frame from the command.

    Example:
        ``{func: uniform_velocity, params: {of: {uid: go}, ranges: {lin_vel_x: [-1, 1]}}}``

    Args:
        entity_cfg: The robot; its root, or the picked link, site or geom, should follow the
            command.
        ranges: [low, high] of ``lin_vel_x``, ``lin_vel_y`` (m/s), ``ang_vel_z`` (rad/s) and, if
            environments should turn to a heading, ``heading`` (rad).
        heading_control_stiffness: Turning rate per radian of heading error, 1/s: wz is this times
            the error, clipped to the range of ``ang_vel_z``, recomputed in every step.
        rel_standing_envs: Fraction of draws with command zero.
        rel_heading_envs: Fraction of draws with a heading; 0 without the range ``heading``.
    """

    saved = ("values", "heading_target", "is_heading", "is_standing")
    names = ("lin_vel_x", "lin_vel_y", "ang_vel_z")

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Body,
        ranges: VelocityRanges,
        heading_control_stiffness: NonNegative = 1.0,
        rel_standing_envs: UnitInterval = 0.0,
        rel_heading_envs: UnitInterval = 1.0,
    ) -> None:
        count, full = env.num_envs, env.arrays.full
        self._env = env
        self._entity = entity_cfg
        self._has_heading = ranges.heading is not None and rel_heading_envs > 0
        # The last two decide whether an environment stands, and whether it turns to its heading.
        bounds = [
            ranges.lin_vel_x,
            ranges.lin_vel_y,
            ranges.ang_vel_z,
            ranges.heading or (0.0, 0.0),
            (0.0, 1.0),
            (0.0, 1.0),
        ]
        self._drawn = Uniform(
            "velocity",
            low=[low for low, _ in bounds],
            high=[high for _, high in bounds],
        )
        self._stiffness = heading_control_stiffness
        self._standing_share = rel_standing_envs
        self._heading_share = rel_heading_envs
        self.values: Floats = full((count, 3), 0.0)
        self.marker = CommandMarker("velocity", entity_cfg.body_id)
        self.heading_target: Floats = full(count, 0.0)
        self.is_heading: NDArray[np.bool_] = full(count, False, np.bool_)
        self.is_standing: NDArray[np.bool_] = full(count, False, np.bool_)

    def resample(self, env_ids: EnvIndex | None) -> None:
        """Draw velocities, headings, and which environments stand or turn to a heading."""
        drawn = self._drawn(self._env.command_manager, env_ids)
        where: Any = slice(None) if env_ids is None else env_ids
        is_standing = drawn[:, 4] < self._standing_share
        self.is_standing[where] = is_standing
        self.is_heading[where] = self._has_heading & (drawn[:, 5] < self._heading_share)
        self.heading_target[where] = drawn[:, 3]
        self.values[where] = np.where(is_standing[:, None], 0.0, drawn[:, :3])

    def update(self, env_ids: EnvIndex | None) -> None:
        """Compute wz of the environments that turn to a heading."""
        if not self._has_heading:
            return
        where: Any = slice(None) if env_ids is None else env_ids
        error = wrapped(self.heading_target - heading(self._entity.orientation(), "yaw")[:, 0])
        rate = np.clip(self._stiffness * error, self._drawn.low[2], self._drawn.high[2])
        is_turning = (self.is_heading & ~self.is_standing)[where]
        self.values[where, 2] = np.where(is_turning, rate[where], self.values[where, 2])

    def metrics(self) -> Mapping[str, Floats]:
        """Distance of the velocity from the command: in the plane, and about z."""
        error_xy = self._entity.linear_velocity("yaw")[:, :2] - self.values[:, :2]
        error_yaw = self._entity.angular_velocity()[:, 2] - self.values[:, 2]
        return {"error_vel_xy": norm(error_xy), "error_vel_yaw": np.abs(error_yaw)}


@register_term("command", name="uniform_pose")
class UniformPoseCommand(CommandTerm):
    """(N, 7) pose x, y, z, qw, qx, qy, qz in the frame of an entity's root, drawn uniformly.

    Isaac Lab's ``UniformPoseCommand``. If a link, site or geom is picked, the metrics
    ``position_error`` (m) and ``orientation_error`` (rad) are its distances from the command.

    Example:
        ``{func: uniform_pose, params: {of: {uid: go}, position_range: [[0,0,0],[1,1,1]]}}``

    Args:
        entity_cfg: The entity whose root is the frame, and the link, site or geom that should go
            there.
        position_range: [[x, y, z] low, [x, y, z] high], m.
        euler_range: The same for roll, pitch, yaw in rad, about the fixed axes x, y, z
            (R = Rz Ry Rx); None is the frame's own orientation.
        make_quat_unique: Whether to choose qw >= 0 of the two quaternions of a rotation.
    """

    names = ("x", "y", "z", "qw", "qx", "qy", "qz")

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Body,
        position_range: Box3,
        euler_range: Box3 | None = None,
        make_quat_unique: bool = False,
    ) -> None:
        self._env = env
        self._entity = entity_cfg
        self._root = ResolvedEntity(entity_cfg.uid, entity_cfg.asset)
        self._has_rotation = euler_range is not None
        angles = [[0.0] * 3] * 2 if euler_range is None else euler_range
        low, high = ([*position_range[i], *angles[i]] for i in (0, 1))
        self._pose = Uniform("pose", low, high)
        self._is_quat_unique = make_quat_unique
        self.values: Floats = env.arrays.full((env.num_envs, 7), 0.0)
        self.values[:, 3] = 1.0
        self.marker = CommandMarker("pose", self._root.body_id)

    def resample(self, env_ids: EnvIndex | None) -> None:
        """Draw poses."""
        drawn = self._pose(self._env.command_manager, env_ids)
        where: Any = slice(None) if env_ids is None else env_ids
        self.values[where, :3] = drawn[:, :3]
        if not self._has_rotation:
            return
        quat = rpy_to_quat(drawn[:, 3:])
        if self._is_quat_unique:
            quat = unique_quat(quat)
        self.values[where, 3:] = quat

    def world(self) -> tuple[Floats, Floats]:
        """The commanded position (N, 3) and wxyz orientation (N, 4) in the environment's frame."""
        root_quat = self._root.orientation()
        position = self._root.position() + quat_rotate(root_quat, self.values[:, :3])
        return position, quat_multiply(root_quat, self.values[:, 3:])

    def metrics(self) -> Mapping[str, Floats]:
        """Distance of the picked link, site or geom from the command."""
        if not self._entity.frame_names:
            return {}
        position, quat = self.world()
        return {
            "position_error": norm(self._entity.position() - position),
            "orientation_error": angle_between(self._entity.orientation(), quat),
        }


@register_term("command", name="uniform_joint_position")
class UniformJointPositionCommand(CommandTerm):
    """(N, K) positions of the picked joints, rad or m, drawn uniformly.

    The metric ``joint_error`` is the Euclidean distance of the joints from the command.

    Example:
        ``{func: uniform_joint_position, params: {of: {uid: ur10}}}``

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        position_range: [low, high] for all picked joints, or a map from joint name or regex to it;
            joints that no key matches get their initial position. None draws between the limits.
        relative: True adds the draw to the initial positions; unused without ranges.
    """

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Whole,
        position_range: Range | dict[str, Range] | None = None,
        relative: bool = True,
    ) -> None:
        if not entity_cfg.joint_ids:
            raise ConfigError([Problem("entity_cfg", f"{entity_cfg.uid!r} has no joints to pick")])
        self._env = env
        self._entity = entity_cfg
        self.names = entity_cfg.joint_names
        parsed = entity_cfg.articulation.parsed
        ids = list(entity_cfg.joint_ids)
        home = np.asarray(parsed.init_qpos, np.float64)[ids]
        limits = np.asarray(parsed.qpos_limits, np.float64)[ids]
        if position_range is None:
            is_limited = np.isfinite(limits).all(axis=1)
            if not is_limited.all():
                unlimited = ", ".join(self.names[i] for i in np.flatnonzero(~is_limited))
                message = f"missing: {unlimited} of {entity_cfg.uid!r} have no limits"
                raise ConfigError([Problem("position_range", message)])
            ranges = limits
        else:
            if relative:
                ranges = _read_ranges(position_range, self.names, np.zeros(len(ids)))
                ranges = ranges + home[:, None]
            else:
                ranges = _read_ranges(position_range, self.names, home)
            ranges = np.clip(ranges, limits[:, :1], limits[:, 1:])
        self._qpos = Uniform("qpos", ranges[:, 0], ranges[:, 1])
        self.values: Floats = env.arrays.put(np.tile(home, (env.num_envs, 1)))

    def resample(self, env_ids: EnvIndex | None) -> None:
        """Draw positions."""
        drawn = self._qpos(self._env.command_manager, env_ids)
        self.values[slice(None) if env_ids is None else env_ids] = drawn

    def metrics(self) -> Mapping[str, Floats]:
        """Distance of the joints from the command."""
        qpos = self._entity.articulation.read_qpos()
        if not self._entity.all_joints:
            qpos = qpos[:, list(self._entity.joint_ids)]
        return {"joint_error": norm(qpos - self.values)}


def _read_ranges(
    position_range: Range | dict[str, Range], names: tuple[str, ...], default: Floats
) -> Floats:
    """(K, 2) ranges of the joints; those that no pattern matches have their default, (K,)."""
    ranges = np.stack([default, default], axis=1)
    if not isinstance(position_range, dict):
        ranges[:] = position_range
        return ranges
    for pattern, bounds in position_range.items():
        path = f"position_range.{pattern}"
        matching, problems = match_every(pattern, names, "picked joint", path)
        if problems:
            raise ConfigError(problems)
        ranges[list(matching)] = bounds
    return ranges

"""Observations of EmbodiChain under their own names and with its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import numpy as np
from pydantic import Field

from embodichain.compat.terms._targets import RigidObject, joints_of, tool_of
from embodichain.compat.terms._targets import target_position as stored_position
from embodichain.lab.gym.envs.managers.param_types import Body, Joints, Range, Whole
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.managers.terms.registry import quantity, register_term
from embodichain.lab.gym.envs.mdp.quantities.bodies import pose_matrix
from embodichain.utils.arrays import tensor_of
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import pose_to_matrix

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.utils.array_types import Floats

__all__ = [
    "GetRobotEefPose",
    "NormalizeRobotJointData",
    "get_articulation_joint_drive",
    "get_object_body_scale",
    "get_object_pose",
    "get_object_uid",
    "get_rigid_object_physics_attributes",
    "get_rigid_object_velocity",
    "target_position",
]

Attribute = Literal["mass", "friction", "damping", "inertia"]
Gain = Literal["stiffness", "damping", "max_effort", "max_velocity", "friction", "armature"]
Attributes = Annotated[Sequence[Attribute], Field(min_length=1)]
Gains = Annotated[Sequence[Gain], Field(min_length=1)]
_ALL_GAINS: tuple[Gain, ...] = get_args(Gain)
_NO_LIMIT = 1e10
"""Value in EmbodiChain's configs for an effort or velocity without a limit."""


@register_term("observation")
def get_object_pose(env: TermContext, obs: Any, entity_cfg: Body, to_matrix: bool = True) -> Floats:
    """Pose of an object, a robot's root, or the picked link, in the environment's frame.

    Args:
        entity_cfg: The entity.
        to_matrix: True gives (N, 4, 4), False (N, 7): x, y, z, qw, qx, qy, qz (metres, wxyz).

    Example:
        ``{func: get_object_pose, params: {of: {uid: cube}, to_matrix: false}}``
    """
    pose = np.concatenate([entity_cfg.position(), entity_cfg.orientation()], axis=1)
    if to_matrix:
        return pose_to_matrix(pose)
    return pose


@quantity("observation")
def get_rigid_object_velocity(env: TermContext, entity_cfg: Body) -> Floats:
    """(N, 6) linear velocity in m/s, then angular in rad/s, world axes; zeros unless dynamic.

    Args:
        entity_cfg: The object (or a robot, then its root).

    Example:
        ``{func: get_rigid_object_velocity, params: {of: {uid: cube}}}``
    """
    return np.concatenate([entity_cfg.linear_velocity(), entity_cfg.angular_velocity()], axis=1)


@quantity("observation", name="get_robot_eef_pose")
class GetRobotEefPose:
    """Pose of the robot's tool in the environment's frame: (N, 4, 4), or (N, 3) metres.

    The tool is the tool point that the robot's `solver_cfg` gives the part, else the last link that
    the part's last joint moves.

    Args:
        part_name: A control part of the task's robot; None is the whole robot.
        position_only: Whether to give the position alone.

    Example:
        ``{func: get_robot_eef_pose, params: {position_only: true}}``
    """

    def __init__(
        self, env: TermContext, part_name: str | None = None, position_only: bool = False
    ) -> None:
        self._tool = tool_of(env, None, part_name)
        self._position_only = position_only

    def __call__(self) -> Floats:
        """Float64 poses."""
        position = self._tool.position()
        if self._position_only:
            return position
        return pose_matrix(position, self._tool.orientation())


@quantity("observation")
def target_position(env: TermContext, target_pose_key: str = "goal_pose") -> Floats:
    """(N, 3) position in metres of the poses that an event stores as ``env.<target_pose_key>``.

    `randomize_target_pose` stores such poses; without them the first reset is an error.

    Args:
        target_pose_key: The attribute, poses (N, 4, 4).

    Example:
        ``{func: target_position, params: {target_pose_key: goal_pose}}``
    """
    return stored_position(env, target_pose_key)


@register_term("observation")
def get_object_body_scale(env: TermContext, obs: Any, entity_cfg: Whole) -> torch.Tensor:
    """(N, 3) scale of an entity's declared shape or file, along its own axes.

    Args:
        entity_cfg: The object or robot.

    Example:
        ``{func: get_object_body_scale, params: {of: {uid: cube}}}``
    """
    asset = entity_cfg.asset
    if hasattr(asset, "get_body_scale"):
        return asset.get_body_scale()
    import torch

    scale = torch.tensor(asset.cfg.body_scale, dtype=torch.float32, device=env.device)
    return scale.repeat(env.num_envs, 1)


@register_term("observation")
def get_object_uid(env: TermContext, obs: Any, entity_cfg: Whole) -> torch.Tensor:
    """(N,) int32 number of an entity in segmentation images: MuJoCo's id of its (root) body.

    Args:
        entity_cfg: The entity, or one link of it.

    Example:
        ``{func: get_object_uid, params: {of: {uid: cube}}}``
    """
    import torch

    return torch.full((env.num_envs,), entity_cfg.body_id, dtype=torch.int32, device=env.device)


@register_term("observation")
def get_rigid_object_physics_attributes(
    env: TermContext,
    obs: Any,
    entity_cfg: RigidObject,
    attributes: Attributes = ("mass", "friction", "damping", "inertia"),
) -> torch.Tensor:
    """(N, K) physical properties of a rigid object side by side, each environment's own.

    ``mass`` (kg), ``friction`` (sliding), ``damping`` (linear, angular, 1/s) and ``inertia`` (three
    principal moments, kg m^2): K is 7 with all of them. In EmbodiChain it is a nested dictionary.

    Args:
        entity_cfg: The object.
        attributes: The properties, in the order of the columns.

    Example:
        ``{func: get_rigid_object_physics_attributes, params: {of: {uid: cube}}}``
    """
    values = [getattr(entity_cfg.asset, f"get_{name}")() for name in attributes]
    import torch

    return torch.cat([value.reshape(env.num_envs, -1) for value in values], dim=1)


@quantity("observation")
def get_articulation_joint_drive(
    env: TermContext, entity_cfg: Joints, gains: Gains = _ALL_GAINS
) -> Floats:
    """Properties of joints and their drives side by side, each environment's own.

    K columns of the picked joints for each property: stiffness (N m/rad), damping (N m s/rad),
    max_effort (N m), max_velocity (rad/s), friction (N m), armature (kg m^2); N, m and kg for
    slides. 1e10 means no limit. In EmbodiChain it is a nested dictionary.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
        gains: The properties, in the order of the columns.

    Example:
        ``{func: get_articulation_joint_drive, params: {of: {uid: ur10}, gains:
        [damping]}}``
    """
    drives = entity_cfg.articulation.drives
    joint_ids = list(entity_cfg.joint_ids)
    columns = [getattr(drives, name)[:, joint_ids] for name in gains]
    return np.minimum(np.concatenate(columns, axis=1), _NO_LIMIT)


@register_term("observation", name="normalize_robot_joint_data")
class NormalizeRobotJointData(Term):
    """Maps joint data of the robot from the joints' limits to a range: for ``mode: modify``.

    (x - low) / (high - low) x (range[1] - range[0]) + range[0] in the picked columns; other columns
    stay as they are, nothing is clipped. For ``robot/qpos``, ``robot/qvel``, ``robot/qf``, or any
    entry with a column for each active joint. A hinge without position limits (URDF's
    ``continuous``) is mapped from [-pi, pi] rad.

    Args:
        joint_ids: The columns, which are those of the active joints: joints that mimic another one
            have none. None (and no `control_parts`) is all of them.
        control_parts: One control part of the robot, instead.
        limit: ``qpos_limits`` in force; or the file's ``qvel_limits`` or ``qf_limits``, which reach
            from minus to plus the limit.
        range: [low, high] that the limits become.

    Example:
        ``{func: normalize_robot_joint_data, mode: modify, name: robot/qpos, params: {joint_ids:
        [0, 1]}}``

    Raises:
        ConfigError: If a joint has no such limit.
    """

    def __init__(
        self,
        env: TermContext,
        joint_ids: list[int] | None = None,
        control_parts: str | None = None,
        limit: Literal["qpos_limits", "qvel_limits", "qf_limits"] = "qpos_limits",
        range: Range = (0.0, 1.0),
    ) -> None:
        active = list(env.active_joint_ids)
        self._width = len(active)
        self._columns = _active_columns(env, active, joint_ids, control_parts)
        joints = joints_of(env, joint_ids=[active[column] for column in self._columns])
        self._ids = np.asarray(joints.joint_ids, np.int64)
        # Position limits may change while the task runs; the others are the file's.
        articulation = joints.articulation
        self._drives = articulation.drives if limit == "qpos_limits" else None
        limits: Floats = np.asarray(getattr(articulation.parsed, limit), np.float64)[self._ids]
        if self._drives is None:  # 0 in a file means that no velocity or effort limit is given
            limits = np.stack([-limits, np.where(limits > 0, limits, np.inf)], axis=1)
        self._limits = limits
        is_limited = np.isfinite(limits)
        self._is_continuous = np.zeros(len(self._ids), np.bool_)
        if self._drives is not None:
            self._is_continuous = ~is_limited.any(axis=1) & joints.hinges()
        has_range = is_limited.all(axis=1) | self._is_continuous
        unlimited_joints = [
            name for name, ok in zip(joints.joint_names, has_range, strict=True) if not ok
        ]
        if unlimited_joints:
            message = f"joints of {joints.uid!r} without {limit}: {', '.join(unlimited_joints)}"
            raise ConfigError([Problem("limit", message)])
        self._start = float(range[0])
        self._span = float(range[1]) - float(range[0])

    def __call__(self, env: TermContext, data: torch.Tensor) -> torch.Tensor:
        """(N, A) the data with the picked columns mapped."""
        if data.ndim != 2 or data.shape[1] != self._width:
            raise ConfigError(
                f"normalize_robot_joint_data needs ({env.num_envs}, {self._width}), one column for "
                f"each active joint, got {tuple(data.shape)}"
            )
        values = env.arrays.of(data).astype(np.float64)
        low, high = self._limits.T
        if self._drives is not None:
            low, high = self._drives.limits.of(self._ids, None)
            low = np.where(self._is_continuous, -np.pi, low)
            high = np.where(self._is_continuous, np.pi, high)
        data_of_joints = values[:, self._columns]
        values[:, self._columns] = (data_of_joints - low) / (high - low) * self._span + self._start
        return tensor_of(values.astype(np.float32))


def _active_columns(
    env: TermContext, active: list[int], joint_ids: list[int] | None, control_parts: str | None
) -> list[int]:
    """The columns that `NormalizeRobotJointData` maps, by its parameters.

    Args:
        env: The environment.
        active: Ids of the active joints.
        joint_ids: Columns among them.
        control_parts: A control part, instead.

    Raises:
        ConfigError: A column does not exist, a joint of the part is not active, or both are given.
    """
    if control_parts is None or env.robot is None:
        columns = list(range(len(active))) if joint_ids is None else joint_ids
        missing_columns = [column for column in columns if not 0 <= column < len(active)]
        if missing_columns:
            count = len(active)
            message = (
                f"columns of the {count} active joints, numbered from 0; got {missing_columns}"
            )
            raise ConfigError([Problem("joint_ids", message)])
        return columns
    if joint_ids is not None:
        raise ConfigError([Problem("control_parts", "give either joint_ids or control_parts")])
    part = env.scene_entity({"uid": env.robot.uid, "control_parts": control_parts})
    inactive_joints = [
        name
        for name, joint in zip(part.joint_names, part.joint_ids, strict=True)
        if joint not in active
    ]
    if inactive_joints:
        message = f"joints of {control_parts!r} are not active: {', '.join(inactive_joints)}"
        raise ConfigError([Problem("control_parts", message)])
    return [active.index(joint) for joint in part.joint_ids]

"""Observations of where things are: objects, roots, links, tools, targets.

Upstream and peers share one convention here: x, y, z in metres, then qw, qx, qy, qz.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np

from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp import _body, _spatial
from embodichain.lab.gym.envs.mdp._links import Links
from embodichain.lab.gym.envs.mdp._rotations import (
    Heading,
    Rotation,
    as_rotation,
    heading,
    pose_matrix,
)
from embodichain.lab.gym.envs.mdp._targets import target_position as stored_position
from embodichain.lab.gym.envs.mdp._targets import tool_of
from embodichain.lab.gym.envs.mdp.observations._computed import Computed
from embodichain.utils.math import pose_to_matrix

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64
else:
    torch = lazy_loader.load("torch")

__all__ = [
    "GetRobotEefPose",
    "LinkPose",
    "Orientation",
    "Yaw",
    "get_object_pose",
    "get_rigid_object_pose",
    "target_position",
]


@register_term("observation")
def get_object_pose(
    env: TermContext, obs: Any, entity_cfg: ResolvedEntity, to_matrix: bool = True
) -> torch.Tensor:
    """Pose of an object, a robot's root, or the picked link, in the environment's frame.

    EmbodiChain's observation of the same name; an unknown uid is an error here, not zeros.

    Example:
        ``{func: get_object_pose, params: {entity_cfg: {uid: cube}, to_matrix: false}}``

    Args:
        env: The environment.
        obs: Unused.
        entity_cfg: The entity.
        to_matrix: True gives (N, 4, 4), False (N, 7): x, y, z, qw, qx, qy, qz (metres, wxyz).
    """
    pose = _spatial.pose(entity_cfg)
    return pose_to_matrix(pose) if to_matrix else pose


@register_term("observation")
def get_rigid_object_pose(
    env: TermContext, obs: Any, entity_cfg: ResolvedEntity, to_matrix: bool = True
) -> torch.Tensor:
    """EmbodiChain's older name of `get_object_pose`.

    Example:
        ``{func: get_rigid_object_pose, params: {entity_cfg: {uid: cube}}}``

    Args:
        env: The environment.
        obs: Unused.
        entity_cfg: The entity.
        to_matrix: True gives (N, 4, 4), False (N, 7): x, y, z, qw, qx, qy, qz (metres, wxyz).
    """
    return get_object_pose(env, obs, entity_cfg, to_matrix)


@register_term("observation", name="link_pose")
class LinkPose(Term):
    """Poses of the picked links, x, y, z, qw, qx, qy, qz: metres, wxyz.

    (N, 7) of one link, (N, L, 7) of L; as matrices (N, 4, 4) or (N, L, 4, 4). Isaac Lab's
    ``body_pose_w``.

    Example:
        ``{func: link_pose, params: {entity_cfg: {uid: ur10, link_names: [ee_link]}}}``

    Args:
        entity_cfg: The robot and links of it; without links its root.
        to_matrix: Whether to give matrices.
        in_root_frame: Whether poses are relative to the robot's root, instead of in the
            environment's frame.
    """

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        to_matrix: bool = False,
        in_root_frame: bool = False,
    ) -> None:
        self._links = Links(entity_cfg, in_root_frame)
        self._to_matrix = to_matrix
        self._engine = entity_cfg.asset.engine
        plain = len(entity_cfg.link_names) == 1 and not (to_matrix or in_root_frame)
        self._one = entity_cfg.asset.body_of(entity_cfg.link_names[0]) if plain else None

    def __call__(self, env: TermContext, obs: Any) -> torch.Tensor:
        """Poses, a tensor of their own."""
        if self._one is not None:  # the usual case, without a dimension for links
            engine, body = self._engine, self._one
            position = engine.derived("xpos")[:, body]
            poses = np.empty((len(position), 7), np.float32)
            poses[:, :3] = position
            poses[:, 3:] = engine.derived("xquat")[:, body]
            return torch.from_numpy(poses)
        pos, quat = self._links.pose()
        if self._to_matrix:
            found = pose_matrix(pos, quat).astype(np.float32)
        else:
            found = np.empty((*pos.shape[:2], 7), np.float32)
            found[..., :3] = pos
            found[..., 3:] = quat
        return torch.from_numpy(found[:, 0] if self._links.single else found)


@register_term("observation", name="get_robot_eef_pose")
class GetRobotEefPose(Computed):
    """Pose of the robot's tool in the environment's frame: (N, 4, 4), or (N, 3) metres.

    EmbodiChain's observation of the same name. The tool is the tool point that the robot's
    `solver_cfg` gives the part, else the last link that hangs from the part's last joint; it is
    read off the simulation, which is the forward kinematics.

    Example:
        ``{func: get_robot_eef_pose, params: {position_only: true}}``

    Args:
        part_name: A control part of the task's robot; None is the whole robot.
        position_only: Whether to give the position alone.
    """

    def __init__(
        self, env: TermContext, part_name: str | None = None, position_only: bool = False
    ) -> None:
        self._tool = tool_of(env, None, part_name)
        self._position_only = position_only

    def value(self) -> F64:
        """Float64 poses."""
        position = _spatial.position(self._tool)
        if self._position_only:
            return position
        return pose_matrix(position, _body.orientation(self._tool))


@register_term("observation")
def target_position(env: TermContext, obs: Any, target_pose_key: str = "goal_pose") -> torch.Tensor:
    """(N, 3) position in metres of the poses that an event keeps as ``env.<target_pose_key>``.

    EmbodiChain's observation of the same name. `randomize_target_pose` writes such poses; where
    nothing has, that is an error at the first reset, not zeros.

    Example:
        ``{func: target_position, params: {target_pose_key: goal_pose}}``

    Args:
        env: The environment.
        obs: Unused.
        target_pose_key: The attribute, poses (N, 4, 4).
    """
    return _spatial.tensor(stored_position(env, target_pose_key))


@register_term("observation", name="orientation")
class Orientation(Computed):
    """Orientation of an entity or a link in the environment's frame, in the form of your choice.

    Example:
        ``{func: orientation, params: {entity_cfg: {uid: cube}, representation: rot6d}}``

    Args:
        entity_cfg: The entity, or one link of it.
        representation: ``quat`` (N, 4) wxyz with w >= 0; ``matrix`` (N, 3, 3); ``rot6d`` (N, 6),
            the matrix's first column, then its second (Zhou et al., CVPR 2019): without jumps.
    """

    def __init__(
        self, env: TermContext, entity_cfg: ResolvedEntity, representation: Rotation = "rot6d"
    ) -> None:
        self._entity, self._kind = entity_cfg, representation

    def value(self) -> F64:
        """Float64 orientations."""
        return as_rotation(_body.orientation(self._entity), self._kind)


@register_term("observation", name="yaw")
class Yaw(Computed):
    """Heading of an entity or a link: where its x axis points in the horizontal plane.

    Example:
        ``{func: yaw, params: {entity_cfg: {uid: cube}, representation: sin_cos}}``

    Args:
        entity_cfg: The entity, or one link of it.
        representation: ``yaw`` (N, 1), the angle in (-pi, pi] rad about z; ``sin_cos`` (N, 2), its
            sine and cosine, which have no jump.
    """

    def __init__(
        self, env: TermContext, entity_cfg: ResolvedEntity, representation: Heading = "yaw"
    ) -> None:
        self._entity, self._kind = entity_cfg, representation

    def value(self) -> F64:
        """Float64 headings."""
        return heading(_body.orientation(self._entity), self._kind)

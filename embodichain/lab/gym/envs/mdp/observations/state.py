"""Built-in observations: joints, poses, velocities, relative positions, the last action.

Every term returns a tensor of its own that nothing else writes to.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np

from embodichain.lab.gym.envs.managers.base import Term
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _spatial
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import pose_to_matrix

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.base_env import BaseEnv
else:
    torch = lazy_loader.load("torch")

__all__ = [
    "JointPositionRelative",
    "get_object_pose",
    "get_rigid_object_velocity",
    "joint_position",
    "joint_velocity",
    "last_action",
    "link_pose",
    "link_velocity",
    "relative_position",
]


@register_term("observation")
def get_object_pose(
    env: BaseEnv, obs: Any, entity_cfg: ResolvedEntity, to_matrix: bool = True
) -> torch.Tensor:
    """Pose of an object, a robot's root, or the picked link, in the environment's frame.

    EmbodiChain's observation of the same name.

    Args:
        env: The environment.
        obs: Unused.
        entity_cfg: The entity.
        to_matrix: True gives (N, 4, 4), False (N, 7): x, y, z, qw, qx, qy, qz (metres, wxyz).
    """
    pose = _spatial.pose(entity_cfg)
    return pose_to_matrix(pose) if to_matrix else pose


@register_term("observation")
def link_pose(
    env: BaseEnv, obs: Any, entity_cfg: ResolvedEntity, to_matrix: bool = False
) -> torch.Tensor:
    """Pose of a link, (N, 7) x, y, z, qw, qx, qy, qz or (N, 4, 4); see `get_object_pose`.

    Args:
        env: The environment.
        obs: Unused.
        entity_cfg: The robot and one link of it; without a link its root.
        to_matrix: Whether to give matrices.
    """
    return get_object_pose(env, obs, entity_cfg, to_matrix)


@register_term("observation")
def link_velocity(env: BaseEnv, obs: Any, entity_cfg: ResolvedEntity) -> torch.Tensor:
    """(N, 6) linear velocity of a link's origin in m/s, then angular in rad/s, world axes.

    Args:
        env: The environment.
        obs: Unused.
        entity_cfg: The robot and one link of it; without a link its root.
    """
    asset = entity_cfg.asset
    name = entity_cfg.link_name
    velocity: torch.Tensor = asset.body_data.root_vel if name is None else asset.get_link_vel(name)
    return velocity


@register_term("observation")
def get_rigid_object_velocity(env: BaseEnv, obs: Any, entity_cfg: ResolvedEntity) -> torch.Tensor:
    """(N, 6) linear velocity in m/s, then angular in rad/s, world axes; zeros unless dynamic.

    EmbodiChain's observation of the same name.

    Args:
        env: The environment.
        obs: Unused.
        entity_cfg: The object.
    """
    data = entity_cfg.asset.body_data
    velocity: torch.Tensor = torch.zeros(env.num_envs, 6) if data is None else data.vel
    return velocity


@register_term("observation")
def joint_position(env: BaseEnv, obs: Any, entity_cfg: ResolvedEntity) -> torch.Tensor:
    """(N, K) positions of the picked joints, rad or m.

    Args:
        env: The environment.
        obs: Unused.
        entity_cfg: The robot; its joint names or control parts pick joints.
    """
    return _columns(entity_cfg.asset.body_data.qpos, entity_cfg)


@register_term("observation")
def joint_velocity(env: BaseEnv, obs: Any, entity_cfg: ResolvedEntity) -> torch.Tensor:
    """(N, K) velocities of the picked joints, rad/s or m/s.

    Args:
        env: The environment.
        obs: Unused.
        entity_cfg: The robot; its joint names or control parts pick joints.
    """
    return _columns(entity_cfg.asset.body_data.qvel, entity_cfg)


@register_term("observation", name="joint_position_relative")
class JointPositionRelative(Term):
    """(N, K) positions of the picked joints minus the initial ones, rad or m.

    Args:
        entity_cfg: The robot; its joint names or control parts pick joints.
    """

    def __init__(self, env: BaseEnv, entity_cfg: ResolvedEntity) -> None:
        if not entity_cfg.joint_ids:
            raise ConfigError([Problem("entity_cfg", f"{entity_cfg.uid!r} has no joints")])
        self._entity = entity_cfg
        home = np.asarray(entity_cfg.asset.parsed.init_qpos, np.float32)
        self._home = torch.from_numpy(home[list(entity_cfg.joint_ids)])

    def __call__(self, env: BaseEnv, obs: Any) -> torch.Tensor:
        """The observation."""
        return _columns(self._entity.asset.body_data.qpos, self._entity) - self._home


@register_term("observation")
def relative_position(
    env: BaseEnv,
    obs: Any,
    source_entity_cfg: ResolvedEntity,
    target_entity_cfg: ResolvedEntity,
) -> torch.Tensor:
    """(N, 3) position of the target minus that of the source, m, environment's axes.

    Args:
        env: The environment.
        obs: Unused.
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.
    """
    source, target = _spatial.position(source_entity_cfg), _spatial.position(target_entity_cfg)
    return _spatial.tensor(target - source)


@register_term("observation")
def last_action(env: BaseEnv, obs: Any) -> torch.Tensor:
    """(N, A) the action of the last step, as given; zeros after a reset."""
    return env.last_action


def _columns(values: torch.Tensor, entity: ResolvedEntity) -> torch.Tensor:
    return values if entity.all_joints else values[:, list(entity.joint_ids)]

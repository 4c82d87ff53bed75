"""Targets that are no entities: poses kept on the environment, and the tool that pursues them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.mdp import _spatial
from embodichain.lab.gym.envs.mdp._joints import as_parameters
from embodichain.lab.gym.envs.mdp._kinematics import tool_links
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
    from embodichain.lab.sim.engine.base import F64

__all__ = ["distance_to", "target_position", "tool_of"]


def target_position(env: TermContext, key: str) -> F64:
    """(N, 3) metres: positions, or those of poses (N, 4, 4), that are kept as ``env.<key>``.

    The world's origin before the first reset, when nothing can have written the poses.

    Raises:
        ConfigError: If the environment has no such poses.
        ValueError: If they have another shape.
    """
    poses: Any = getattr(env, key, None)
    if poses is None:
        if int(env.episode_ids[0]) < 0:
            return np.zeros((env.num_envs, 3))
        message = (
            f"the environment has no poses {key!r}: an event writes them, "
            f"as randomize_target_pose with store_key: {key}"
        )
        raise ConfigError([Problem("target_pose_key", message)])
    array = np.asarray(poses.detach() if hasattr(poses, "detach") else poses)
    count = env.num_envs
    if array.shape == (count, 3):
        return array.astype(np.float64)
    if array.shape != (count, 4, 4):
        message = f"env.{key} must have shape ({count}, 4, 4) or ({count}, 3), got {array.shape}"
        raise ValueError(message)
    return array[:, :3, 3].astype(np.float64)


def distance_to(position: F64, target: F64, use_xy_only: bool) -> F64:
    """(N,) metres between rows of positions, in the plane only if asked."""
    delta = target - position
    return _spatial.norm(delta[:, :2] if use_xy_only else delta)


def tool_of(
    env: TermContext, end_effector_cfg: ResolvedEntity | None, part_name: str | None
) -> ResolvedEntity:
    """The link that acts: the one given, else a part's tool point, else its farthest link.

    Args:
        env: The environment.
        end_effector_cfg: The link.
        part_name: A control part of the task's robot; None is the whole robot.

    Raises:
        ConfigError: If both are given, there is no such part or robot, or not one such link.
    """
    if end_effector_cfg is not None:
        if part_name is not None:
            raise ConfigError([Problem("part_name", "give either end_effector_cfg or this")])
        return end_effector_cfg
    if env.robot is None:
        raise ConfigError([Problem("end_effector_cfg", "the task has no robot: give a link")])
    with as_parameters({"control_parts": "part_name"}):
        entity = env.scene_entity({"uid": env.robot.uid, "control_parts": part_name})
    names = entity.asset.parsed.link_names
    links = [names[i] for i in tool_links(entity)]
    if len(links) != 1:
        message = f"name one link as the tool; the robot suggests {', '.join(links) or 'none'}"
        raise ConfigError([Problem("end_effector_cfg", message)])
    return env.scene_entity({"uid": entity.uid, "link_names": links})

"""What EmbodiChain's terms refer to: joints of the task's robot, its tool, stored target poses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
    from embodichain.lab.sim.engine.base import F64

__all__ = ["as_parameters", "pick_joints", "target_position", "tool_of"]


@contextmanager
def as_parameters(names: Mapping[str, str]) -> Iterator[None]:
    """Call the keys of a reference what the term's parameters are called, in errors.

    Args:
        names: Key -> parameter.
    """
    try:
        yield
    except ConfigError as error:
        raise ConfigError(
            Problem(names.get(p.path, p.path), p.message, p.hint) for p in error.problems
        ) from error


def pick_joints(
    env: TermContext,
    entity_cfg: ResolvedEntity | None,
    robot_uid: str | None,
    joint_ids: Sequence[int] | None,
    part_name: str | None = None,
) -> ResolvedEntity:
    """Joints given by a reference, or as EmbodiChain does.

    Args:
        env: The environment.
        entity_cfg: The reference; the others must then be None.
        robot_uid: A robot; None is the task's own.
        joint_ids: Its joints; None is all active ones.
        part_name: A control part, instead of indices.

    Raises:
        ConfigError: If there is no such robot, joint or part, or both ways are mixed.
    """
    given = {"robot_uid": robot_uid, "joint_ids": joint_ids, "part_name": part_name}
    mixed = [name for name, value in given.items() if value is not None]
    if entity_cfg is not None:
        if mixed:
            raise ConfigError([Problem(mixed[0], "give either entity_cfg or this")])
        entity_cfg.require_joints()
        return entity_cfg
    if joint_ids is not None and part_name is not None:
        raise ConfigError([Problem("part_name", "give either joint_ids or part_name")])
    if robot_uid is None:
        if env.robot is None:
            raise ConfigError([Problem("robot_uid", "the task has no robot: give entity_cfg")])
        robot_uid = env.robot.uid
    cfg: dict[str, Any] = {"uid": robot_uid, "control_parts": part_name}
    if joint_ids is not None:
        cfg = {"uid": robot_uid, "joint_ids": list(joint_ids)}
    names = {"": "robot_uid", "uid": "robot_uid", "control_parts": "part_name"}
    with as_parameters(names):
        found = env.scene_entity(cfg)
        found.require_joints()
    return found


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
    from embodichain.lab.gym.envs.mdp._ik import tool_links

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

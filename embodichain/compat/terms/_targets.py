"""References of EmbodiChain's terms: entities, joints, tools and attributes of the environment."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Reference
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.utils.array_types import Floats

__all__ = [
    "Articulation",
    "RigidObject",
    "as_parameters",
    "joints_of",
    "target_position",
    "tool_of",
]

T = TypeVar("T")
_SHARED = ("affordance_datas",)
"""Attributes of the environment that exist for terms to write into."""


class _Has(Reference):
    """A reference to an entity of one kind, recognized by an attribute of its handle."""

    def __init__(self, attribute: str, kind: str, links: bool) -> None:
        self._attribute = attribute
        self._kind = kind
        self._links = links

    def resolve(self, env: TermContext, value: Any) -> Any:
        if not hasattr(value.asset, self._attribute):
            raise ConfigError([Problem("uid", f"{value.uid!r} is not {self._kind}")])
        if self._links:
            value.require_links()
        else:
            value.require_whole()
        return value


if TYPE_CHECKING:
    RigidObject = ResolvedEntity
    Articulation = ResolvedEntity
else:
    RigidObject = Annotated[ResolvedEntity, _Has("is_non_dynamic", "a rigid object", False)]
    Articulation = Annotated[ResolvedEntity, _Has("parsed", "a robot: it has no joints", True)]


@contextmanager
def as_parameters(names: Mapping[str, str]) -> Iterator[None]:
    """Rename the keys of a reference to the term's parameters in errors.

    Args:
        names: Key -> parameter.
    """
    try:
        yield
    except ConfigError as error:
        raise ConfigError(
            Problem(names.get(p.path, p.path), p.message, p.hint) for p in error.problems
        ) from error


def joints_of(
    env: TermContext,
    robot_uid: str | None = None,
    joint_ids: list[int] | None = None,
    part_name: str | None = None,
    entity_cfg: ResolvedEntity | None = None,
) -> ResolvedEntity:
    """Joints given by a reference, or by EmbodiChain's parameters.

    Args:
        robot_uid: The robot; None is the task's own.
        joint_ids: Its joints; None is all active ones.
        part_name: One of its control parts, instead of `joint_ids`.
        entity_cfg: Robot and joints by name, instead of all three (ours).

    Raises:
        ConfigError: If there is no such robot, joint or part, or both forms are given.
    """
    parameters = {"robot_uid": robot_uid, "joint_ids": joint_ids, "part_name": part_name}
    if entity_cfg is not None:
        for name, value in parameters.items():
            if value is not None:
                raise ConfigError([Problem(name, "give either `of` or this")])
        entity_cfg.require_joints()
        entity_cfg.require_whole()
        return entity_cfg
    if joint_ids is not None and part_name is not None:
        raise ConfigError([Problem("part_name", "give either joint_ids or part_name")])
    if robot_uid is None:
        if env.robot is None:
            raise ConfigError([Problem("robot_uid", "the task has no robot: give `of`")])
        robot_uid = env.robot.uid
    with as_parameters({"": "robot_uid", "uid": "robot_uid", "control_parts": "part_name"}):
        joints = env.scene_entity(
            {"uid": robot_uid, "control_parts": part_name, "joint_ids": joint_ids}
        )
        joints.require_joints()
    return joints


def target_position(env: TermContext, key: str) -> Floats:
    """(N, 3) positions in metres stored as ``env.<key>``, as positions or as poses (N, 4, 4).

    Before the first reset, when no event can have written them, it is the world's origin.

    Raises:
        ConfigError: If the environment has no such poses, or they have another shape.
    """
    poses: Any = getattr(env, key, None)
    if poses is None:
        if int(env.episode_ids[0]) < 0:
            origin: Floats = env.arrays.full((env.num_envs, 3), 0.0)
            return origin
        message = (
            f"the environment has no poses {key!r}: an event writes them, "
            f"as randomize_target_pose with store_key: {key}"
        )
        raise ConfigError([Problem("target_pose_key", message)])
    array: Floats = env.arrays.of(poses)
    count = env.num_envs
    if array.shape == (count, 3):
        return array.astype(np.float64)
    if array.shape != (count, 4, 4):
        message = f"env.{key} must have shape ({count}, 4, 4) or ({count}, 3), got {array.shape}"
        raise ConfigError([Problem("target_pose_key", message)])
    return array[:, :3, 3].astype(np.float64)


def tool_of(
    env: TermContext, end_effector_cfg: ResolvedEntity | None, part_name: str | None
) -> ResolvedEntity:
    """The tool's link: the given one, else that of a part's tool point, else its farthest link.

    Args:
        env: The environment.
        end_effector_cfg: The link.
        part_name: A control part of the task's robot; None is the whole robot.

    Raises:
        ConfigError: If both are given, there is no such part or robot, or not exactly one link.
    """
    if end_effector_cfg is not None:
        if part_name is not None:
            raise ConfigError([Problem("part_name", "give either end_effector_cfg or this")])
        return end_effector_cfg
    from embodichain.lab.gym.envs.mdp._tools import tool_links

    if env.robot is None:
        raise ConfigError([Problem("end_effector_cfg", "the task has no robot: give a link")])
    with as_parameters({"control_parts": "part_name"}):
        entity = env.scene_entity({"uid": env.robot.uid, "control_parts": part_name})
    links = tool_links(entity)
    if len(links) != 1:
        candidates = ", ".join(links) or "none"
        message = f"cannot tell which link is the tool, name it; candidates: {candidates}"
        raise ConfigError([Problem("end_effector_cfg", message)])
    return env.scene_entity({"uid": entity.uid, "link_names": links})


def get_or_create(env: TermContext, name: str, first: Callable[[], T], path: str) -> T:
    """The value of ``env.<name>``, created by `first` if there is none.

    Args:
        env: The environment.
        name: The attribute. Terms may share it; ``extensions`` or a user's class may declare it.
        first: Creates the first value.
        path: The parameter that names it, for messages.

    Raises:
        ConfigError: If the name is not an identifier, or is an attribute of the environment class.
    """
    bases = [base for base in type(env).__mro__ if base.__module__.startswith("embodichain.lab.")]
    attributes: set[str] = set()
    for base in bases:
        attributes.update(vars(base))
        attributes.update(vars(base).get("__annotations__", {}))
    is_taken = name in attributes and name not in _SHARED
    if not name.isidentifier() or name.startswith("_") or is_taken:
        message = f"{name!r} is not an identifier, or taken by the environment"
        raise ConfigError([Problem(path, message)])
    if not hasattr(env, name):
        setattr(env, name, first())
    value: Any = getattr(env, name)
    expected = type(first())
    if type(value) is not expected:
        message = f"env.{name} is a {type(value).__name__}; a {expected.__name__} is stored there"
        raise ConfigError([Problem(path, message)])
    return value


def asset_of(env: TermContext, uid: str, path: str, objects_only: bool = False) -> Any:
    """The handle of an entity.

    Args:
        env: The environment.
        uid: Its name.
        path: The parameter that names it, for messages.
        objects_only: Whether it must be a rigid object.

    Raises:
        ConfigError: If there is no such entity; lists those that exist.
    """
    with as_parameters({"uid": path}):
        asset = env.scene_entity({"uid": uid}).asset
    if objects_only and not hasattr(asset, "is_non_dynamic"):
        raise ConfigError([Problem(path, f"{uid!r} is not a rigid object")])
    return asset

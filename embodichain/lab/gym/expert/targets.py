"""Targets of steps in the scene: `TargetPoses` reads their poses, `check_target` finds mistakes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.sim.compiler.names import find_frame_of, pick
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import normalize_quat, quat_multiply, quat_rotate
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.envs.managers.term import CommandTerm
    from embodichain.lab.gym.expert.instructions import Target
    from embodichain.lab.sim.compiler.names import Known
    from embodichain.lab.sim.engine.api import F64

__all__ = ["WORLD", "TargetPoses", "check_target", "target_name"]

WORLD = "world"
"""The target that is the origin of the environment's frame."""
Poses = tuple["F64", "F64"]


def target_name(target: Target) -> str:
    """Its name in messages."""
    return target if isinstance(target, str) else str(getattr(target, "__name__", target))


def _read_reference(target: str, known: Known) -> tuple[dict[str, Any], list[Problem]]:
    """The reference to an entity, or to a link, site or geom of it, and what is wrong with it."""
    uid, slash, name = target.partition("/")
    reference: dict[str, Any] = {"uid": uid}
    if not slash:
        return reference, []
    entity = known.get(uid)
    if entity is None:  # the look-up of the entity reports it
        reference["link"] = name
        return reference, []
    frame, problems = find_frame_of(entity, uid, name)
    if frame is not None:
        kind, frame_name = frame
        reference[kind] = frame_name
    return reference, problems


def check_target(
    target: str, path: str, known: Known, commands: Iterable[str], open_scene: bool = False
) -> list[Problem]:
    """Find what is wrong with a target.

    Args:
        target: ``ENTITY``, ``ENTITY/NAME`` (a link, site or geom) or a command.
        path: Its key path.
        known: The declared entities.
        commands: The commands.
        open_scene: Whether Python code may add entities.
    """
    commands = list(commands)
    if target == WORLD or (target in commands and target not in known):
        return []
    reference, problems = _read_reference(target, known)
    if not problems:
        _, problems = pick(path, reference, known, open_scene)
    uid, _, _ = target.partition("/")
    if commands and uid not in known and problems:
        hint = problems[0].hint or did_you_mean(target, commands).strip()
        message = f"{problems[0].message}; commands: {', '.join(commands)}"
        return [Problem(path, message, hint)]
    return [Problem(path, p.message, p.hint) for p in problems]


class TargetPoses:
    """Reads the poses of targets, in the environment's frame.

    Args:
        env: The environment.
    """

    def __init__(self, env: BaseEnv) -> None:
        self._env = env
        self._readers: dict[Any, Callable[[], Poses]] = {}
        self._upright: F64 = np.tile([1.0, 0.0, 0.0, 0.0], (env.num_envs, 1))

    def add(self, target: Target, path: str) -> None:
        """Prepare to read a target.

        Raises:
            ConfigError: If it does not exist.
        """
        if target not in self._readers:
            self._readers[target] = self._make_reader(target, path)

    def __call__(self, target: Target) -> Poses:
        """Position (N, 3) in m and orientation (N, 4), wxyz."""
        return self._readers[target]()

    def bodies(self, target: Target) -> frozenset[int]:
        """MuJoCo ids of a target's bodies: of an entity all; none of commands and functions."""
        if not isinstance(target, str) or target in (WORLD, *self._env.command_manager.terms):
            return frozenset()
        reference, _ = _read_reference(target, self._env.sim.known)  # `add` has checked it
        entity = self._env.scene_entity(reference)
        if entity.link_body is not None:
            return frozenset([int(entity.link_body)])
        return frozenset(map(int, entity.asset.index.body_ids))

    def _make_reader(self, target: Target, path: str) -> Callable[[], Poses]:
        """Return the function that reads the poses of one target."""
        env = self._env
        if not isinstance(target, str):
            return lambda: _call_target(target, env)
        if target == WORLD:
            origin = np.zeros((env.num_envs, 3))
            return lambda: (origin, self._upright)
        entities = (*env.sim.robots, *env.sim.articulations, *env.sim.rigid_objects)
        if target in env.command_manager.terms and target not in entities:
            return self._make_command_reader(target, path)
        try:
            reference, problems = _read_reference(target, env.sim.known)
            if problems:
                raise ConfigError(problems)
            entity = env.scene_entity(reference)
        except ConfigError as error:
            raise ConfigError([Problem(path, p.message, p.hint) for p in error.problems]) from error
        return lambda: (entity.position(), entity.orientation())

    def _make_command_reader(self, name: str, path: str) -> Callable[[], Poses]:
        """Return the function that reads a command, a pose in the axes of a body or a position."""
        term: CommandTerm = self._env.command_manager.terms[name].instance
        values = term.values
        if term.marker is not None and term.marker.kind == "pose":
            engine = self._env.sim.engine
            body = term.marker.body

            def read_pose() -> Poses:
                body_pos = engine.derived("xpos")[:, body]
                body_quat = engine.derived("xquat")[:, body]
                pos = np.ascontiguousarray(values[:, :3])
                quat = np.ascontiguousarray(values[:, 3:7])
                return body_pos + quat_rotate(body_quat, pos), quat_multiply(body_quat, quat)

            return read_pose
        if values.shape[1] == 3 and term.marker is None:
            return lambda: (values, self._upright)
        message = f"the command {name!r} is not a pose or a position: {', '.join(term.names)}"
        raise ConfigError([Problem(path, message)])


def _call_target(function: Callable[..., Any], env: BaseEnv) -> Poses:
    """The poses that a function of the user's returns, (N, 7)."""
    poses = np.asarray(function(env), np.float64)
    if poses.shape != (env.num_envs, 7):
        raise ValueError(f"a target must return ({env.num_envs}, 7) poses, got {poses.shape}")
    return np.ascontiguousarray(poses[:, :3]), normalize_quat(np.ascontiguousarray(poses[:, 3:]))

"""Targets of steps in the scene: `TargetPoses` reads their poses, `check_target` finds mistakes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.sim.compiler.names import find_frame, frame_names, pick
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import normalize_quat, quat_multiply, quat_rotate
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
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


def _fields(target: str, known: Known) -> tuple[dict[str, Any], list[Problem]]:
    """The reference to an entity, or to a link, site or geom of it."""
    uid, slash, name = target.partition("/")
    entity = known.get(uid)
    if not slash or entity is None:
        return {"uid": uid, **({"link": name} if slash else {})}, []
    frame, problems = find_frame(name, lambda kind: frame_names(entity, uid, kind), "", uid)
    return {"uid": uid, **({} if frame is None else {frame[0]: frame[1]})}, problems


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
    fields, problems = _fields(target, known)
    problems = problems or pick(path, fields, known, open_scene)[1]
    uid = target.partition("/")[0]
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

    def add(self, target: Target, path: str) -> None:
        """Prepare to read a target.

        Raises:
            ConfigError: If it does not exist.
        """
        if target not in self._readers:
            self._readers[target] = self._reader(target, path)

    def __call__(self, target: Target) -> Poses:
        """Position (N, 3) in m and orientation (N, 4), wxyz."""
        return self._readers[target]()

    def bodies(self, target: Target) -> frozenset[int]:
        """MuJoCo ids of a target's bodies: of an entity all; none of commands and functions."""
        if not isinstance(target, str) or target in (WORLD, *self._env.command_manager.terms):
            return frozenset()
        fields, _ = _fields(target, self._env.sim.known)  # `add` has checked it
        entity = self._env.scene_entity(fields)
        link = entity.link_body
        every = entity.asset.entity.body_ids if link is None else [link]
        return frozenset(map(int, every))

    def _reader(self, target: Target, path: str) -> Callable[[], Poses]:
        env, count = self._env, self._env.num_envs
        if not isinstance(target, str):
            return lambda: _from_function(target, env)
        if target == WORLD:
            origin = np.zeros((count, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
            return lambda: origin
        commands = env.command_manager.terms
        entities = (*env.sim.robots, *env.sim.articulations, *env.sim.rigid_objects)
        if target in commands and target not in entities:
            return self._command(target, path)
        try:
            fields, problems = _fields(target, env.sim.known)
            if problems:
                raise ConfigError(problems)
            entity = env.scene_entity(fields)
        except ConfigError as error:
            raise ConfigError([Problem(path, p.message, p.hint) for p in error.problems]) from error
        return lambda: (entity.position(), entity.orientation())

    def _command(self, name: str, path: str) -> Callable[[], Poses]:
        term: Any = self._env.command_manager.terms[name].instance
        values, upright = term.values, np.tile([1.0, 0.0, 0.0, 0.0], (self._env.num_envs, 1))
        if term.marker is not None and term.marker.kind == "pose":
            engine, body = self._env.sim.engine, term.marker.body

            def pose() -> Poses:
                base, turn = engine.derived("xpos")[:, body], engine.derived("xquat")[:, body]
                place = base + quat_rotate(turn, np.ascontiguousarray(values[:, :3]))
                return place, quat_multiply(turn, np.ascontiguousarray(values[:, 3:7]))

            return pose
        if values.shape[1] == 3 and term.marker is None:
            return lambda: (values, upright)
        message = f"the command {name!r} is no pose and no position: {', '.join(term.names)}"
        raise ConfigError([Problem(path, message)])


def _from_function(function: Callable[..., Any], env: BaseEnv) -> Poses:
    """The poses (N, 7) that a function returns."""
    poses = np.asarray(function(env), np.float64)
    if poses.shape != (env.num_envs, 7):
        raise ValueError(f"a target must return ({env.num_envs}, 7) poses, got {poses.shape}")
    return np.ascontiguousarray(poses[:, :3]), normalize_quat(np.ascontiguousarray(poses[:, 3:]))

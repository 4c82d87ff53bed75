"""From an `EnvCfg` to entities in a simulation: what the default hooks of `BaseEnv` build.

Also the values of a config that follow from others.
"""

from __future__ import annotations

import copy
import logging
import math
from typing import TYPE_CHECKING, Any

from embodichain.lab.gym.envs.cfg import ActionTermCfg, EnvCfg, SceneEntityCfg
from embodichain.lab.gym.envs.episodes import NO_LIMIT
from embodichain.lab.gym.envs.managers.check import check_terms
from embodichain.lab.gym.envs.scene_check import describe
from embodichain.lab.sim.cfg import SimulationManagerCfg, name_of
from embodichain.lab.sim.viewer import has_display
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.sim.objects.robot import Robot
    from embodichain.lab.sim.sensors.sensor_handles import BaseSensor
    from embodichain.lab.sim.sim_manager import SimulationManager

__all__ = [
    "add_declared_robots",
    "add_declared_scene",
    "add_declared_sensors",
    "default_actions",
    "frozen_cfg",
    "open_window",
    "set_extensions",
    "with_all_problems",
]

logger = logging.getLogger(__name__)

_PHYSICS = ("gravity", "solver", "iterations", "integrator", "cone")


def frozen_cfg(cfg: EnvCfg | None, num_envs: int | None = None) -> EnvCfg:
    """Return a deep copy of a config in which what follows from other fields is filled in.

    The ``physics`` section goes into ``sim_cfg``, ``decimation`` into ``sim_steps_per_control``,
    ``episode_length_s`` into ``max_episode_steps`` (rounded up to whole control steps), and the
    number of environments into ``sim_cfg``.

    Args:
        cfg: The user's config, left as it is; None is the default one.
        num_envs: Wins over the config's.

    Raises:
        ConfigError: If a value makes no sense; names its key path.
        NotImplementedError: If an `EmbodiedEnvCfg` declares a camera.
    """
    cfg = copy.deepcopy(cfg) if cfg is not None else EnvCfg()
    cfg.complete()
    if num_envs is not None:
        cfg.num_envs = num_envs
    given: SimulationManagerCfg | None = cfg.sim_cfg  # EmbodiChain allows None
    sim_cfg = cfg.sim_cfg = SimulationManagerCfg(headless=True) if given is None else given
    physics = cfg.physics
    if physics is not None:
        if physics.physics_dt is not None:
            sim_cfg.physics_dt = physics.physics_dt
        for name in _PHYSICS:
            value = getattr(physics, name)
            if value is not None:
                setattr(sim_cfg.physics_config, name, value)
    if cfg.decimation is not None:
        cfg.sim_steps_per_control = cfg.decimation
    _check(cfg)
    sim_cfg.num_envs = cfg.num_envs
    if cfg.episode_length_s is not None:
        step_dt = sim_cfg.physics_dt * cfg.sim_steps_per_control
        cfg.max_episode_steps = max(1, math.ceil(cfg.episode_length_s / step_dt - 1e-9))
    if cfg.max_episode_steps == -1:
        cfg.max_episode_steps = NO_LIMIT
    return cfg


def _check(cfg: EnvCfg) -> None:
    problems = []
    for name in ("num_envs", "sim_steps_per_control"):
        value = getattr(cfg, name)
        if not isinstance(value, int) or isinstance(value, bool) or value < 1:
            problems.append(Problem(name, f"must be an integer of at least 1, got {value!r}"))
    limit: Any = cfg.max_episode_steps
    if not isinstance(limit, int) or (limit < 1 and limit != -1):
        problems.append(
            Problem("max_episode_steps", f"must be at least 1, or -1 for no limit, got {limit!r}")
        )
    seed: Any = cfg.seed
    if seed is not None and (not isinstance(seed, int) or isinstance(seed, bool)):
        problems.append(Problem("seed", f"must be an integer or None, got {seed!r}"))
    if not cfg.sim_cfg.physics_dt > 0:
        problems.append(
            Problem("physics.physics_dt", f"must be positive, got {cfg.sim_cfg.physics_dt!r}")
        )
    if problems:
        raise ConfigError(problems)


def _missing(sim: SimulationManager, uid: str) -> bool:
    return uid not in sim.asset_uids


def _at(path: str, uid: str, error: ConfigError) -> ConfigError:
    """The same mistakes, seen from the root of the config instead of from the entity."""
    return ConfigError(
        [
            Problem(f"{path}.{p.path.removeprefix(uid).strip('.')}".strip("."), p.message, p.hint)
            for p in error.problems
        ]
    )


def add_declared_robots(sim: SimulationManager, cfg: EnvCfg) -> Robot | None:
    """Add the declared robots that are not there yet; return the first declared one, or None.

    Raises:
        ConfigError: If a file or a value is wrong; the path is the one in the config.
    """
    first: Robot | None = None
    declared: dict[str, tuple[str, Any]] = {}
    if cfg.robot is not None:
        declared[name_of(cfg.robot)] = ("robot", cfg.robot)
    for uid, robot_cfg in cfg.robots.items():
        robot_cfg.uid = uid
        declared[uid] = (f"robots.{uid}", robot_cfg)
    for uid, (path, robot_cfg) in declared.items():
        try:
            robot = sim.add_robot(robot_cfg) if _missing(sim, uid) else sim.get_robot(uid)
        except ConfigError as error:
            raise _at(path, uid, error) from error
        first = first or robot
    return first


def add_declared_scene(sim: SimulationManager, cfg: EnvCfg) -> None:
    """Add declared articulations, objects and lights that are not there yet.

    Raises:
        ConfigError: If a file or a value is wrong; the path is the one in the config.
    """
    sections: tuple[tuple[str, Any, Any], ...] = (
        ("articulations", cfg.articulations, sim.add_articulation),
        ("objects", cfg.objects, sim.add_rigid_object),
        ("lights", cfg.lights, sim.add_light),
    )
    for section, entities, add in sections:
        for uid, entity_cfg in entities.items():
            entity_cfg.uid = uid
            if _missing(sim, uid):
                try:
                    add(entity_cfg)
                except ConfigError as error:
                    raise _at(f"{section}.{uid}", uid, error) from error


def add_declared_sensors(sim: SimulationManager, cfg: EnvCfg) -> dict[str, BaseSensor]:
    """Add declared sensors that are not there yet; return all that are declared, by uid.

    Raises:
        ConfigError: If an entity or a link does not exist; the path is the one in the config.
    """
    sensors: dict[str, BaseSensor] = {}
    for uid, sensor_cfg in cfg.sensors.items():
        sensor_cfg.uid = uid
        try:
            sensors[uid] = sim.get_sensor(uid) or sim.add_sensor(sensor_cfg)
        except ConfigError as error:
            raise _at(f"sensors.{uid}", uid, error) from error
    return sensors


def set_extensions(env: object, extensions: dict[str, Any]) -> None:
    """Make ``extensions`` attributes of an environment.

    Raises:
        ConfigError: If the environment has an attribute of that name already.
    """
    taken = [key for key in extensions if not key.isidentifier() or hasattr(env, key)]
    if taken:
        raise ConfigError(
            [
                Problem(f"extensions.{key}", "taken by the environment, or not a name")
                for key in taken
            ]
        )
    for key, value in extensions.items():
        setattr(env, key, value)


def with_all_problems(error: ConfigError, cfg: EnvCfg, built_by_hooks: bool) -> ConfigError:
    """Return an error with every mistake of the config, not only the one that stopped the build.

    Args:
        error: What stopped it.
        cfg: The task.
        built_by_hooks: Whether hooks build the scene, so that the config does not show all of it.
    """
    problems = list(check_terms(cfg))
    if not built_by_hooks:
        problems += describe(cfg)
    known = {(p.path, p.message) for p in problems}
    found = [p for p in error.problems if (p.path, p.message) not in known]
    if any(p.path == q.path for p in found for q in problems):
        found = []  # the same mistake in other words
    return ConfigError([*problems, *found]) if problems else error


def default_actions(robot: Robot | None) -> dict[str, ActionTermCfg]:
    """Return the action term of an MJCF robot that has actuators of its own; else nothing."""
    if robot is None:
        return {}
    parsed = robot.parsed
    passive = any(not parsed.drives[i] for i in robot.active_joint_ids)
    if parsed.own_actuators or (passive and parsed.control_names):
        params = {"entity_cfg": SceneEntityCfg(uid=robot.uid)}
        return {"ctrl": ActionTermCfg(func="actuator_ctrl", params=params)}
    return {}


def open_window(sim: SimulationManager, cfg: SimulationManagerCfg) -> None:
    """Open a window unless the config says headless; without a display, warn and run headless."""
    if cfg.headless:
        return
    if has_display():
        sim.open_window(cfg.window_env)
        return
    logger.warning("headless is False but there is no display here: running headless")
    cfg.headless = True

"""`add_declared_...`: add the entities that a task declares to a simulation."""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable
from typing import TYPE_CHECKING

from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.gym.envs.managers.terms.check import check_terms
from embodichain.lab.gym.envs.managers.terms.registry import SECTIONS
from embodichain.lab.gym.envs.scene_setup.declared_entities import (
    ENTITY_SECTIONS,
    DeclaredEntity,
    check_names,
    check_surroundings,
    declared_entities,
)
from embodichain.lab.gym.envs.scene_setup.declared_scene import describe
from embodichain.lab.sim.cfg import LightCfg, SimulationManagerCfg
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.system.display import has_display

if TYPE_CHECKING:
    from embodichain.lab.sim.objects.robot import Robot
    from embodichain.lab.sim.sensors.base_sensor import BaseSensor
    from embodichain.lab.sim.sim_manager import SimulationManager

__all__ = [
    "add_declared_robots",
    "add_declared_scene",
    "add_declared_sensors",
    "open_window",
    "with_all_problems",
    "with_problems_of_other_terms",
]

logger = logging.getLogger(__name__)

_ROBOT_SECTIONS = ("robot", "robots")
_OTHER_SECTIONS = tuple(section for section in ENTITY_SECTIONS if section not in _ROBOT_SECTIONS)


def add_declared_robots(sim: SimulationManager, cfg: EnvCfg) -> Robot | None:
    """Add the declared robots that the scene lacks; return the first declared one, or None.

    Raises:
        ConfigError: If a file or a value is wrong; the path is the one in the config.
    """
    robots = declared_entities(cfg, *_ROBOT_SECTIONS)
    for robot in robots:
        _add_entity(sim, robot)
    return sim.get_robot(robots[0].uid) if robots else None


def add_declared_scene(sim: SimulationManager, cfg: EnvCfg) -> None:
    """Add the declared articulations, furniture, objects and lights that the scene lacks.

    Raises:
        ConfigError: If a file or a value is wrong; the path is the one in the config.
    """
    problems = check_surroundings(cfg)
    problems += check_names(declared_entities(cfg, *ENTITY_SECTIONS), sim.inside)
    if problems:
        raise ConfigError(problems)
    for entity in declared_entities(cfg, *_OTHER_SECTIONS):
        _add_entity(sim, entity)


def add_declared_sensors(sim: SimulationManager, cfg: EnvCfg) -> dict[str, BaseSensor]:
    """Add the declared sensors that the scene lacks; return all declared ones, by uid.

    Raises:
        ConfigError: If an entity or a link does not exist; the path is the one in the config.
    """
    sensors: dict[str, BaseSensor] = {}
    for uid, sensor_cfg in cfg.sensors.items():
        sensor_cfg.uid = uid
        try:
            sensors[uid] = sim.get_sensor(uid) or sim.add_sensor(sensor_cfg, checked=True)
        except ConfigError as error:
            raise _at_path(error, f"sensors.{uid}", uid) from error
    return sensors


def _add_entity(sim: SimulationManager, entity: DeclaredEntity) -> None:
    """Add an entity if the scene lacks it; key paths of mistakes start at the config's root."""
    if entity.path != "robot":
        entity.cfg.uid = entity.uid
    if entity.uid in sim.asset_uids:
        return
    add_entity = _adder(sim, entity)
    try:
        add_entity(entity.cfg, checked=True)  # as a part of the environment's config
    except ConfigError as error:
        raise _at_path(error, entity.path, entity.uid) from error


def _adder(sim: SimulationManager, entity: DeclaredEntity) -> Callable[..., object]:
    """Return the method that adds an entity of its section."""
    section, _, _ = entity.path.partition(".")
    if section == "scene":  # contains furniture and lights
        section = "lights" if isinstance(entity.cfg, LightCfg) else "objects"
    adders: dict[str, Callable[..., object]] = {
        "robot": sim.add_robot,
        "robots": sim.add_robot,
        "articulations": sim.add_articulation,
        "objects": sim.add_rigid_object,
        "lights": sim.add_light,
    }
    return adders[section]


def _at_path(error: ConfigError, path: str, uid: str) -> ConfigError:
    """Return the error with key paths from the root of the config instead of the entity's."""
    problems: list[Problem] = []
    for problem in error.problems:
        key = problem.path.removeprefix(uid).strip(".")
        problems.append(Problem(f"{path}.{key}".strip("."), problem.message, problem.hint))
    return ConfigError(problems)


def with_all_problems(error: ConfigError, cfg: EnvCfg, built_by_hooks: bool) -> ConfigError:
    """Return an error with every mistake of the config, not only the one that stopped the build.

    Args:
        error: The error that stopped the build.
        cfg: The task.
        built_by_hooks: Whether hooks build the scene, so that the config is not all of it.
    """
    problems = check_terms(cfg)
    if not built_by_hooks:
        problems += describe(cfg).all_problems()
    if not problems:
        return error
    reported = {(problem.path, problem.message) for problem in problems}
    new_problems = [p for p in error.problems if (p.path, p.message) not in reported]
    reported_paths = {problem.path for problem in problems}
    if any(problem.path in reported_paths for problem in new_problems):
        new_problems = []  # the same mistake with another message
    return ConfigError([*problems, *new_problems])


def with_problems_of_other_terms(
    error: ConfigError, cfg: EnvCfg, built_by_hooks: bool
) -> ConfigError:
    """Return an error about types with the mistakes that the terms of right types have.

    Args:
        error: The mistakes of type. Where they are in anything but terms, it is returned: entities
            that cannot be read would make mistakes of what refers to them.
        cfg: The task; not changed.
        built_by_hooks: As of `with_all_problems`.
    """
    wrong_terms = {tuple(problem.path.split(".")[:2]) for problem in error.problems}
    if any(len(term) < 2 or term[0] not in SECTIONS for term in wrong_terms):
        return error
    remaining = copy.deepcopy(cfg)
    for section, name in wrong_terms:
        getattr(remaining, section).pop(name, None)
    return with_all_problems(error, remaining, built_by_hooks)


def open_window(sim: SimulationManager, cfg: SimulationManagerCfg) -> None:
    """Open a window unless the config says headless; without a display, warn and run headless."""
    if cfg.headless:
        return
    if has_display():
        sim.open_window(cfg.window_env)
        return
    logger.warning("headless is False but there is no display here: running headless")
    cfg.headless = True

"""The entities that a task declares, with their key paths and names."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.sim.cfg import ObjectBaseCfg, SimulationManagerCfg, name_of
from embodichain.lab.sim.compiler.geoms.poses import check_pose, initial_pose
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import GROUND, check_uid
from embodichain.lab.sim.compiler.scene.appearance import check_ground
from embodichain.lab.sim.compiler.scene.furniture import check_furniture, furniture_of
from embodichain.lab.sim.compiler.scene.world import WORLD
from embodichain.lab.sim.configs.scene_cfg import SceneCfg
from embodichain.utils.errors import Problem

__all__ = [
    "ENTITY_SECTIONS",
    "DeclaredEntity",
    "check_names",
    "check_surroundings",
    "declared_entities",
]

ENTITY_SECTIONS = ("robot", "robots", "articulations", "scene", "objects", "lights")
"""The sections with entities, in the order in which they are added."""


@dataclass(frozen=True, slots=True, eq=False)
class DeclaredEntity:
    """One declared entity.

    Attributes:
        path: Its key path in the task.
        uid: Its name; empty if it has none.
        cfg: Its config.
    """

    path: str
    uid: str
    cfg: ObjectBaseCfg


def declared_entities(cfg: EnvCfg, *sections: str) -> list[DeclaredEntity]:
    """Return the entities declared in some sections of a task, in order."""
    entities: list[DeclaredEntity] = []
    for section in sections:
        if section == "robot":
            entities += _single_robot(cfg)
        elif section == "scene":
            entities += _surroundings(cfg)
        else:
            entities += _named_entities(cfg, section)
    return entities


def _single_robot(cfg: EnvCfg) -> list[DeclaredEntity]:
    """Return the robot of the section ``robot``, if there is one."""
    robot: Any = cfg.robot
    if robot is None:
        return []
    try:
        name = name_of(robot)
    except ValueError:  # `check_names` reports it
        name = ""
    return [DeclaredEntity("robot", name, robot)]


def _named_entities(cfg: EnvCfg, section: str) -> list[DeclaredEntity]:
    """Return the entities of a section that is a map from names."""
    return [
        DeclaredEntity(f"{section}.{uid}", str(uid), entity)
        for uid, entity in getattr(cfg, section).items()
    ]


def _surroundings(cfg: EnvCfg) -> list[DeclaredEntity]:
    """Return the furniture and the lights of the section ``scene``."""
    scene = _scene_cfg(cfg)
    entities: list[DeclaredEntity] = []
    if scene.table or scene.pedestal:
        furniture = furniture_of(scene, _base_position(cfg))
        for uid, piece in furniture.items():
            entities.append(DeclaredEntity(f"scene.{uid}", uid, piece))
    for uid, light in scene.lights.items():
        entities.append(DeclaredEntity(f"scene.lights.{uid}", uid, light))
    return entities


def _scene_cfg(cfg: EnvCfg) -> SceneCfg:
    """Return the task's own section ``scene``, or that of its simulation."""
    if cfg.scene is not None:
        return cfg.scene
    sim_cfg: SimulationManagerCfg | None = cfg.sim_cfg  # EmbodiChain allows None
    return SceneCfg() if sim_cfg is None else sim_cfg.scene


def _base_position(cfg: EnvCfg) -> F64 | None:
    """Return the position of the first robot's base, if it is valid."""
    robots = declared_entities(cfg, "robot", "robots")
    if not robots or check_pose(robots[0].cfg):
        return None
    position, _ = initial_pose(robots[0].cfg)
    return position


def check_surroundings(cfg: EnvCfg) -> list[Problem]:
    """Return every mistake in the ground and the furniture of the section ``scene``."""
    scene = _scene_cfg(cfg)
    problems = check_ground(scene)
    if scene.table or scene.pedestal:
        problems += check_furniture(scene, _base_position(cfg))
    return [problem.below("scene") for problem in problems]


def check_names(
    entities: Sequence[DeclaredEntity], scene_file_names: Collection[str]
) -> list[Problem]:
    """Return every entity name that is empty, taken, malformed, or different from its key.

    Args:
        entities: The declared entities.
        scene_file_names: The names of the entities in the scene's file.
    """
    problems: list[Problem] = []
    owners = {GROUND: "the ground plane"}
    owners |= dict.fromkeys(scene_file_names, "the scene's file")
    if scene_file_names:
        owners[WORLD] = "the scene's file"
    for entity in entities:
        is_single_robot = entity.path == "robot"
        path = "robot.uid" if is_single_robot else entity.path
        problems += check_uid(entity.uid, path, owners)
        owners.setdefault(entity.uid, entity.path)
        uid = entity.cfg.uid
        if not is_single_robot and uid not in (None, "", entity.uid):
            message = f"the key {entity.uid!r} is its uid; it cannot be {uid!r}: leave uid out"
            problems.append(Problem(f"{entity.path}.uid", message))
    return problems

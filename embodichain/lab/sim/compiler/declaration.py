"""A task's declared scene as one list of entities, and which of its names are wrong.

The task itself belongs to `lab.gym`; all that is asked of it here is `SceneDeclaration`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    LightCfg,
    ObjectBaseCfg,
    RigidObjectCfg,
    RobotCfg,
    SimulationManagerCfg,
    name_of,
)
from embodichain.lab.sim.compiler.names import check_uid
from embodichain.lab.sim.compiler.visuals import GROUND
from embodichain.lab.sim.sensors.cfg import AnySensorCfg
from embodichain.utils.errors import Problem

__all__ = ["Declared", "SceneDeclaration", "check_names", "declared", "scene_physics"]


class SceneDeclaration(Protocol):
    """What `embodichain.lab.gym.envs.EnvCfg` says of a scene."""

    id: str | None
    sim_cfg: SimulationManagerCfg
    physics: Any
    robot: RobotCfg | None
    robots: dict[str, RobotCfg]
    objects: dict[str, RigidObjectCfg]
    articulations: dict[str, ArticulationCfg]
    lights: dict[str, LightCfg]
    sensors: dict[str, AnySensorCfg]


@dataclass(frozen=True)
class Declared:
    """One declared entity: where it stands in the config, its name (empty: none), its config."""

    path: str
    uid: str
    cfg: ObjectBaseCfg


def declared(cfg: SceneDeclaration) -> list[Declared]:
    """Return every entity: robots, articulations, objects, lights, each as declared."""
    entities: list[Declared] = []
    if cfg.robot is not None:
        entities.append(Declared("robot", _name(cfg.robot), cfg.robot))
    sections: tuple[tuple[str, Mapping[str, ObjectBaseCfg]], ...] = (
        ("robots", cfg.robots),
        ("articulations", cfg.articulations),
        ("objects", cfg.objects),
        ("lights", cfg.lights),
    )
    for section, entries in sections:
        entities += [
            Declared(f"{section}.{uid}", str(uid), entry) for uid, entry in entries.items()
        ]
    return entities


def _name(cfg: ObjectBaseCfg) -> str:
    try:
        return name_of(cfg)
    except ValueError:
        return ""


def check_names(entities: list[Declared]) -> list[Problem]:
    """Return every entity name that is empty, taken, malformed, or at odds with its key."""
    problems: list[Problem] = []
    taken = {GROUND: "the ground plane"}
    for entity in entities:
        single = entity.path == "robot"
        path = "robot.uid" if single else entity.path
        problems += check_uid(entity.uid, path, taken)
        taken.setdefault(entity.uid, entity.path)
        own = entity.cfg.uid
        if not single and own not in (None, "", entity.uid):
            message = f"the key {entity.uid!r} is its uid; it cannot be {own!r}: leave uid out"
            problems.append(Problem(f"{entity.path}.uid", message))
    return problems


def scene_physics(cfg: SceneDeclaration) -> SimulationManagerCfg:
    """Return the simulation's config with the task's own physics in it."""
    sim = dataclasses.replace(cfg.sim_cfg)
    if cfg.physics is None:
        return sim
    given = {
        f.name: value
        for f in dataclasses.fields(cfg.physics)
        if (value := getattr(cfg.physics, f.name)) is not None
    }
    sim.physics_dt = given.pop("physics_dt", sim.physics_dt)
    sim.physics_config = dataclasses.replace(sim.physics_config, **given)
    return sim

"""`describe`: every mistake in a task's scene, found before anything is simulated. No torch."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.gym.envs.drive_changes import drive_changes
from embodichain.lab.gym.envs.managers.scene_references import check_references
from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    LightCfg,
    ObjectBaseCfg,
    RigidObjectCfg,
    SimulationManagerCfg,
    name_of,
)
from embodichain.lab.sim.compiler.articulation import ParsedArticulation, parse_with_problems
from embodichain.lab.sim.compiler.drives import DriveChange, PhysicsStep, physics_step
from embodichain.lab.sim.compiler.names import GROUND, check_uid
from embodichain.lab.sim.compiler.rigid_objects import check_object
from embodichain.lab.sim.compiler.robot_links import MAX_MASKED
from embodichain.lab.sim.compiler.scene import check_light, compile_scene
from embodichain.lab.sim.compiler.scene_sensors import SensorPlan, plan_sensors
from embodichain.lab.sim.prepared_scene import PreparedScene
from embodichain.utils.errors import ConfigError, Problem, below

__all__ = ["describe"]


@dataclass(frozen=True)
class _Entity:
    """One declared entity: its key path, its name (empty: none), its config."""

    path: str
    uid: str
    cfg: ObjectBaseCfg


def describe(cfg: EnvCfg, prepared: PreparedScene | None = None) -> list[Problem]:
    """Check what a task declares of its scene: files, names, poses, joints, sizes, references.

    Args:
        cfg: The task.
        prepared: Receives what was read and compiled, for the simulation that is built next.

    Returns:
        Every mistake, with paths relative to the task; empty if the scene compiles. A user's
        mistake raises nothing.
    """
    prepared = PreparedScene() if prepared is None else prepared
    entities, physics = _declared(cfg), _physics(cfg)
    step, changes = physics_step(physics), drive_changes(cfg.events)
    parsed, problems = _parse(entities, step, changes)
    problems = _check_names(entities) + problems
    known: dict[str, ParsedArticulation | str | None] = {}
    for entity in entities:
        known.setdefault(entity.uid, _kind(entity) or parsed.get(entity.path))
    open_scene = cfg.id is not None
    problems += check_references(cfg, known, open_scene=open_scene)
    plans, found = plan_sensors(
        cfg.sensors, known, ground=cfg.sim_cfg.ground_plane, open_scene=open_scene
    )
    problems += found
    if problems:
        return problems
    for path, articulation in parsed.items():
        drawn = changes.get(articulation.uid, ())
        prepared.add_articulation(path, articulation, step, drawn)
    return _compile(physics, entities, [*parsed.values()], plans, prepared)


def _declared(cfg: EnvCfg) -> list[_Entity]:
    """Robots, articulations, objects, lights, each as declared."""
    entities: list[_Entity] = []
    if cfg.robot is not None:
        try:
            name = name_of(cfg.robot)
        except ValueError:
            name = ""
        entities.append(_Entity("robot", name, cfg.robot))
    sections: tuple[tuple[str, Mapping[str, ObjectBaseCfg]], ...] = (
        ("robots", cfg.robots),
        ("articulations", cfg.articulations),
        ("objects", cfg.objects),
        ("lights", cfg.lights),
    )
    for section, entries in sections:
        entities += [_Entity(f"{section}.{uid}", str(uid), e) for uid, e in entries.items()]
    return entities


def _physics(cfg: EnvCfg) -> SimulationManagerCfg:
    """The simulation's config with the task's own physics in it."""
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


def _check_names(entities: Sequence[_Entity]) -> list[Problem]:
    """Every entity name that is empty, taken, malformed, or another one than its key."""
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


def _parse(
    entities: Sequence[_Entity], step: PhysicsStep, changes: Mapping[str, Sequence[DriveChange]]
) -> tuple[dict[str, ParsedArticulation], list[Problem]]:
    """The articulations that could be read, by path, and every mistake in any entity."""
    parsed: dict[str, ParsedArticulation] = {}
    problems: list[Problem] = []
    masked = 0
    for entity in entities:
        found: list[Problem] = []
        cfg = entity.cfg
        if isinstance(cfg, ArticulationCfg):
            drawn = changes.get(entity.uid, ())
            articulation, found = parse_with_problems(entity.uid, cfg, step, drawn)
            if articulation is not None:
                parsed[entity.path] = articulation
            masked += cfg.disable_self_collision
            if cfg.disable_self_collision and masked == MAX_MASKED + 1:
                message = (
                    f"at most {MAX_MASKED} articulations of a scene can set it, this is one more"
                )
                found.append(Problem("disable_self_collision", message))
        elif isinstance(cfg, RigidObjectCfg):
            found = check_object(cfg)
        elif isinstance(cfg, LightCfg):
            found = check_light(cfg)
        problems += below(entity.path, found)
    return parsed, problems


def _kind(entity: _Entity) -> str | None:
    """What an entity without joints is, see `Known`."""
    if isinstance(entity.cfg, RigidObjectCfg):
        return "rigid object"
    return "light" if isinstance(entity.cfg, LightCfg) else None


def _compile(
    physics: SimulationManagerCfg,
    entities: Sequence[_Entity],
    articulations: Sequence[ParsedArticulation],
    sensors: Mapping[str, SensorPlan],
    prepared: PreparedScene,
) -> list[Problem]:
    """Compile what passed every check: what MuJoCo still refuses, such as a broken mesh file."""
    objects = {e.uid: e.cfg for e in entities if isinstance(e.cfg, RigidObjectCfg)}
    lights = {e.uid: e.cfg for e in entities if isinstance(e.cfg, LightCfg)}
    parts = physics, articulations, objects, lights, sensors
    try:
        prepared.add_scene(compile_scene(*parts), *parts)
    except ConfigError as error:
        return list(error.problems)
    return []

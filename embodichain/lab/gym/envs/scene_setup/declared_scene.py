"""`describe`: reads the scene that a task declares and checks it, before anything is built.

`DeclaredScene.compile` makes the model of a scene that the config alone declares, for environments
that are built of the same config. Imports no torch: `validate` calls `describe`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeGuard

import numpy as np

from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.gym.envs.scene_setup.declared_entities import (
    ENTITY_SECTIONS,
    DeclaredEntity,
    check_names,
    check_surroundings,
    declared_entities,
)
from embodichain.lab.gym.envs.scene_setup.drive_changes import drive_changes
from embodichain.lab.gym.envs.scene_setup.entity_references import check_references
from embodichain.lab.gym.envs.scene_setup.frozen_cfg import physics_of
from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    LightCfg,
    RigidObjectCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.compiler.compile_scene import CompiledScene, compile_scene
from embodichain.lab.sim.compiler.names import Known
from embodichain.lab.sim.compiler.robot.articulation import parse_with_problems
from embodichain.lab.sim.compiler.robot.drives.chatter import PhysicsStep, physics_step
from embodichain.lab.sim.compiler.robot.drives.drive_changes import DriveChange
from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
from embodichain.lab.sim.compiler.scene.appearance import check_light
from embodichain.lab.sim.compiler.scene.known import known_entities
from embodichain.lab.sim.compiler.scene.physics_options import check_options
from embodichain.lab.sim.compiler.scene.rigid_objects import check_object
from embodichain.lab.sim.compiler.scene.world import World, read_world
from embodichain.lab.sim.compiler.scene_parts import SceneParts
from embodichain.lab.sim.compiler.sensing.scene_sensors import plan_sensors
from embodichain.lab.sim.compiler.sensing.sensor_plans import SensorPlan
from embodichain.lab.sim.compiler.sensing.views import check_views, places_of_views
from embodichain.lab.sim.configs.scene_cfg import SceneCfg
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["DeclaredScene", "describe"]


@dataclass(frozen=True, eq=False)
class DeclaredScene:
    """The scene that a config declares, with its files read, checked, not compiled.

    Attributes:
        problems: Every mistake, with paths relative to the task.
        known: What references may name: the declared entities and their parts, by uid.
        paths: Uid of an entity -> its key path in the task.
        parts: What it is compiled from; None if there is a mistake.
    """

    problems: tuple[Problem, ...] = ()
    known: Known = field(default_factory=dict)
    paths: Mapping[str, str] = field(default_factory=dict)
    parts: SceneParts | None = None

    def compile(self) -> CompiledScene:
        """Compile it; a later call compiles it again.

        Raises:
            ConfigError: It has a mistake, or MuJoCo finds a further one, such as a broken mesh;
                paths are relative to the task.
        """
        if self.parts is None:
            raise ConfigError(self.problems)
        try:
            return compile_scene(self.parts)
        except ConfigError as error:
            raise ConfigError(p.moved(self.paths) for p in error.problems) from error

    def all_problems(self) -> list[Problem]:
        """Return every mistake; those that only MuJoCo finds too, if there is no other one."""
        try:
            self.compile()
        except ConfigError as error:
            return list(error.problems)
        return []

    def added_armature(self) -> dict[str, dict[str, float]]:
        """Return the armature that was added for limited drives.

        Returns:
            Key path of the articulation in the task -> joint -> armature, kg m^2 or kg.
        """
        if self.parts is None:
            return {}
        armature: dict[str, dict[str, float]] = {}
        for parsed in self.parts.articulations:
            added = _added_armature(parsed)
            if added:
                armature[self.paths[parsed.uid]] = added
        return armature

    def with_given_armature(self) -> DeclaredScene:
        """Return the scene of a config that gives the armature which was added to this one."""
        if self.parts is None:
            return self
        articulations: list[ParsedArticulation] = []
        for parsed in self.parts.articulations:
            added = _added_armature(parsed)
            if added:
                parsed = parsed.with_given_armature(added)
            articulations.append(parsed)
        return replace(self, parts=replace(self.parts, articulations=articulations))


def _added_armature(parsed: ParsedArticulation) -> dict[str, float]:
    """Return the joints of an articulation whose armature was raised -> their armature."""
    raised_joints = np.flatnonzero(parsed.added_armature).tolist()
    return {parsed.joint_names[j]: float(parsed.armature[j]) for j in raised_joints}


def describe(
    cfg: EnvCfg, num_envs: int | None = None, *, allow_import: bool = True
) -> DeclaredScene:
    """Read the declared scene of a task and check it: names, poses, joints, sizes, references.

    Mistakes of a user are not raised: they are `DeclaredScene.problems`.

    Args:
        cfg: The task; not changed.
        num_envs: How many environments there will be; None is the config's number.
        allow_import: Whether events named ``package.module:function`` are imported.
    """
    sim_cfg = physics_of(cfg)
    entities = declared_entities(cfg, *ENTITY_SECTIONS)
    objects = {e.uid: e.cfg for e in entities if isinstance(e.cfg, RigidObjectCfg)}
    lights = {e.uid: e.cfg for e in entities if isinstance(e.cfg, LightCfg)}

    changes = drive_changes(cfg.events, allow_import=allow_import)
    parsed, entity_problems = _read_entities(entities, physics_step(sim_cfg), changes)
    world, world_problems = _read_world(sim_cfg.scene)
    problems = check_names(entities, [] if world is None else list(world.objects))
    problems += check_surroundings(cfg)
    problems += entity_problems
    problems += world_problems

    # An articulation that could not be read is known by name: what refers to it is not a mistake.
    articulations = {
        e.uid: parsed.get(e.path) for e in entities if isinstance(e.cfg, ArticulationCfg)
    }
    known = known_entities(articulations, objects, lights, world, table=sim_cfg.scene.table)
    has_unread_file = bool(sim_cfg.scene.fpath and world is None)
    is_open = cfg.id is not None or has_unread_file
    problems += _check_views(sim_cfg, known, world, is_open)
    problems += _check_marks(entities, known, is_open)
    problems += [p.below("physics") for p in check_options(sim_cfg.physics_config)]
    problems += check_references(cfg, known, open_scene=is_open)
    sensors: dict[str, SensorPlan] = {}
    if cfg.sensors:
        sensors, sensor_problems = plan_sensors(
            cfg.sensors,
            known,
            ground=sim_cfg.has_ground,
            open_scene=is_open,
            num_envs=num_envs or cfg.num_envs,
        )
        problems += sensor_problems

    parts: SceneParts | None = None
    if not problems:
        parts = SceneParts(
            sim_cfg=sim_cfg,
            articulations=[*parsed.values()],
            objects=objects,
            lights=lights,
            sensors=sensors,
            world=world,
        )
    return DeclaredScene(
        problems=tuple(problems),
        known=known,
        paths={e.uid: e.path for e in entities},
        parts=parts,
    )


def _read_world(cfg: SceneCfg) -> tuple[World | None, list[Problem]]:
    """Return the scene's file, if it has one that can be read, and the mistakes in it."""
    if not (cfg.fpath or cfg.keyframe):
        return None, []
    try:
        return read_world(cfg), []
    except ConfigError as error:
        return None, list(error.problems)


def _read_entities(
    entities: Sequence[DeclaredEntity],
    step: PhysicsStep,
    changes: Mapping[str, Sequence[DriveChange]],
) -> tuple[dict[str, ParsedArticulation], list[Problem]]:
    """Return the articulations that could be read, by path, and every mistake in any entity."""
    articulations: dict[str, ParsedArticulation] = {}
    problems: list[Problem] = []
    for entity in entities:
        cfg = entity.cfg
        mistakes: list[Problem] = []
        if isinstance(cfg, ArticulationCfg):
            drive_draws = changes.get(entity.uid, ())
            articulation, mistakes = parse_with_problems(entity.uid, cfg, step, drive_draws)
            if articulation is not None:
                articulations[entity.path] = articulation
        elif isinstance(cfg, RigidObjectCfg):
            mistakes = check_object(cfg)
            if entity.path.startswith("scene."):
                # `check_furniture` names the keys of table and pedestal.
                mistakes = [p for p in mistakes if not p.path.startswith("contact.")]
        elif isinstance(cfg, LightCfg):
            mistakes = check_light(cfg)
        problems += [problem.below(entity.path) for problem in mistakes]
    return articulations, problems


def _check_marks(entities: Sequence[DeclaredEntity], known: Known, is_open: bool) -> list[Problem]:
    """Return every mistake in the marks of objects and of parts of articulations."""
    paths = {e.uid: e.path for e in entities}
    marked = {e.uid: e.cfg for e in entities if _has_marks(e.cfg)}
    if not marked:
        return []
    from embodichain.lab.sim.compiler.scene.object_marks import check_marks  # few scenes have any

    is_incomplete = is_open or None in known.values()
    mistakes = check_marks(marked, known, is_open=is_incomplete)
    return [p.below(paths[uid]) for uid, problems in mistakes.items() for p in problems]


def _has_marks(cfg: object) -> TypeGuard[RigidObjectCfg | ArticulationCfg]:
    if isinstance(cfg, RigidObjectCfg):
        return cfg.halo is not None or cfg.reached is not None
    return isinstance(cfg, ArticulationCfg) and bool(cfg.marks)


def _check_views(
    sim_cfg: SimulationManagerCfg, known: Known, world: World | None, is_open: bool
) -> list[Problem]:
    """Return every mistake in the views."""
    is_incomplete = is_open or None in known.values()
    cameras, bodies = places_of_views(known, world, is_incomplete)
    problems = check_views(sim_cfg.views, cameras, bodies, known)
    return [problem.below("views") for problem in problems]

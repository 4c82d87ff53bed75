"""The scene of a task: `describe` reads and checks it, `add_declared_...` build its entities.

`DeclaredScene.compile` makes the model of a scene that the config alone declares, for environments
that are built of the same config. `check_references` finds references of terms to entities that do
not exist, `drive_changes` which drive gains and link masses events may draw; `frozen_cfg` fills in
derived values. Imports no torch: `validate` calls `describe`.
"""

from __future__ import annotations

import copy
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from embodichain.lab.gym.envs.cfg import NO_LIMIT, EnvCfg, EventCfg
from embodichain.lab.gym.envs.managers.param_types import NamedEntity
from embodichain.lab.gym.envs.managers.scene_entity import references_in
from embodichain.lab.gym.envs.managers.terms.check import check_terms
from embodichain.lab.gym.envs.managers.terms.physics_draws import PhysicsDraw, physics_draws
from embodichain.lab.gym.envs.managers.terms.registry import SECTIONS, TERMS
from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    LightCfg,
    ObjectBaseCfg,
    RigidObjectCfg,
    SimulationManagerCfg,
    name_of,
)
from embodichain.lab.sim.compiler.compile_scene import CompiledScene, compile_scene
from embodichain.lab.sim.compiler.geoms.poses import check_pose, initial_pose
from embodichain.lab.sim.compiler.index import F64
from embodichain.lab.sim.compiler.names import GROUND, Known, check_uid, pick
from embodichain.lab.sim.compiler.robot.articulation import parse_with_problems
from embodichain.lab.sim.compiler.robot.drives.chatter import PhysicsStep, physics_step
from embodichain.lab.sim.compiler.robot.drives.drive_changes import DriveChange
from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
from embodichain.lab.sim.compiler.scene.appearance import check_ground, check_light
from embodichain.lab.sim.compiler.scene.furniture import check_furniture, furniture_of
from embodichain.lab.sim.compiler.scene.known import known_entities
from embodichain.lab.sim.compiler.scene.physics_options import check_options
from embodichain.lab.sim.compiler.scene.rigid_objects import check_object
from embodichain.lab.sim.compiler.scene.world import WORLD, World, read_world
from embodichain.lab.sim.compiler.scene_parts import SceneParts
from embodichain.lab.sim.compiler.sensing.scene_sensors import plan_sensors
from embodichain.lab.sim.compiler.sensing.sensor_plans import SensorPlan
from embodichain.lab.sim.compiler.sensing.views import check_views, places_of_views
from embodichain.lab.sim.configs.scene_cfg import SceneCfg
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean, listing
from embodichain.utils.system.display import has_display

if TYPE_CHECKING:
    from embodichain.lab.sim.objects.robot import Robot
    from embodichain.lab.sim.sensors.base_sensor import BaseSensor
    from embodichain.lab.sim.sim_manager import SimulationManager

__all__ = [
    "DeclaredScene",
    "add_declared_robots",
    "add_declared_scene",
    "add_declared_sensors",
    "describe",
    "drive_changes",
    "frozen_cfg",
    "open_window",
    "with_all_problems",
]

logger = logging.getLogger(__name__)


class _Entity(NamedTuple):
    """One declared entity: its key path, its name (empty if none) and its config."""

    path: str
    uid: str
    cfg: ObjectBaseCfg


_SECTIONS = ("robot", "robots", "articulations", "scene", "objects", "lights")
"""The sections with entities, in the order in which they are added."""


def _declared(cfg: EnvCfg, *sections: str) -> list[_Entity]:
    """The entities declared in some sections of a task, in order."""
    entities: list[_Entity] = []
    for section in sections:
        if section == "scene":
            entities += _surroundings(cfg)
            continue
        declared: Any = getattr(cfg, section)
        if section != "robot":
            entities += [_Entity(f"{section}.{uid}", str(uid), e) for uid, e in declared.items()]
        elif declared is not None:
            try:
                name = name_of(declared)
            except ValueError:
                name = ""
            entities.append(_Entity("robot", name, declared))
    return entities


def _surroundings(cfg: EnvCfg) -> list[_Entity]:
    """The furniture and the lights of the section ``scene``."""
    scene = _scene(cfg)
    lights = [_Entity(f"scene.lights.{uid}", uid, light) for uid, light in scene.lights.items()]
    furniture = furniture_of(scene, _base(cfg)) if scene.table or scene.pedestal else {}
    return [_Entity(f"scene.{uid}", uid, thing) for uid, thing in furniture.items()] + lights


def _check_surroundings(cfg: EnvCfg) -> list[Problem]:
    scene = _scene(cfg)
    problems = check_ground(scene)
    if scene.table or scene.pedestal:
        problems += check_furniture(scene, _base(cfg))
    return [problem.below("scene") for problem in problems]


def _scene(cfg: EnvCfg) -> SceneCfg:
    sim_cfg: SimulationManagerCfg | None = cfg.sim_cfg
    if cfg.scene is not None or sim_cfg is None:
        return cfg.scene or SceneCfg()
    return sim_cfg.scene


def _base(cfg: EnvCfg) -> F64 | None:
    """Position of the first robot's base, if it is valid."""
    robot = next(iter(_declared(cfg, "robot", "robots")), None)
    return None if robot is None or check_pose(robot.cfg) else initial_pose(robot.cfg)[0]


# -- values that follow from others ----------------------------------------------------------------


def frozen_cfg(cfg: EnvCfg | None, num_envs: int | None = None) -> EnvCfg:
    """Return a deep copy of a config with derived fields filled in.

    The ``physics`` section goes into ``sim_cfg``, ``decimation`` into ``sim_steps_per_control``,
    ``episode_length_s`` into ``max_episode_steps`` (rounded up to whole control steps), and the
    number of environments into ``sim_cfg``.

    Args:
        cfg: The user's config, not changed; None is the default one.
        num_envs: Overrides the config's.

    Raises:
        ConfigError: If a value is invalid; names its key path.
    """
    cfg = copy.deepcopy(cfg) if cfg is not None else EnvCfg()
    cfg.complete()
    if num_envs is not None:
        cfg.num_envs = num_envs
    sim_cfg = cfg.sim_cfg = _physics(cfg)
    if cfg.decimation is not None:
        cfg.sim_steps_per_control = cfg.decimation
    _check_numbers(cfg)
    sim_cfg.num_envs = cfg.num_envs
    if cfg.episode_length_s is not None:
        step_dt = sim_cfg.physics_dt * cfg.sim_steps_per_control
        cfg.max_episode_steps = max(1, math.ceil(cfg.episode_length_s / step_dt - 1e-9))
    cfg.max_episode_steps = int(cfg.max_episode_steps)
    if cfg.max_episode_steps == -1:
        cfg.max_episode_steps = NO_LIMIT
    return cfg


def _physics(cfg: EnvCfg) -> SimulationManagerCfg:
    """The simulation config with the task's ``physics`` section; EmbodiChain allows None."""
    sim_cfg: SimulationManagerCfg | None = cfg.sim_cfg
    sim = SimulationManagerCfg(headless=True) if sim_cfg is None else replace(sim_cfg)
    section = {} if cfg.physics is None else vars(cfg.physics)
    values = {name: value for name, value in section.items() if value is not None}
    sim.physics_dt = values.pop("physics_dt", sim.physics_dt)
    sim.physics_config = replace(sim.physics_config, **values)
    sim.scene = cfg.scene or sim.scene
    sim.views = cfg.views or sim.views
    return sim


def _check_numbers(cfg: EnvCfg) -> None:
    """Check the numbers of a task made in Python; pydantic checks those of a task in YAML."""

    def is_integer(value: Any) -> bool:
        return isinstance(value, int) and not isinstance(value, bool)

    problems = []
    for name in ("num_envs", "sim_steps_per_control"):
        value: Any = getattr(cfg, name)
        if not is_integer(value) or value < 1:
            problems.append(Problem(name, f"must be an integer of at least 1, got {value!r}"))
    limit: Any = cfg.max_episode_steps
    if not isinstance(limit, int) or (limit < 1 and limit != -1):
        message = f"must be at least 1, or -1 for no limit, got {limit!r}"
        problems.append(Problem("max_episode_steps", message))
    if cfg.seed is not None and not is_integer(cfg.seed):
        problems.append(Problem("seed", f"must be an integer or None, got {cfg.seed!r}"))
    dt = cfg.sim_cfg.physics_dt
    if not dt > 0:
        problems.append(Problem("physics.physics_dt", f"must be positive, got {dt!r}"))
    if problems:
        raise ConfigError(problems)


# -- checking --------------------------------------------------------------------------------------


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
        articulations = () if self.parts is None else self.parts.articulations
        added = {self.paths[parsed.uid]: _added_armature(parsed) for parsed in articulations}
        return {path: joints for path, joints in added.items() if joints}

    def with_given_armature(self) -> DeclaredScene:
        """Return the scene of a config that gives the armature which was added to this one."""
        if self.parts is None:
            return self
        articulations = []
        for parsed in self.parts.articulations:
            added = _added_armature(parsed)
            articulations.append(parsed.with_given_armature(added) if added else parsed)
        return replace(self, parts=replace(self.parts, articulations=articulations))


def _added_armature(parsed: ParsedArticulation) -> dict[str, float]:
    raised = np.flatnonzero(parsed.added_armature).tolist()
    return {parsed.joint_names[i]: float(parsed.armature[i]) for i in raised}


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
    entities = _declared(cfg, *_SECTIONS)
    physics = _physics(cfg)
    changes = drive_changes(cfg.events, allow_import=allow_import)
    parsed, in_files = _parse(entities, physics_step(physics), changes)
    world, in_world = _read_world(physics.scene)
    inside = {} if world is None else dict.fromkeys(world.objects, "the scene's file")
    problems = _check_names(entities, inside)
    problems += _check_surroundings(cfg)
    problems += in_files
    problems += in_world
    objects = {e.uid: e.cfg for e in entities if isinstance(e.cfg, RigidObjectCfg)}
    lights = {e.uid: e.cfg for e in entities if isinstance(e.cfg, LightCfg)}
    jointed = {e.uid: parsed.get(e.path) for e in entities if isinstance(e.cfg, ArticulationCfg)}
    known = known_entities(jointed, objects, lights, world, physics.scene.table)
    open_scene = cfg.id is not None or bool(physics.scene.fpath and world is None)
    incomplete = open_scene or None in known.values()
    found = check_views(physics.views, *places_of_views(known, world, incomplete), known)
    problems += [p.below("views") for p in found]
    problems += [p.below("physics") for p in check_options(physics.physics_config)]
    problems += check_references(cfg, known, open_scene=open_scene)
    sensors: dict[str, SensorPlan] = {}
    if cfg.sensors:
        ground, count = physics.has_ground, num_envs or cfg.num_envs
        sensors, found = plan_sensors(
            cfg.sensors, known, ground=ground, open_scene=open_scene, num_envs=count
        )
        problems += found
    parts = SceneParts(
        sim_cfg=physics,
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
        parts=None if problems else parts,
    )


def _read_world(cfg: SceneCfg) -> tuple[World | None, list[Problem]]:
    """The scene's file, if it has one and it can be read, and the mistakes in it."""
    if not (cfg.fpath or cfg.keyframe):
        return None, []
    try:
        return read_world(cfg), []
    except ConfigError as error:
        return None, list(error.problems)


def _check_names(entities: Sequence[_Entity], inside: Mapping[str, str]) -> list[Problem]:
    """Every entity name that is empty, taken, malformed, or different from its key."""
    problems: list[Problem] = []
    taken = {GROUND: "the ground plane", **inside}
    taken |= {WORLD: "the scene's file"} if inside else {}
    for entity in entities:
        single = entity.path == "robot"
        path = "robot.uid" if single else entity.path
        problems += check_uid(entity.uid, path, taken)
        taken.setdefault(entity.uid, entity.path)
        uid = entity.cfg.uid
        if not single and uid not in (None, "", entity.uid):
            message = f"the key {entity.uid!r} is its uid; it cannot be {uid!r}: leave uid out"
            problems.append(Problem(f"{entity.path}.uid", message))
    return problems


def _parse(
    entities: Sequence[_Entity], step: PhysicsStep, changes: Mapping[str, Sequence[DriveChange]]
) -> tuple[dict[str, ParsedArticulation], list[Problem]]:
    """The articulations that could be read, by path, and every mistake in any entity."""
    parsed: dict[str, ParsedArticulation] = {}
    problems: list[Problem] = []
    for path, uid, cfg in entities:
        found: list[Problem] = []
        if isinstance(cfg, ArticulationCfg):
            articulation, found = parse_with_problems(uid, cfg, step, changes.get(uid, ()))
            if articulation is not None:
                parsed[path] = articulation
        elif isinstance(cfg, RigidObjectCfg):
            found = check_object(cfg)
            if path.startswith("scene."):  # `check_furniture` names the keys of table and pedestal
                found = [p for p in found if not p.path.startswith("contact.")]
        elif isinstance(cfg, LightCfg):
            found = check_light(cfg)
        problems += [p.below(path) for p in found]
    return parsed, problems


def check_references(cfg: EnvCfg, known: Known, open_scene: bool) -> list[Problem]:
    """Return every reference to an entity, joint, link or control part that does not exist.

    Args:
        cfg: The task.
        known: The declared entities.
        open_scene: Whether Python code may add entities: then an unknown uid is not a mistake.
    """
    problems: list[Problem] = []
    for section, kind in SECTIONS.items():
        for name, term in getattr(cfg, section).items():
            spec = TERMS[kind].get(term.func) if isinstance(term.func, str) else None
            of_light = spec is not None and NamedEntity in spec.hints().values()
            for path, fields in references_in(f"{section}.{name}.params", term.params):
                if of_light:
                    problems += _check_light(path, str(fields.get("uid") or ""), known, open_scene)
                else:
                    problems += pick(path, fields, known, open_scene)[1]
    return problems


def _check_light(path: str, uid: str, known: Known, open_scene: bool) -> list[Problem]:
    lights = [name for name, what in known.items() if what == "light"]
    if uid in lights or (open_scene and uid and uid not in known):
        return []
    message = f"no light is called {uid!r}; there are: {listing(lights, uid)}"
    return [Problem(f"{path}.uid", message, did_you_mean(uid, lights).strip())]


# -- draws of events -------------------------------------------------------------------------------


def drive_changes(
    events: Mapping[str, EventCfg], *, allow_import: bool = True
) -> dict[str, list[DriveChange]]:
    """Return what events declare to draw for drives and links, by articulation uid.

    Args:
        events: The task's events.
        allow_import: Whether events named ``package.module:function`` are imported.
    """
    changes: dict[str, list[DriveChange]] = {}
    for draw in physics_draws(events, allow_import=allow_import):
        change = DriveChange(
            quantity=draw.quantity,
            names=_picked_names(draw),
            ranges=_bounds(draw.range),
            # A strength is a factor of the gains, and no compiled value to replace or to add to.
            operation="abs" if draw.quantity == "strength" else draw.operation,
        )
        changes.setdefault(draw.entity.uid, []).append(change)
    return changes


def _picked_names(draw: PhysicsDraw) -> tuple[str, ...] | None:
    """The patterns of the picked links or joints; None is all."""
    entity = draw.entity
    if draw.quantity in ("mass", "com"):
        keys = [entity.link_names or entity.link]
    else:
        keys = [entity.joint_names, entity.control_parts]
    names: list[str] = []
    for value in keys:
        names += [value] if isinstance(value, str) else value or []
    return tuple(names) or None


def _bounds(
    limits: Sequence[float] | Mapping[str, Sequence[float]],
) -> tuple[float, float] | dict[str, tuple[float, float]]:
    if isinstance(limits, Mapping):
        return {name: (float(low), float(high)) for name, (low, high) in limits.items()}
    low, high = limits
    return float(low), float(high)


# -- building --------------------------------------------------------------------------------------


def _add(sim: SimulationManager, entity: _Entity) -> None:
    """Add an entity if the scene lacks it; key paths of mistakes start at the config's root."""
    path, uid, cfg = entity
    if path != "robot":
        cfg.uid = uid
    if uid in sim.asset_uids:
        return
    add: dict[str, Any] = {
        "robot": sim.add_robot,
        "robots": sim.add_robot,
        "articulations": sim.add_articulation,
        "objects": sim.add_rigid_object,
        "lights": sim.add_light,
        "scene": sim.add_light if isinstance(cfg, LightCfg) else sim.add_rigid_object,
    }
    try:
        add[path.partition(".")[0]](cfg)
    except ConfigError as error:
        raise _at(path, uid, error) from error


def _at(path: str, uid: str, error: ConfigError) -> ConfigError:
    """The error with key paths from the root of the config instead of the entity's."""
    return ConfigError(
        Problem(f"{path}.{p.path.removeprefix(uid).strip('.')}".strip("."), p.message, p.hint)
        for p in error.problems
    )


def add_declared_robots(sim: SimulationManager, cfg: EnvCfg) -> Robot | None:
    """Add the declared robots that the scene lacks; return the first declared one, or None.

    Raises:
        ConfigError: If a file or a value is wrong; the path is the one in the config.
    """
    declared = _declared(cfg, "robot", "robots")
    for entity in declared:
        _add(sim, entity)
    return sim.get_robot(declared[0].uid) if declared else None


def add_declared_scene(sim: SimulationManager, cfg: EnvCfg) -> None:
    """Add the declared articulations, furniture, objects and lights that the scene lacks.

    Raises:
        ConfigError: If a file or a value is wrong; the path is the one in the config.
    """
    inside = dict.fromkeys(sim.inside, "the scene's file")
    problems = _check_surroundings(cfg) + _check_names(_declared(cfg, *_SECTIONS), inside)
    if problems:
        raise ConfigError(problems)
    for entity in _declared(cfg, *_SECTIONS[2:]):
        _add(sim, entity)


def add_declared_sensors(sim: SimulationManager, cfg: EnvCfg) -> dict[str, BaseSensor]:
    """Add the declared sensors that the scene lacks; return all declared ones, by uid.

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
    known = {(p.path, p.message) for p in problems}
    found = [p for p in error.problems if (p.path, p.message) not in known]
    if any(p.path == q.path for p in found for q in problems):
        found = []  # the same mistake with another message
    return ConfigError([*problems, *found]) if problems else error


def open_window(sim: SimulationManager, cfg: SimulationManagerCfg) -> None:
    """Open a window unless the config says headless; without a display, warn and run headless."""
    if cfg.headless:
        return
    if has_display():
        sim.open_window(cfg.window_env)
        return
    logger.warning("headless is False but there is no display here: running headless")
    cfg.headless = True

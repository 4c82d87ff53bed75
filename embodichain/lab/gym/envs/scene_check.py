"""`describe`: every mistake in a task's scene, found before anything is simulated. No torch.

`check_references` finds references of terms to entities that do not exist, `drive_changes` which
drive gains and link masses events may draw.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from embodichain.lab.gym.envs.cfg import EnvCfg, EventCfg
from embodichain.lab.gym.envs.managers.aliases import AliasSpec
from embodichain.lab.gym.envs.managers.registry import SECTIONS, TERMS
from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    LightCfg,
    ObjectBaseCfg,
    RigidObjectCfg,
    SimulationManagerCfg,
    name_of,
)
from embodichain.lab.sim.compiler.articulation import ParsedArticulation, parse_with_problems
from embodichain.lab.sim.compiler.chatter import DriveChange, PhysicsStep, physics_step
from embodichain.lab.sim.compiler.entity_names import Known, check_reference
from embodichain.lab.sim.compiler.names import check_uid
from embodichain.lab.sim.compiler.rigid_objects import check_object
from embodichain.lab.sim.compiler.robot_bodies import MAX_MASKED
from embodichain.lab.sim.compiler.scene import compile_scene
from embodichain.lab.sim.compiler.scene_sensors import SensorPlan, plan_sensors
from embodichain.lab.sim.compiler.visuals import GROUND, check_light
from embodichain.lab.sim.prepared_scene import PreparedScene
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = [
    "describe",
    "drive_changes",
]

_PICKS = ("joint_names", "control_parts")


def drive_changes(events: Mapping[str, EventCfg]) -> dict[str, list[DriveChange]]:
    """Return what events may draw for each articulation, by uid; malformed parameters are left out.

    Args:
        events: The task's events.
    """
    found: dict[str, list[DriveChange]] = {}
    for event in events.values():
        known = TERMS["event"].get(event.func) if isinstance(event.func, str) else None
        func = known.func if known is not None else event.func
        ranges: Mapping[str, str] = getattr(func, "drive_ranges", {})
        params: Mapping[str, Any] = event.params
        if known is not None:
            params = {meant: params[name] for name, meant in known.written(params).items()}
        if isinstance(known, AliasSpec):
            own = {key: params[name] for key, name in known.names.items() if name in params}
            params = {**params, **own}
        entities = params.get("entity_cfgs") or [params.get("entity_cfg")]
        for param, quantity in ranges.items():
            bounds = _bounds(params.get(param))
            for entity in [e for e in entities if e is not None and bounds is not None]:
                names = _names(entity, quantity, params)
                change = DriveChange(quantity, names, bounds, _operation(params, quantity))  # type: ignore[arg-type]
                found.setdefault(str(_get(entity, "uid")), []).append(change)
    return found


def _get(entity: Any, name: str) -> Any:
    return entity.get(name) if isinstance(entity, Mapping) else getattr(entity, name, None)


def _names(entity: Any, quantity: str, params: Mapping[str, Any]) -> tuple[str, ...] | None:
    if quantity == "mass":
        given = [params.get("link_names") or _get(entity, "link_names")]
    else:
        given = [_get(entity, name) for name in _PICKS]
    names = [n for value in given if value for n in ([value] if isinstance(value, str) else value)]
    return tuple(names) or None


def _operation(params: Mapping[str, Any], quantity: str) -> Any:
    if quantity == "strength":  # factors, whatever the operation of the other fields
        return "abs"
    default = "add" if quantity == "mass" and params.get("relative") else "abs"
    return params.get("operation") or default


def _bounds(given: Any) -> Any:
    """[low, high] as a pair, {regex: [low, high]} as a map of pairs; None for anything else."""
    if isinstance(given, Mapping):
        pairs = {str(key): _pair(value) for key, value in given.items()}
        return None if None in pairs.values() else pairs
    return _pair(given)


def _pair(given: Any) -> tuple[float, float] | None:
    numbers = isinstance(given, Sequence) and all(isinstance(x, (int, float)) for x in given)
    return (float(given[0]), float(given[1])) if numbers and len(given) == 2 else None


_LIGHT_TERMS = frozenset({"randomize_light"})
"""Terms whose entity is a light."""

_FIELDS = frozenset(
    {
        "uid",
        "joint_names",
        "link_names",
        "body_names",
        "control_parts",
        "preserve_order",
        "joint_ids",
        "body_ids",
    }
)
_KEY = re.compile(r"(.*_)?(entity_cfg|cfg|relative_to)|of|from|to")


def check_references(cfg: Any, known: Known, open_scene: bool) -> list[Problem]:
    """Return every reference to an entity, joint, link or control part that does not exist.

    A parameter is a reference if it is a `SceneEntityCfg`, or a map with nothing but its keys that
    has ``uid`` or whose own key says so (``of``, ``from``, ``to``, ``..._cfg``, ``relative_to``).

    Args:
        cfg: The task.
        known: The declared entities.
        open_scene: Whether Python code may add entities: an unknown uid is then no mistake.
    """
    problems: list[Problem] = []
    for section in SECTIONS:
        for name, term in getattr(cfg, section).items():
            for path, fields in _references(f"{section}.{name}.params", term.params):
                if term.func in _LIGHT_TERMS:
                    problems += _check_light(path, str(fields.get("uid") or ""), known, open_scene)
                else:
                    problems += check_reference(path, fields, known, open_scene)
    return problems


def _check_light(path: str, uid: str, known: Known, open_scene: bool) -> list[Problem]:
    lights = [name for name, what in known.items() if what == "light"]
    if uid in lights or (open_scene and uid and uid not in known):
        return []
    message = f"no light is called {uid!r}; there are: {listing(lights, uid)}"
    return [Problem(f"{path}.uid", message, did_you_mean(uid, lights).strip())]


def _references(path: str, params: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    items: Iterator[tuple[Any, Any]] = iter(())
    if isinstance(params, Mapping):
        items = iter(params.items())
    elif isinstance(params, (list, tuple)):
        items = iter(enumerate(params))
    for key, value in items:
        where = f"{path}.{key}"
        fields = _fields(str(key), value)
        if fields is not None:
            yield where, fields
        else:
            yield from _references(where, value)


def _fields(key: str, value: Any) -> dict[str, Any] | None:
    """Return a reference's fields, or None if the value is no reference."""
    if isinstance(value, Mapping):
        if ("uid" in value or _KEY.fullmatch(key)) and _FIELDS.issuperset(value):
            return dict(value)
        return None
    if hasattr(value, "uid") and hasattr(value, "joint_names") and hasattr(value, "body_ids"):
        return {name: getattr(value, name) for name in _FIELDS}
    return None


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
        problems += [Problem(f"{entity.path}.{p.path}", p.message, p.hint) for p in found]
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

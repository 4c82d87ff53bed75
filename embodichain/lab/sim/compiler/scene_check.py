"""`describe`: every mistake in a task's scene, found before anything is simulated. No torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    LightCfg,
    RigidObjectCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.compiler.articulation import ParsedArticulation, parse_with_problems
from embodichain.lab.sim.compiler.chatter import DriveChange, may_chatter, physics_step
from embodichain.lab.sim.compiler.collision import MAX_MASKED
from embodichain.lab.sim.compiler.declaration import (
    Declared,
    SceneDeclaration,
    check_names,
    declared,
    scene_physics,
)
from embodichain.lab.sim.compiler.objects import check_object
from embodichain.lab.sim.compiler.pose import initial_pose
from embodichain.lab.sim.compiler.references import check_references
from embodichain.lab.sim.compiler.scene import compile_scene
from embodichain.lab.sim.compiler.sensor_plans import SensorPlan, plan_sensors
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["describe", "known_entities", "parse_scene", "raised_armature"]


def describe(cfg: SceneDeclaration) -> list[Problem]:
    """Check what a task declares of its scene: files, names, poses, joints, sizes, references.

    Args:
        cfg: The task (`EnvCfg`).

    Returns:
        Every mistake, with paths relative to the task; empty if the scene compiles. A user's
        mistake raises nothing.
    """
    entities = declared(cfg)
    parsed, problems = parse_scene(entities)
    problems = check_names(entities) + problems
    known, open_scene = known_entities(entities, parsed), cfg.id is not None
    problems += check_references(cfg, known, open_scene=open_scene)
    plans, found = plan_sensors(
        cfg.sensors, known, ground=cfg.sim_cfg.ground_plane, open_scene=open_scene
    )
    problems += found
    return problems or _compile(scene_physics(cfg), entities, parsed, plans)


def parse_scene(
    entities: list[Declared],
) -> tuple[dict[str, ParsedArticulation], list[Problem]]:
    """Return the articulations that could be read, by path, and every mistake in any entity."""
    parsed: dict[str, ParsedArticulation] = {}
    problems: list[Problem] = []
    masked = 0
    for entity in entities:
        found: list[Problem] = []
        if isinstance(entity.cfg, ArticulationCfg):
            articulation, found = parse_with_problems(entity.uid, entity.cfg)
            if articulation is not None:
                parsed[entity.path] = articulation
            masked += entity.cfg.disable_self_collision
            if entity.cfg.disable_self_collision and masked == MAX_MASKED + 1:
                message = (
                    f"at most {MAX_MASKED} articulations of a scene can set it, this is one more"
                )
                found.append(Problem("disable_self_collision", message))
        elif isinstance(entity.cfg, RigidObjectCfg):
            found = check_object(entity.cfg)
        elif isinstance(entity.cfg, LightCfg):
            found = _check_light(entity.cfg)
        problems += [Problem(f"{entity.path}.{p.path}", p.message, p.hint) for p in found]
    return parsed, problems


def raised_armature(
    cfg: SceneDeclaration, changes: Mapping[str, Sequence[DriveChange]]
) -> dict[str, dict[str, float]]:
    """Return the armature of joints that got some so that their limited drives do not chatter.

    Args:
        cfg: The task (`EnvCfg`), without mistakes.
        changes: What events may draw for drives and links, by uid.

    Returns:
        Path of the articulation in the task -> joint -> its armature, kg m^2 or kg.
    """
    step = physics_step(scene_physics(cfg))
    found: dict[str, dict[str, float]] = {}
    for entity in declared(cfg):
        if not isinstance(entity.cfg, ArticulationCfg):
            continue
        drawn = changes.get(entity.uid, ())
        if not may_chatter(entity.cfg.drive_pros, step, drawn):
            continue
        parsed, _ = parse_with_problems(entity.uid, entity.cfg, step, drawn)
        if parsed is not None and parsed.added_armature.any():
            found[entity.path] = {
                parsed.joint_names[i]: round(float(parsed.armature[i]), 12)
                for i in np.flatnonzero(parsed.added_armature).tolist()
            }
    return found


def _check_light(cfg: LightCfg) -> list[Problem]:
    problems: list[Problem] = []
    try:
        initial_pose(cfg)
    except ConfigError as error:
        problems += error.problems
    color, direction = np.asarray(cfg.color, np.float64), np.asarray(cfg.direction, np.float64)
    if not ((color >= 0) & (color <= 1)).all():
        problems.append(Problem("color", f"RGB in [0, 1], got {color.tolist()}"))
    if not cfg.intensity >= 0:
        problems.append(Problem("intensity", f"must not be negative, got {cfg.intensity}"))
    if not (np.isfinite(direction).all() and np.linalg.norm(direction) > 1e-9):
        problems.append(Problem("direction", f"must not be zero, got {direction.tolist()}"))
    return problems


def known_entities(
    entities: list[Declared], parsed: Mapping[str, ParsedArticulation]
) -> dict[str, ParsedArticulation | str | None]:
    """Return what references may point at, by uid; see `references.Known`."""
    known: dict[str, ParsedArticulation | str | None] = {}
    for entity in entities:
        value: Any = parsed.get(entity.path)
        if isinstance(entity.cfg, RigidObjectCfg):
            value = "rigid object"
        elif isinstance(entity.cfg, LightCfg):
            value = "light"
        known.setdefault(entity.uid, value)
    return known


def _compile(
    physics: SimulationManagerCfg,
    entities: list[Declared],
    parsed: Mapping[str, ParsedArticulation],
    sensors: Mapping[str, SensorPlan],
) -> list[Problem]:
    """Compile what passed every check: what MuJoCo still refuses, such as a broken mesh file."""
    objects = {e.uid: e.cfg for e in entities if isinstance(e.cfg, RigidObjectCfg)}
    try:
        compile_scene(physics, [*parsed.values()], objects, {}, sensors, report=False)
    except ConfigError as error:
        return list(error.problems)
    return []

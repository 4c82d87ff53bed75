"""`describe_scene`: a scene in tables, for people - entities, links, joints, drives, limits."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import LightCfg, RigidObjectCfg
from embodichain.lab.sim.compiler.actuators import ActuatorDescription, describe_actuators
from embodichain.lab.sim.compiler.articulation import ParsedArticulation
from embodichain.lab.sim.compiler.declaration import (
    SceneDeclaration,
    check_names,
    declared,
    scene_physics,
)
from embodichain.lab.sim.compiler.index import EntityIndex
from embodichain.lab.sim.compiler.scene import CompiledScene, compile_scene
from embodichain.lab.sim.compiler.scene_check import parse_scene
from embodichain.utils.errors import ConfigError

__all__ = [
    "ActuatorDescription",
    "EntityDescription",
    "JointDescription",
    "SceneDescription",
    "describe_scene",
]


@dataclass(frozen=True)
class JointDescription:
    """One joint: rad and N m for a hinge, m and N for a slide.

    Attributes:
        name: Its name within the articulation.
        type: ``hinge`` or ``slide``.
        limits: Lower and upper position; infinite where there is none.
        velocity_limit: From the file; inf where it has none.
        init: Initial position.
        stiffness: Of its drive; 0 without one.
        damping: Of the joint.
        max_effort: Of its drive, else of the file; inf is none.
        armature: Reflected inertia.
        friction: Dry friction.
        actuator: What takes its position target, in the model: a drive or a servo of the file; or
            an empty string.
        mimics: The joint it follows, or an empty string.
    """

    name: str
    type: str
    limits: tuple[float, float]
    velocity_limit: float
    init: float
    stiffness: float
    damping: float
    max_effort: float
    armature: float
    friction: float
    actuator: str
    mimics: str


@dataclass(frozen=True)
class EntityDescription:
    """One entity.

    Attributes:
        uid: Its name.
        kind: ``articulation`` or ``object``.
        moves: ``fixed base``, ``floating base``, ``dynamic``, ``kinematic`` or ``static``.
        source: File or shape.
        position: (x, y, z) in metres at the start.
        quaternion: wxyz at the start.
        mass: kg, all links.
        links: Names of its frames, parents before children.
        joints: Its hinges and slides.
        actuators: Its file's actuators, then drives.
        colliding_geoms: How many of its geoms collide.
        control_parts: Part -> joint names.
    """

    uid: str
    kind: str
    moves: str
    source: str
    position: tuple[float, ...]
    quaternion: tuple[float, ...]
    mass: float
    links: tuple[str, ...]
    joints: tuple[JointDescription, ...]
    actuators: tuple[ActuatorDescription, ...]
    colliding_geoms: int
    control_parts: dict[str, tuple[str, ...]]


@dataclass(frozen=True)
class SceneDescription:
    """A compiled scene, for people.

    Attributes:
        entities: Robots and articulations, then objects.
        timestep: Seconds a physics step.
        gravity: m/s^2.
        integrator: MuJoCo's name for it.
        sizes: Number of qpos, qvel, controls, bodies, geoms.
        cameras: Names of cameras.
        lights: Names of lights.
    """

    entities: tuple[EntityDescription, ...]
    timestep: float
    gravity: tuple[float, ...]
    integrator: str
    sizes: dict[str, int]
    cameras: tuple[str, ...]
    lights: tuple[str, ...]


def describe_scene(cfg: SceneDeclaration) -> SceneDescription:
    """Compile a task's scene and put it into tables.

    Args:
        cfg: The task (`EnvCfg`).

    Raises:
        ConfigError: If the scene has mistakes; all that `describe` finds but for references.
    """
    entities = declared(cfg)
    parsed, problems = parse_scene(entities)
    problems = check_names(entities) + problems
    if problems:
        raise ConfigError(problems)
    objects = {e.uid: e.cfg for e in entities if isinstance(e.cfg, RigidObjectCfg)}
    lights = {e.uid: e.cfg for e in entities if isinstance(e.cfg, LightCfg)}
    scene = compile_scene(scene_physics(cfg), [*parsed.values()], objects, lights, report=False)
    model = scene.model
    return SceneDescription(
        entities=(
            *(_articulation(scene, p) for p in parsed.values()),
            *(_object(scene, uid, o) for uid, o in objects.items()),
        ),
        timestep=float(model.opt.timestep),
        gravity=tuple(float(g) for g in model.opt.gravity),
        integrator=mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_").lower(),
        sizes={
            "qpos": model.nq,
            "qvel": model.nv,
            "controls": model.nu,
            "actuators": model.nactuator,
            "bodies": model.nbody,
            "geoms": model.ngeom,
        },
        cameras=tuple(model.camera(i).name for i in range(model.ncam)),
        lights=tuple(model.light(i).name for i in range(model.nlight)),
    )


def _articulation(scene: CompiledScene, parsed: ParsedArticulation) -> EntityDescription:
    index = scene.entities[parsed.uid]
    names = parsed.joint_names
    return _entity(
        scene.model,
        index,
        moves="fixed base" if parsed.fixed_base else "floating base",
        source=str(parsed.cfg.fpath),
        links=parsed.link_names,
        joints=tuple(_joint(scene.model, index, parsed, i) for i in range(len(names))),
        control_parts={
            part: tuple(names[i] for i in ids) for part, ids in parsed.control_parts.items()
        },
    )


def _joint(
    model: mujoco.MjModel, index: EntityIndex, parsed: ParsedArticulation, i: int
) -> JointDescription:
    joint = model.joint(f"{parsed.uid}/{parsed.joint_names[i]}")
    actuator = int(index.actuator_ids[i])
    mimics = ""
    if i in parsed.mimic_ids:
        mimics = parsed.joint_names[parsed.mimic_parents[parsed.mimic_ids.index(i)]]
    return JointDescription(
        name=parsed.joint_names[i],
        type=mujoco.mjtJoint(int(joint.type[0])).name.removeprefix("mjJNT_").lower(),
        limits=(float(parsed.qpos_limits[i, 0]), float(parsed.qpos_limits[i, 1])),
        velocity_limit=float(parsed.qvel_limits[i]),
        init=float(parsed.init_qpos[i]),
        stiffness=float(parsed.stiffness[i]),
        damping=float(parsed.damping[i]),
        max_effort=float(parsed.max_effort[i]),
        armature=float(parsed.armature[i]),
        friction=float(parsed.friction[i]),
        actuator=model.actuator(actuator).name if actuator >= 0 else "",
        mimics=mimics,
    )


def _object(scene: CompiledScene, uid: str, cfg: RigidObjectCfg) -> EntityDescription:
    index = scene.entities[uid]
    return _entity(
        scene.model, index, moves=cfg.body_type, source=cfg.shape.shape_type, links=(uid,)
    )


def _entity(
    model: mujoco.MjModel,
    index: EntityIndex,
    *,
    moves: str,
    source: str,
    links: tuple[str, ...],
    joints: tuple[JointDescription, ...] = (),
    control_parts: dict[str, tuple[str, ...]] | None = None,
) -> EntityDescription:
    geoms = index.geom_ids
    colliding = (model.geom_contype[geoms] | model.geom_conaffinity[geoms]) != 0
    return EntityDescription(
        uid=index.uid,
        kind=index.kind,
        moves=moves,
        source=source,
        position=tuple(float(x) for x in index.pos0),
        quaternion=tuple(float(x) for x in index.quat0),
        mass=float(model.body_mass[index.body_ids].sum()),
        links=links,
        joints=joints,
        actuators=tuple(describe_actuators(model)[i] for i in index.own_actuator_ids),
        colliding_geoms=int(np.count_nonzero(colliding)),
        control_parts=control_parts or {},
    )

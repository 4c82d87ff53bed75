"""`Scene`: entities and sensors of a simulation by uid, and the compiled model."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Mapping, Sequence
from typing import Any

from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    LightCfg,
    RigidObjectCfg,
    SimulationManagerCfg,
    name_of,
)
from embodichain.lab.sim.compiler.compile_scene import CompiledScene, compile_scene
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.lab.sim.compiler.robot.drives.chatter import physics_step
from embodichain.lab.sim.compiler.robot.drives.drive_changes import DriveChange
from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
from embodichain.lab.sim.compiler.scene.known import known_entities
from embodichain.lab.sim.compiler.scene.world import World, read_world
from embodichain.lab.sim.compiler.scene_parts import SceneParts
from embodichain.lab.sim.compiler.sensing.sensor_plans import SensorPlan, plan_sensor
from embodichain.lab.sim.configs.sensor_cfg import SensorCfg
from embodichain.lab.sim.engine.api import Engine
from embodichain.lab.sim.engine.room import bytes_of
from embodichain.lab.sim.objects.articulation import Articulation
from embodichain.lab.sim.objects.light import Light
from embodichain.lab.sim.objects.rigid_object import RigidObject
from embodichain.lab.sim.objects.robot import Robot
from embodichain.lab.sim.sensors.base_sensor import BaseSensor
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.fields.no_effect import changed_without_effect
from embodichain.utils.named import Named
from embodichain.utils.notes import warn_once
from embodichain.utils.system.memory import require_memory_for

__all__ = ["Entity", "Scene"]

_log = logging.getLogger(__name__)

Entity = Articulation | RigidObject


class Scene:
    """Entities and sensors by uid; compiled once, after which nothing can be added.

    Notes about files are logged as warnings, once.

    Args:
        cfg: Physics options, look, views.
        compiled_scene: The scene, if it was compiled before; entities are added to get their
            handles, which must be those that it was compiled from. Nothing writes to it.
        checked: Whether the configs of the entities were checked, which reports values without
            effect; else they are reported here.

    Attributes:
        robots, articulations, rigid_objects, lights, sensors: Handles by uid; `articulations`
            contains no robots.
        world: The file of ``cfg.scene``, or None. Its objects are in `rigid_objects`.
        known: What references may name: all entities and their parts, by uid.
        compiled: The model and the indices of each entity; None before `compile`.

    Raises:
        ConfigError: If the scene's file is wrong; paths begin with ``scene``.
    """

    def __init__(
        self,
        cfg: SimulationManagerCfg,
        compiled_scene: CompiledScene | None = None,
        *,
        checked: bool = False,
    ) -> None:
        self._cfg = cfg
        self._precompiled = compiled_scene
        self._checked = checked
        self.robots: dict[str, Robot] = Named("robot")
        self.articulations: dict[str, Articulation] = Named("articulation")
        self.rigid_objects: dict[str, RigidObject] = Named("rigid object")
        self.lights: dict[str, Light] = Named("light")
        self.sensors: dict[str, BaseSensor] = Named("sensor")
        self.world: World | None = None
        if compiled_scene is not None:
            self.world = compiled_scene.parts.world
        elif cfg.scene.fpath or cfg.scene.keyframe:
            self.world = read_world(cfg.scene)
        self.known = known_entities({}, {}, {}, self.world)
        self.compiled: CompiledScene | None = None

    @property
    def inside(self) -> Mapping[str, RigidObjectCfg]:
        """The objects of the scene's file, by uid."""
        return {} if self.world is None else self.world.objects

    @property
    def jointed(self) -> dict[str, Articulation]:
        """Robots, then other articulations."""
        return {**self.robots, **self.articulations}

    @property
    def uids(self) -> list[str]:
        """Uids of everything in the scene, ``default_plane`` included."""
        plane = ["default_plane"] if self._cfg.has_ground else []
        return [*plane, *self.jointed, *self.rigid_objects, *self.lights, *self.sensors]

    def claim(self, cfg: Any) -> str:
        """Check that an entity or sensor can be added, and return its uid.

        Raises:
            ConfigError: If the uid is missing or taken.
            RuntimeError: If the scene is compiled already.
        """
        if self.compiled is not None:
            raise RuntimeError(
                "the scene is compiled already (by a step, a reset or a pose that was read): "
                "add every robot and object first; what comes later can wait out of the way"
            )
        uid = name_of(cfg)
        if uid in self.uids:
            raise ConfigError([Problem(uid, f"uid {uid!r} is taken; taken: {self.uids}")])
        if isinstance(cfg, RigidObjectCfg):
            self.known |= known_entities({}, {uid: cfg}, {}, None, self._cfg.scene.table)
        elif isinstance(cfg, LightCfg):
            self.known[uid] = "light"
        return uid

    def parse(
        self, cfg: ArticulationCfg, changes: Mapping[str, Sequence[DriveChange]]
    ) -> ParsedArticulation:
        """Read the file of an articulation to be added, unless the scene was compiled before.

        Raises as `claim` does.

        Args:
            cfg: The articulation.
            changes: Values that events may draw for drives and links, by uid.
        """
        uid = self.claim(cfg)
        parsed = None
        if self._precompiled is not None:
            parsed = self._precompiled.parts.articulation(uid)
        if parsed is not None:
            parsed = dataclasses.replace(parsed, cfg=cfg)
        else:
            step = physics_step(self._cfg)
            parsed = parse_articulation(uid, cfg, step, changes.get(uid, ()))
        each = bytes_of(parsed.model, self._cfg.persistent)
        require_memory_for(self._cfg.num_envs, each, "environments with this robot", "num_envs")
        self.known[uid] = parsed
        return parsed

    def plan_sensor(self, cfg: SensorCfg) -> SensorPlan:
        """Look up the links of a sensor; raises as `claim` does."""
        uid = self.claim(cfg)
        plan, problems = plan_sensor(uid, cfg, self.known, ground=self._cfg.has_ground)
        if plan is None:
            raise ConfigError(p.below(uid) for p in problems)
        return plan

    def remove(self, uid: str) -> bool:
        """Remove an entity or a sensor; returns whether it existed.

        Raises:
            RuntimeError: If the scene is compiled already.
            ValueError: If it is an object of the scene's file.
        """
        if self.compiled is not None:
            raise RuntimeError(
                "the scene is compiled already (by a step, a reset or a pose that was read): "
                "nothing can be removed; an object can be moved out of the way (set_local_pose)"
            )
        if uid in self.inside:
            raise ValueError(f"{uid!r} is part of the scene's file: it cannot be removed")
        self.known.pop(uid, None)
        groups = self.robots, self.articulations, self.rigid_objects, self.lights, self.sensors
        return any(group.pop(uid, None) is not None for group in groups)

    def entity(self, uid: str) -> Entity | None:
        """A robot, articulation or rigid object by uid, or None."""
        groups: tuple[Mapping[str, Entity], ...]
        groups = self.robots, self.articulations, self.rigid_objects
        return next((group[uid] for group in groups if uid in group), None)

    def compile(self) -> CompiledScene:
        """Compile everything into one model at the first call, and return it.

        Raises:
            ConfigError: If MuJoCo refuses the model.
            ValueError: If a scene was given that was compiled from other entities.
        """
        if self.compiled is None:
            parts = self._parts()
            if self._precompiled is None:
                self.compiled = compile_scene(parts)
            else:
                _require_same(parts, self._precompiled.parts)
                self.compiled = self._precompiled
            notes: list[str] = []
            for articulation in parts.articulations:
                notes += [f"{articulation.uid}: {note}" for note in articulation.all_notes]
            if not self._checked:
                notes += self._without_effect()
            for note in (*notes, *self.compiled.notes):
                warn_once(_log, note)
        return self.compiled

    def _parts(self) -> SceneParts:
        """What was added."""
        return SceneParts(
            sim_cfg=self._cfg,
            articulations=[articulation.parsed for articulation in self.jointed.values()],
            objects={uid: o.cfg for uid, o in self.rigid_objects.items() if uid not in self.inside},
            lights={uid: light.cfg for uid, light in self.lights.items()},
            sensors={uid: sensor.plan for uid, sensor in self.sensors.items()},
            world=self.world,
        )

    def _without_effect(self) -> list[str]:
        """Messages about values of configs made in Python that change nothing."""
        messages: list[str] = []
        for uid, entity in {**self.jointed, **self.rigid_objects}.items():
            if uid in self.inside:
                continue
            entity_cfg: Any = entity.cfg
            for prefix, cfg in (("", entity_cfg), ("attrs.", entity_cfg.attrs)):
                for name, mark in changed_without_effect(cfg):
                    messages.append(f"{uid}: {prefix}{name} {mark.message}")
        return messages

    def bind(self, engine: Engine) -> None:
        """Give every handle the engine and its indices in the compiled model."""
        scene = self.compile()
        for entity in (*self.jointed.values(), *self.rigid_objects.values()):
            entity.bind(engine, scene.entities[entity.uid])
        for uid, light in self.lights.items():
            light.bind(engine, int(scene.model.light(uid).id))
        for uid, sensor in self.sensors.items():
            sensor.bind(engine, scene.sensors[uid])

    def destroy(self) -> None:
        """Drop the model, and have every handle drop the engine."""
        self.compiled = None
        self.known.clear()
        groups = (self.jointed, self.rigid_objects, self.lights, self.sensors)
        for group in groups:
            for handle in group.values():
                handle.destroy()


def _require_same(parts: SceneParts, compiled: SceneParts) -> None:
    """Refuse a scene that was compiled from other entities than those that were added."""
    differences = parts.differences(compiled)
    if differences:
        raise ValueError(
            f"compiled_scene was compiled from another config; these differ: "
            f"{', '.join(differences)}"
        )

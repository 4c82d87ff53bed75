"""`SceneParts`: what a scene is compiled from, with all files read."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from embodichain.lab.sim.cfg import LightCfg, RigidObjectCfg, SimulationManagerCfg
from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
from embodichain.lab.sim.compiler.scene.world import World
from embodichain.lab.sim.compiler.sensing.sensor_plans import SensorPlan
from embodichain.utils.fields.defaults import is_given

__all__ = ["SceneParts"]


@dataclass(frozen=True, eq=False)
class SceneParts:
    """Physics options, entities and sensors of a scene; `compile_scene` makes a model of them.

    Compiling changes none of them: specs are copied.

    Attributes:
        sim_cfg: Time step, physics options, look, views; how the simulation runs is not used.
        articulations: Robots and other articulations, with their files read.
        objects: Rigid objects by uid.
        lights: Lights by uid.
        sensors: Sensors by uid.
        world: The file of `sim_cfg.scene`, if it has one.
    """

    sim_cfg: SimulationManagerCfg
    articulations: Sequence[ParsedArticulation] = ()
    objects: Mapping[str, RigidObjectCfg] = field(default_factory=dict)
    lights: Mapping[str, LightCfg] = field(default_factory=dict)
    sensors: Mapping[str, SensorPlan] = field(default_factory=dict)
    world: World | None = None

    def articulation(self, uid: str) -> ParsedArticulation | None:
        """One of the articulations, or None."""
        return next((parsed for parsed in self.articulations if parsed.uid == uid), None)

    def differences(self, other: SceneParts) -> list[str]:
        """Name the parts in which two scenes differ; configs are compared by value.

        Files that were read twice differ, because they may have changed between.
        """
        mine, others = self._by_name(), other._by_name()
        absent = object()
        return [
            name
            for name in {**mine, **others}
            if mine.get(name, absent) != others.get(name, absent)
        ]

    def _by_name(self) -> dict[str, Any]:
        """Name of a part, for messages -> what determines it, comparable with ``==``."""
        sim = self.sim_cfg
        parts: dict[str, Any] = {
            "physics": _comparable([sim.physics_dt, sim.physics_config]),
            "scene": _comparable([sim.has_ground, sim.scene]),
            "views": _comparable(sim.views),
        }
        for parsed in self.articulations:
            parts[parsed.uid] = id(parsed.spec), _comparable(parsed.cfg)
        for group in (self.objects, self.lights, self.sensors):
            for uid, entity in group.items():
                parts[uid] = _comparable(entity)
        if self.world is not None:
            parts["the scene's file"] = id(self.world.spec)
        parts["order"] = tuple(parts)  # of elements in the model
        return parts


def _comparable(value: Any) -> Any:
    """A config as nested tuples, without `uid`, which the sections of a task set."""
    if not is_given(value):
        return "default", str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value) if field.name != "uid"]
        return type(value).__name__, *(_comparable(getattr(value, name)) for name in names)
    if isinstance(value, Mapping):
        return tuple((key, _comparable(item)) for key, item in value.items())
    if hasattr(value, "tolist"):  # numpy, torch
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return tuple(_comparable(item) for item in value)
    return value

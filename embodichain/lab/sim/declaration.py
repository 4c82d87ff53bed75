"""`Declaration`: what was added to a scene before it is compiled, by uid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    LightCfg,
    RigidObjectCfg,
    RobotCfg,
    SimulationManagerCfg,
    name_of,
)
from embodichain.lab.sim.compiler import ParsedArticulation, parse_articulation
from embodichain.lab.sim.compiler.chatter import DriveChange, physics_step
from embodichain.lab.sim.compiler.sensor_plans import SensorPlan, plan_sensor
from embodichain.lab.sim.objects.articulation import Articulation
from embodichain.lab.sim.objects.light import Light
from embodichain.lab.sim.objects.rigid_object import RigidObject
from embodichain.lab.sim.objects.robot import Robot
from embodichain.lab.sim.sensors.base import BaseSensor
from embodichain.lab.sim.sensors.camera_cfg import CameraCfg, no_camera
from embodichain.lab.sim.sensors.cfg import SensorCfg
from embodichain.lab.sim.sensors.contact import ContactSensor
from embodichain.lab.sim.sensors.force_torque import ForceTorqueSensor
from embodichain.lab.sim.sensors.imu import ImuSensor
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.sim.sim_manager import SimulationManager

__all__ = ["Declaration", "Handle"]

Handle = Articulation | RigidObject

_SENSORS: dict[str, type[BaseSensor]] = {
    "contact": ContactSensor,
    "force_torque": ForceTorqueSensor,
    "imu": ImuSensor,
}


class Declaration:
    """Entities by uid; the base of `SimulationManager`, which compiles them."""

    sim_config: SimulationManagerCfg
    num_envs: int

    def __init__(self) -> None:
        self.robots: dict[str, Robot] = {}
        self.articulations: dict[str, Articulation] = {}
        self.rigid_objects: dict[str, RigidObject] = {}
        self.lights: dict[str, Light] = {}
        self.sensors: dict[str, BaseSensor] = {}
        self.drive_changes: Mapping[str, Sequence[DriveChange]] = {}
        """What events may draw for the drives and links of articulations that are added, by uid."""

    @property
    def compiled(self) -> bool:
        """Whether the scene is compiled."""
        raise NotImplementedError

    def _simulation(self) -> SimulationManager:
        """The simulation this declaration is part of."""
        raise NotImplementedError

    # -- declaring -----------------------------------------------------------------------------

    def _claim(self, cfg: Any) -> str:
        if self.compiled:
            raise RuntimeError(
                "the scene is compiled already (by a step, a reset or a pose that was read): "
                "add every robot and object first; what comes later can wait out of the way"
            )
        uid = name_of(cfg)
        if uid in self.asset_uids:
            raise ConfigError([Problem(uid, f"uid {uid!r} is taken; taken: {self.asset_uids}")])
        if self.num_envs < 1:
            raise ConfigError([Problem("num_envs", f"must be at least 1, got {self.num_envs}")])
        return uid

    def _parse(self, uid: str, cfg: ArticulationCfg) -> ParsedArticulation:
        step = physics_step(self.sim_config)
        return parse_articulation(uid, cfg, step, self.drive_changes.get(uid, ()))

    def add_robot(self, cfg: RobotCfg) -> Robot:
        """Add a robot; its file is read at once, so names and limits are known on return.

        Raises:
            ConfigError: If the file or a value in the config is wrong.
            RuntimeError: If the scene is compiled already.
        """
        uid = self._claim(cfg)
        robot = Robot(cfg, self._parse(uid, cfg), self._simulation())
        self.robots[uid] = robot
        return robot

    def add_articulation(self, cfg: ArticulationCfg) -> Articulation:
        """Add an articulation without control parts; see `add_robot`."""
        uid = self._claim(cfg)
        articulation = Articulation(cfg, self._parse(uid, cfg), self._simulation())
        self.articulations[uid] = articulation
        return articulation

    def add_rigid_object(self, cfg: RigidObjectCfg) -> RigidObject:
        """Add a rigid object; see `add_robot` for what it raises."""
        uid = self._claim(cfg)
        obj = RigidObject(cfg, uid, self._simulation())
        self.rigid_objects[uid] = obj
        return obj

    def add_light(self, cfg: LightCfg) -> Light:
        """Add a light for pictures; see `add_robot` for what it raises."""
        uid = self._claim(cfg)
        light = self.lights[uid] = Light(cfg, uid, self._simulation())
        return light

    def add_sensor(self, cfg: SensorCfg | CameraCfg) -> BaseSensor:
        """Add a sensor to entities that are there already.

        Raises:
            NotImplementedError: If it is a camera.
            ConfigError: If an entity or a link does not exist, or a value is wrong.
            RuntimeError: If the scene is compiled already.
        """
        if isinstance(cfg, CameraCfg):
            raise no_camera(cfg)
        uid = self._claim(cfg)
        articulations = {**self.robots, **self.articulations}
        known: dict[str, ParsedArticulation | str | None] = {
            **{name: handle.parsed for name, handle in articulations.items()},
            **dict.fromkeys(self.rigid_objects, "rigid object"),
            **dict.fromkeys(self.lights, "light"),
        }
        plan, problems = plan_sensor(uid, cfg, known, ground=self.sim_config.ground_plane)
        if plan is None:
            raise ConfigError([Problem(f"{uid}.{p.path}", p.message, p.hint) for p in problems])
        sensor = self.sensors[uid] = _SENSORS[cfg.sensor_type](plan, self._simulation())
        return sensor

    def sensor_plans(self) -> dict[str, SensorPlan]:
        """What the compiler needs to know of the sensors, by uid."""
        return {uid: sensor.plan for uid, sensor in self.sensors.items()}

    def remove_asset(self, uid: str) -> bool:
        """Take back something that was added; returns whether it was there.

        Raises:
            RuntimeError: If the scene is compiled already.
        """
        if self.compiled:
            raise RuntimeError(
                "the scene is compiled already (by a step, a reset or a pose that was read): "
                "nothing can be removed; an object can be moved out of the way (set_local_pose)"
            )
        groups: tuple[dict[str, Any], ...] = (
            self.robots,
            self.articulations,
            self.rigid_objects,
            self.lights,
            self.sensors,
        )
        return any(group.pop(uid, None) is not None for group in groups)

    # -- finding -------------------------------------------------------------------------------

    def get_robot(self, uid: str | None = None) -> Robot | None:
        """A robot by uid (None if absent); without a uid, the only one."""
        if uid is None:
            return next(iter(self.robots.values())) if len(self.robots) == 1 else None
        return self.robots.get(uid)

    def get_articulation(self, uid: str) -> Articulation | None:
        """An articulation by uid, or None."""
        return self.articulations.get(uid)

    def get_rigid_object(self, uid: str) -> RigidObject | None:
        """A rigid object by uid, or None."""
        return self.rigid_objects.get(uid)

    def get_light(self, uid: str) -> Light | None:
        """A light by uid, or None."""
        return self.lights.get(uid)

    def get_sensor(self, uid: str) -> BaseSensor | None:
        """A sensor by uid, or None."""
        return self.sensors.get(uid)

    def get_asset(self, uid: str) -> Handle | None:
        """A robot, articulation or object by uid, or None."""
        return self.robots.get(uid) or self.articulations.get(uid) or self.rigid_objects.get(uid)

    def get_robot_uid_list(self) -> list[str]:
        """Uids of robots, in order of addition."""
        return list(self.robots)

    def get_articulation_uid_list(self) -> list[str]:
        """Uids of articulations, in order of addition."""
        return list(self.articulations)

    def get_rigid_object_uid_list(self) -> list[str]:
        """Uids of rigid objects, in order of addition."""
        return list(self.rigid_objects)

    def get_light_uid_list(self) -> list[str]:
        """Uids of lights, in order of addition."""
        return list(self.lights)

    def get_sensor_uid_list(self) -> list[str]:
        """Uids of sensors, in order of addition."""
        return list(self.sensors)

    @property
    def asset_uids(self) -> list[str]:
        """Everything that has a name, ``default_plane`` included."""
        plane = ["default_plane"] if self.sim_config.ground_plane else []
        entities = [*self.robots, *self.articulations, *self.rigid_objects, *self.lights]
        return [*plane, *entities, *self.sensors]

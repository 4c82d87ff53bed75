"""`SimulationManager`: N environments of one scene, and the engine that steps them.

Entities are added first; the scene is compiled once, at the first use of physics (`engine`), and
nothing can be added afterwards.
"""

from __future__ import annotations

import logging
import time
import weakref
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import torch

from embodichain.lab.sim.cfg import (
    ArticulationCfg,
    LightCfg,
    RigidObjectCfg,
    RobotCfg,
    SimulationManagerCfg,
    choose_engine,
)
from embodichain.lab.sim.compiler.compile_scene import CompiledScene
from embodichain.lab.sim.compiler.robot.drives.drive_changes import DriveChange
from embodichain.lab.sim.configs.config_types import check_config
from embodichain.lab.sim.configs.sensor_cfg import SENSORS, AnySensorCfg, SensorCfg
from embodichain.lab.sim.engine.engine_register import (
    ENGINES,
    EngineSetup,
    find_recorded,
    recorded_name,
)
from embodichain.lab.sim.engine.room import LEAST_BYTES
from embodichain.lab.sim.engine.warp.device_arrays import DeviceArrays
from embodichain.lab.sim.objects.articulation import Articulation
from embodichain.lab.sim.objects.light import Light
from embodichain.lab.sim.objects.rigid_object import RigidObject
from embodichain.lab.sim.objects.robot import Robot
from embodichain.lab.sim.scene import Entity, Scene
from embodichain.lab.sim.sensors.base_sensor import BaseSensor
from embodichain.utils.array_types import host_ids
from embodichain.utils.arrays import Arrays, as_env_ids
from embodichain.utils.errors import ConfigError, DeviceError, Problem
from embodichain.utils.plugins import with_missing_members
from embodichain.utils.short_repr import short_repr
from embodichain.utils.system.memory import require_memory_for
from embodichain.utils.uncopied import Uncopied

if TYPE_CHECKING:
    from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
    from embodichain.lab.sim.drawing.views import Pictures, View, Viewpoint
    from embodichain.lab.sim.engine.api import F64, Engine
    from embodichain.lab.sim.viewer import NativeViewer

__all__ = ["SimulationManager"]

_log = logging.getLogger(__name__)
_instances: dict[int, weakref.ref[SimulationManager]] = {}
"""The live simulations of this process, by `instance_id`."""
_Found = TypeVar("_Found")


def _finder(group: str, kind: type[_Found]) -> Callable[[SimulationManager, str], _Found | None]:
    def get(self: SimulationManager, uid: str) -> _Found | None:
        return getattr(self, group).get(uid)

    get.__doc__ = f"One of `{group}` by uid, or None."
    return get


def _lister(group: str) -> Callable[[SimulationManager], list[str]]:
    def uids(self: SimulationManager) -> list[str]:
        return list(getattr(self, group))

    uids.__doc__ = f"Uids of `{group}`, in order of addition."
    return uids


def _uid_of(cfg: Any) -> str:
    """The key path of an entity or a sensor in messages: its name, if it has one."""
    uid = getattr(cfg, "uid", None)
    return uid if isinstance(uid, str) else ""


def _start(name: str, setup: EngineSetup) -> Engine:
    """Start an engine; logs must be able to name it.

    Raises:
        ConfigError: If the engine has the name of another; or it cannot compute the scene.
    """
    kind = ENGINES[name]
    engine = kind.start(setup)
    if find_recorded(recorded_name(engine)) is not kind:
        engine.close()
        message = f"the engine {name!r} of {ENGINES.place(name)} is called {engine.name!r}"
        raise ConfigError([Problem("sim.engine", f"{message}; its `name` must be {name!r}")])
    return engine


@with_missing_members
class SimulationManager(Uncopied):
    """N environments of one scene.

    Args:
        cfg: Physics, device and number of environments.
        compiled_scene: The scene, if it was compiled before from the entities that are going to be
            added; None compiles them at the first use of physics. Several simulations may share it.
        checked: Whether the entities' configs were checked as a task file is; else values that
            change nothing are reported when the scene is compiled.
        types_checked: Whether the types of `cfg` were checked, as a part of an environment's.

    Attributes:
        num_envs, device: N, and the device of all tensors.
        arrays: Where arrays are: on the host, or on the device (``sim.warp.arrays``).
        instance_id: The simulation's number among those of this process.
        robots, articulations, rigid_objects, lights, sensors: Handles by uid; `articulations`
            contains no robots.
        inside: Those rigid objects that are bodies of the scene's file, by uid.
        known: What references may name: all entities and their parts, by uid.
        drive_changes: Values that events may draw for drives and links, by articulation uid.
        physics_steps_per_control: Physics steps of a control step, which contact sensors look back.
        physics_seconds: Wall time spent on physics steps in `update` so far.

    Raises:
        ConfigError: If a value of the config is wrong; lists all that are.
        DeviceError: If the device is unknown or has no engine here.
    """

    def __init__(
        self,
        cfg: SimulationManagerCfg | None = None,
        *,
        compiled_scene: CompiledScene | None = None,
        checked: bool = False,
        types_checked: bool = False,
    ) -> None:
        self.sim_config = cfg if cfg is not None else SimulationManagerCfg(headless=True)
        if not types_checked:
            check_config(self.sim_config, SimulationManagerCfg)
        self._engine_name, problems = choose_engine(
            self.sim_config.engine, self.sim_config.device_name
        )
        if problems:
            raise DeviceError(problems)
        on_device = self._engine_name == "warp" and self.sim_config.warp.arrays == "device"
        self.arrays = DeviceArrays(self.sim_config.device_name) if on_device else Arrays()
        self.device = self.arrays.device
        self.num_envs = int(self.sim_config.num_envs)
        require_memory_for(self.num_envs, LEAST_BYTES, "environments", "num_envs")
        self.instance_id = max(_instances, default=-1) + 1
        _instances[self.instance_id] = weakref.ref(self)
        self.drive_changes: Mapping[str, Sequence[DriveChange]] = {}
        self._scene = Scene(self.sim_config, compiled_scene, checked=checked)
        self.robots = self._scene.robots
        self.articulations = self._scene.articulations
        self.rigid_objects = self._scene.rigid_objects
        self.lights = self._scene.lights
        self.sensors = self._scene.sensors
        self.inside = self._scene.inside
        self.known = self._scene.known
        for uid, inside in self.inside.items():
            self.rigid_objects[uid] = RigidObject(inside, uid, self)
        self._destroyed = False
        self._engine: Engine | None = None
        self._initial_row: F64 = np.zeros(0)
        self._renderer: OffscreenRenderer | None = None
        self._viewer: NativeViewer | None = None
        self._physics_enabled = True
        self.physics_steps_per_control = 1
        self.physics_seconds = 0.0

    def __repr__(self) -> str:
        """Return N, the device, the time step, and the names of what is in the scene."""
        return short_repr(
            self,
            num_envs=self.num_envs,
            device=str(self.device),
            physics_dt=self.sim_config.physics_dt,
            robots=list(self.robots),
            articulations=list(self.articulations),
            rigid_objects=list(self.rigid_objects),
            lights=list(self.lights),
            sensors=list(self.sensors),
        )

    @property
    def arena_offsets(self) -> torch.Tensor:
        """(N, 3) positions of environments in viewers: a square grid of `arena_space` metres.

        Physics has no offsets: each environment is a separate world, and poses are relative to it.
        """
        side = int(np.ceil(np.sqrt(self.num_envs)))
        index = np.arange(self.num_envs)
        grid = np.stack([index % side, index // side, np.zeros_like(index)], axis=1)
        return torch.from_numpy((grid * self.sim_config.arena_space).astype(np.float32))

    # -- adding --------------------------------------------------------------------------------

    def add_robot(self, cfg: RobotCfg, *, checked: bool = False) -> Robot:
        """Add a robot; its file is read at once, so names and limits are known on return.

        Args:
            cfg: The robot.
            checked: Whether the types of its values were checked before.

        Raises:
            ConfigError: If the file or a value in the config is wrong.
            RuntimeError: If the scene is compiled already.
        """
        if not checked:
            check_config(cfg, RobotCfg, _uid_of(cfg))
        robot = Robot(cfg, self._scene.parse(cfg, self.drive_changes), self)
        self.robots[robot.uid] = robot
        return robot

    def add_articulation(self, cfg: ArticulationCfg, *, checked: bool = False) -> Articulation:
        """Add an articulation without control parts; see `add_robot`."""
        if not checked:
            check_config(cfg, ArticulationCfg, _uid_of(cfg))
        articulation = Articulation(cfg, self._scene.parse(cfg, self.drive_changes), self)
        self.articulations[articulation.uid] = articulation
        return articulation

    def add_rigid_object(self, cfg: RigidObjectCfg, *, checked: bool = False) -> RigidObject:
        """Add a rigid object; see `add_robot` for what it raises."""
        if not checked:
            check_config(cfg, RigidObjectCfg, _uid_of(cfg))
        obj = RigidObject(cfg, self._scene.claim(cfg), self)
        self.rigid_objects[obj.uid] = obj
        return obj

    def add_light(self, cfg: LightCfg, *, checked: bool = False) -> Light:
        """Add a light for rendering; see `add_robot` for what it raises."""
        if not checked:
            check_config(cfg, LightCfg, _uid_of(cfg))
        light = Light(cfg, self._scene.claim(cfg), self)
        self.lights[light.uid] = light
        return light

    def add_sensor(self, cfg: SensorCfg, *, checked: bool = False) -> BaseSensor:
        """Add a sensor to entities that were added before.

        Args:
            cfg: The sensor.
            checked: Whether the types of its values were checked before.

        Raises:
            ConfigError: If an entity or a link does not exist, or a value is wrong.
            RuntimeError: If the scene is compiled already.
        """
        if not checked:
            check_config(cfg, AnySensorCfg, _uid_of(cfg))
        plan = self._scene.plan_sensor(cfg)
        kind: type[BaseSensor] = SENSORS[plan.cfg.sensor_type]
        sensor = self.sensors[plan.uid] = kind(plan, self)
        return sensor

    def remove_asset(self, uid: str) -> bool:
        """Remove an entity or a sensor; returns whether it existed.

        Raises:
            RuntimeError: If the scene is compiled already.
        """
        return self._scene.remove(uid)

    # -- finding -------------------------------------------------------------------------------

    def get_robot(self, uid: str | None = None) -> Robot | None:
        """A robot by uid, or None; without a uid, the only robot of the scene."""
        if uid is None:
            return next(iter(self.robots.values())) if len(self.robots) == 1 else None
        return self.robots.get(uid)

    get_articulation = _finder("articulations", Articulation)
    get_rigid_object = _finder("rigid_objects", RigidObject)
    get_light = _finder("lights", Light)
    get_sensor = _finder("sensors", BaseSensor)

    def get_asset(self, uid: str) -> Entity | None:
        """A robot, articulation or rigid object by uid, or None."""
        return self._scene.entity(uid)

    get_robot_uid_list = _lister("robots")
    get_articulation_uid_list = _lister("articulations")
    get_rigid_object_uid_list = _lister("rigid_objects")
    get_light_uid_list = _lister("lights")
    get_sensor_uid_list = _lister("sensors")

    @property
    def asset_uids(self) -> list[str]:
        """Uids of everything in the scene, ``default_plane`` included."""
        return self._scene.uids

    @property
    def has_non_static_rigid_object(self) -> bool:
        """Whether any rigid object can move."""
        return any(obj.cfg.body_type != "static" for obj in self.rigid_objects.values())

    # -- compiling -----------------------------------------------------------------------------

    @property
    def compiled(self) -> bool:
        """Whether the scene is compiled."""
        return self._scene.compiled is not None

    @property
    def scene(self) -> CompiledScene:
        """The compiled scene; compiles it at first use."""
        self.compile()
        return self._scene.compile()

    @property
    def engine(self) -> Engine:
        """The engine; compiles the scene at first use."""
        if self._engine is None:
            self.compile()
        if self._engine is None:
            raise RuntimeError("the simulation was destroyed")
        return self._engine

    @property
    def initial_row(self) -> F64:
        """(nstate,) state after a reset and before reset events (a copy)."""
        self.compile()
        return self._initial_row.copy()

    def compile(self) -> None:
        """Compile the scene and start its engine; does nothing if that is done already."""
        if self._destroyed:
            raise RuntimeError("the simulation was destroyed")
        if self._engine is not None:
            return
        cfg = self.sim_config
        scene = self._scene.compile()
        setup = EngineSetup(
            model=scene.model,
            num_envs=self.num_envs,
            device=cfg.device_name,
            num_threads=cfg.num_threads,
            persistent=cfg.persistent,
            arrays_on_device=self.arrays.on_device,
            nconmax=cfg.warp.nconmax,
            njmax=cfg.warp.njmax,
        )
        self._engine = _start(self._engine_name, setup)
        self._initial_row = scene.initial_row
        self._engine.write("row", self._initial_row)
        self._scene.bind(self._engine)

    # -- running -------------------------------------------------------------------------------

    def update(self, physics_dt: float | None = None, step: int = 10) -> None:
        """Advance physics by ``step`` steps, unless it is switched off (`enable_physics`).

        Args:
            physics_dt: None, or the configured timestep in seconds.
            step: Physics steps.

        Raises:
            ValueError: If ``physics_dt`` is not the compiled timestep or ``step`` is negative.
        """
        compiled = self.sim_config.physics_dt
        if physics_dt is not None and abs(physics_dt - compiled) > 1e-12:
            raise ValueError(
                f"physics_dt is compiled into the scene: {compiled} s, got {physics_dt} s"
            )
        if step < 0:
            raise ValueError(f"step must not be negative, got {step}")
        if step and self._physics_enabled:
            begun = time.perf_counter()
            self.engine.step(step)
            self.physics_seconds += time.perf_counter() - begun
        if self._viewer is not None:
            self._viewer.sync()

    def reset_objects_state(
        self,
        env_ids: Any = None,
        excluded_uids: Collection[str] = (),
        only: Collection[str] | None = None,
    ) -> None:
        """Reset entities to their configured poses, joint positions and targets, at zero velocity.

        Args:
            env_ids: The environments; None is all.
            excluded_uids: Entities that do not change.
            only: If given, only these entities change, and `mj_resetData` is not called.
        """
        ids = as_env_ids(env_ids, self.num_envs)
        if ids is not None and not len(ids):
            return
        engine = self.engine
        uids = self.scene.entities if only is None else only
        chosen = [self.get_asset(uid) for uid in uids if uid not in excluded_uids]
        if only is None and not excluded_uids:
            engine.reset(ids, self._initial_row)
        else:
            for handle in chosen:
                if handle is not None:
                    columns = handle.row_columns
                    engine.write("row", self._initial_row[columns], ids, columns)
        for handle in chosen:
            if isinstance(handle, Articulation):
                handle.forget_targets(ids)
        if only is None:
            for sensor in self.sensors.values():
                sensor.reset(ids)

    # -- rendering -----------------------------------------------------------------------------

    @property
    def renderer(self) -> OffscreenRenderer:
        """The off-screen renderer, opened at first use; RenderError if none works here."""
        from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer

        if self._renderer is None:
            self._renderer = OffscreenRenderer(self.scene.model)
        return self._renderer

    def draw(self, views: Sequence[View], env_ids: Any = None) -> list[Pictures]:
        """Draw every view of environments (None: all) off screen, in one call.

        Raises:
            RenderError: If an output cannot be drawn here; names the packages to install.
            ValueError: If there is no such environment.
        """
        ids = as_env_ids(env_ids, self.num_envs)
        envs = None if ids is None else host_ids(ids)
        return self.renderer.draw(self.engine, views, envs)

    def render(
        self,
        env_id: int | None = 0,
        camera: str | int | Viewpoint = "default",
        width: int = 640,
        height: int = 480,
    ) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """Render one environment in full look, (height, width, 3) RGB; None: (N, ...) all of them.

        Raises:
            RenderError: If no OpenGL library works here; names the packages to install.
            ValueError: If there is no such camera or environment.
        """
        if env_id is not None and not 0 <= env_id < self.num_envs:
            raise ValueError(f"env_id must be in [0, {self.num_envs}), got {env_id}")
        ids = None if env_id is None else np.array([env_id])
        pictures = self.renderer.pictures(self.engine, camera, (width, height), ids)
        return pictures if env_id is None else pictures[0]

    def open_window(self, env_id: int = 0) -> None:
        """Open MuJoCo's viewer on one environment; `update` refreshes it.

        Raises:
            RenderError: If there is no display.
        """
        from embodichain.lab.sim.viewer import NativeViewer

        self._viewer = self._viewer or NativeViewer(self.engine, env_id)

    def close_window(self) -> None:
        """Close the viewer if it is open."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    @property
    def window(self) -> NativeViewer | None:
        """The viewer, if one was opened."""
        return self._viewer

    @property
    def is_window_open(self) -> bool:
        """Whether a viewer is open (the user may have closed it)."""
        return self._viewer is not None and self._viewer.is_running

    # -- whole simulations -----------------------------------------------------------------------

    def state_dict(self) -> dict[str, Any]:
        """Everything needed to continue bit for bit (copies)."""
        return {
            "engine": self.engine.state_dict(),
            "drives": {uid: h.drives.state_dict() for uid, h in self._scene.jointed.items()},
            "objects": {uid: o.state_dict() for uid, o in self.rigid_objects.items()},
            "lights": {uid: light.state_dict() for uid, light in self.lights.items()},
            "sensors": {uid: sensor.state_dict() for uid, sensor in self.sensors.items()},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue exactly where `state_dict` was taken."""
        self.engine.load_state_dict(state["engine"])
        handles = self._scene.jointed
        for uid, drives in state["drives"].items():
            handles[uid].drives.load_state_dict(drives)
        for uid, properties in state["objects"].items():
            self.rigid_objects[uid].load_state_dict(properties)
        for uid, light in state.get("lights", {}).items():  # states of older releases have none
            self.lights[uid].load_state_dict(light)
        for uid, sensor in self.sensors.items():
            sensor.load_state_dict(state.get("sensors", {}).get(uid, {}))

    def enable_physics(self, enable: bool = True) -> None:
        """Switch physics on or off; while it is off, `update` takes no steps.

        Meanwhile poses, joints and targets can still be set and read back.
        """
        self._physics_enabled = enable

    def destroy(self, exit_process: bool = False) -> None:
        """Free the engine, the renderer and the viewer; never ends the process."""
        self.close_window()
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        # Free large arrays now, before Python collects the cycle of handles and environment.
        self._scene.destroy()
        if self._engine is not None:
            self._engine.close()
        self._engine = None
        self._destroyed = True
        _instances.pop(self.instance_id, None)

    # -- simulations of this process, as EmbodiChain -----------------------------------------------

    @classmethod
    def get_instance(cls, instance_id: int = 0) -> SimulationManager:
        """Return a live simulation by its `instance_id`.

        Raises:
            ValueError: If it does not exist; lists the live ones.
        """
        alive = {i: sim for i, ref in _instances.items() if (sim := ref()) is not None}
        if instance_id not in alive:
            raise ValueError(f"no simulation {instance_id}; living ones: {list(alive)}")
        return alive[instance_id]

    @staticmethod
    def get_instance_num() -> int:
        """Number of live simulations in this process."""
        return sum(ref() is not None for ref in _instances.values())

    @staticmethod
    def is_instantiated(instance_id: int = 0) -> bool:
        """Whether the simulation with this `instance_id` is live."""
        return _instances.get(instance_id, lambda: None)() is not None

    @classmethod
    def reset(cls, instance_id: int = 0) -> None:
        """Destroy a simulation if it is live; to reset states, use `reset_objects_state`."""
        if cls.is_instantiated(instance_id):
            cls.get_instance(instance_id).destroy()

    @property
    def is_use_gpu_physics(self) -> bool:
        """Whether physics runs on a GPU."""
        return str(self.sim_config.sim_device).startswith("cuda")

    @property
    def is_physics_manually_update(self) -> bool:
        """True: physics advances in `update` only."""
        return True

    def set_manual_update(self, enable: bool) -> None:
        """No effect: physics advances in `update` only. False logs a warning."""
        if not enable:
            _log.warning("set_manual_update(False): no effect, physics advances in update() only")

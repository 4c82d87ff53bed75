"""`SimulationManager`: owns what was declared, the compiled scene and its engine.

Entities are added first; the scene is compiled once, at the first use of physics (`engine`), and
nothing can be added afterwards. What steps the batch is `engine`, what a joint is `objects`.
"""

from __future__ import annotations

import time
import weakref
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from embodichain.lab.sim.cfg import SimulationManagerCfg
from embodichain.lab.sim.compiler import CompiledScene, compile_scene
from embodichain.lab.sim.declaration import Declaration
from embodichain.lab.sim.device import check_device
from embodichain.lab.sim.engine.cpu import CpuEngine
from embodichain.lab.sim.initial_state import entity_columns, initial_row
from embodichain.lab.sim.objects._arrays import as_env_ids
from embodichain.lab.sim.objects.articulation import Articulation
from embodichain.lab.sim.upstream_members import UpstreamMembers, instances

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.base import F64, EnvIndex
    from embodichain.lab.sim.rendering import SceneRenderer, View
    from embodichain.lab.sim.viewer import NativeViewer

__all__ = ["SimulationManager"]


class SimulationManager(UpstreamMembers, Declaration):
    """N environments of one scene.

    Args:
        cfg: How the simulation runs.

    Raises:
        DeviceError: If the device is unknown or has no engine here.
    """

    def __init__(self, cfg: SimulationManagerCfg | None = None) -> None:
        self.sim_config = cfg if cfg is not None else SimulationManagerCfg(headless=True)
        self.device = check_device(self.sim_config.sim_device)
        self.num_envs = int(self.sim_config.num_envs)
        super().__init__()
        self._scene: CompiledScene | None = None
        self._destroyed = False
        self._engine: CpuEngine | None = None
        self._initial_row: F64 = np.zeros(0)
        self._renderer: SceneRenderer | None = None
        self._viewer: NativeViewer | None = None
        self._physics_enabled = True
        self.physics_seconds = 0.0
        """Wall time that physics steps took so far, in `update`."""
        self.instance_id = max(instances, default=-1) + 1
        instances[self.instance_id] = weakref.ref(self)

    @property
    def arena_offsets(self) -> torch.Tensor:
        """(N, 3) where viewers lay environments out: a square grid of `arena_space` metres.

        Physics knows no offsets: every environment is its own world, and every pose is in it.
        """
        side = int(np.ceil(np.sqrt(self.num_envs)))
        index = np.arange(self.num_envs)
        grid = np.stack([index % side, index // side, np.zeros_like(index)], axis=1)
        return torch.from_numpy((grid * self.sim_config.arena_space).astype(np.float32))

    def _simulation(self) -> SimulationManager:
        return self

    # -- compiling -----------------------------------------------------------------------------

    @property
    def compiled(self) -> bool:
        """Whether the scene is compiled."""
        return self._scene is not None

    @property
    def scene(self) -> CompiledScene:
        """The compiled scene; compiles it at first use."""
        self.compile()
        if self._scene is None:
            raise RuntimeError("the simulation was destroyed")
        return self._scene

    @property
    def engine(self) -> CpuEngine:
        """The engine; compiles the scene at first use."""
        if self._engine is None:
            self.compile()
        if self._engine is None:
            raise RuntimeError("the simulation was destroyed")
        return self._engine

    @property
    def initial_row(self) -> F64:
        """(nstate,) the state that a reset gives every environment, before events (a copy)."""
        self.compile()
        return self._initial_row.copy()

    def compile(self) -> None:
        """Compile the declared scene and start its engine; does nothing the second time."""
        if self._scene is not None:
            return
        if self._destroyed:
            raise RuntimeError("the simulation was destroyed")
        cfg = self.sim_config
        articulations: list[Articulation] = [*self.robots.values(), *self.articulations.values()]
        self._scene = compile_scene(
            cfg,
            [a.parsed for a in articulations],
            {uid: o.cfg for uid, o in self.rigid_objects.items()},
            {uid: light.cfg for uid, light in self.lights.items()},
            self.sensor_plans(),
        )
        self._engine = CpuEngine(self._scene.model, self.num_envs, cfg.num_threads, cfg.persistent)
        self._initial_row = initial_row(
            self._engine, self._scene, [a.parsed for a in articulations]
        )
        self._engine.write("row", self._initial_row)
        for handle in (*articulations, *self.rigid_objects.values()):
            handle.bind(self._engine, self._scene.entities[handle.uid])
        for sensor in self.sensors.values():
            sensor.bind(self._engine, self._scene.sensors[sensor.uid])

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
        """Put entities back to their configured state: poses, joints, targets, no velocity.

        Args:
            env_ids: The environments; None is all.
            excluded_uids: Entities that stay as they are.
            only: If given, no other entity changes (and MuJoCo's own reset is left out).
        """
        ids = as_env_ids(env_ids, self.num_envs)
        if ids is not None and not len(ids):
            return
        engine = self.engine
        uids = self.scene.entities if only is None else only
        chosen = [u for u in uids if u not in set(excluded_uids)]
        if only is None and not excluded_uids:
            engine.reset(ids)
            engine.write("row", self._initial_row, ids)
        else:
            self._reset_some(ids, chosen)
        for uid in chosen:
            handle = self.get_asset(uid)
            if isinstance(handle, Articulation):
                handle.drives.clear(ids)
                handle.set_efforts.forget(ids)

    def _reset_some(self, ids: EnvIndex | None, uids: Collection[str]) -> None:
        engine = self.engine
        for uid in uids:
            columns = entity_columns(engine, self.scene.entities[uid])
            engine.write("row", self._initial_row[columns], ids, columns)

    # -- pictures ------------------------------------------------------------------------------

    def render(
        self,
        env_id: int = 0,
        camera: str | int | View = "default",
        width: int = 640,
        height: int = 480,
    ) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """Draw one environment off screen, (height, width, 3) RGB.

        Raises:
            RenderError: If no OpenGL library works here; names the package.
            ValueError: If there is no such camera or environment.
        """
        from embodichain.lab.sim.rendering import SceneRenderer

        if not 0 <= env_id < self.num_envs:
            raise ValueError(f"env_id must be in [0, {self.num_envs}), got {env_id}")
        if self._renderer is None or self._renderer.size != (width, height):
            if self._renderer is not None:
                self._renderer.close()
            self._renderer = SceneRenderer(self.scene.model, width, height)
        return self._renderer.draw(self.engine, env_id, camera)

    def open_window(self, env_id: int = 0) -> None:
        """Open MuJoCo's viewer on one environment; `update` keeps it current.

        Raises:
            RenderError: If there is no display.
        """
        from embodichain.lab.sim.viewer import NativeViewer

        if self._viewer is None:
            self._viewer = NativeViewer(self.engine, env_id)

    def close_window(self) -> None:
        """Close the viewer if it is open."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    @property
    def is_window_open(self) -> bool:
        """Whether a viewer is open (the user may have closed it)."""
        return self._viewer is not None and self._viewer.is_running

    # -- whole simulations -----------------------------------------------------------------------

    def state_dict(self) -> dict[str, Any]:
        """Everything physics needs to continue to the bit (copies)."""
        handles: Mapping[str, Articulation] = {**self.robots, **self.articulations}
        return {
            "engine": self.engine.state_dict(),
            "drives": {uid: h.drives.state_dict() for uid, h in handles.items()},
            "objects": {uid: o.state_dict() for uid, o in self.rigid_objects.items()},
            "lights": {uid: light.state_dict() for uid, light in self.lights.items()},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue exactly where `state_dict` was taken."""
        self.engine.load_state_dict(state["engine"])
        handles: Mapping[str, Articulation] = {**self.robots, **self.articulations}
        for uid, drives in state["drives"].items():
            handles[uid].drives.load_state_dict(drives)
        for uid, properties in state["objects"].items():
            self.rigid_objects[uid].load_state_dict(properties)
        for uid, light in state.get("lights", {}).items():  # states of older releases have none
            self.lights[uid].load_state_dict(light)

    def init_gpu_physics(self) -> None:
        """Do nothing: there is no GPU engine yet, and the CPU's needs no start."""

    def enable_physics(self, enable: bool = True) -> None:
        """Switch physics on or off; while it is off, `update` takes no steps.

        Poses, joints and targets can be set meanwhile, and are read where they were put.
        """
        self._physics_enabled = enable

    def destroy(self, exit_process: bool = False) -> None:
        """Free the engine, the renderer and the viewer; returns, and never ends the process."""
        self.close_window()
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        for handle in (
            *self.robots.values(),
            *self.articulations.values(),
            *self.rigid_objects.values(),
        ):
            handle.destroy()
        for sensor in self.sensors.values():
            sensor.destroy()
        # What is large goes now, not when Python collects the cycle of handles and environment.
        self._engine = self._scene = None
        self._destroyed = True
        instances.pop(self.instance_id, None)

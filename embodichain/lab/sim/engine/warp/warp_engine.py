"""`WarpEngine`: `Engine` on MuJoCo Warp. Methods are documented in `api`.

Importing this module imports Warp (extra ``gpu``).
"""

from __future__ import annotations

from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import (
    ALL,
    F64,
    Columns,
    EnvIndex,
    PhysicsEvent,
    RayHits,
    Write,
)
from embodichain.lab.sim.engine.cpu.cpu_engine import KINEMATIC_STAGES, HostEngine, PhysicsOutput
from embodichain.lab.sim.engine.warp.warp_support import unsupported
from embodichain.lab.sim.engine.warp.warp_worlds import WarpWorlds
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

__all__ = [
    "COLLISION_BITS",
    "CONSTRAINT_FORCES",
    "LARGEST",
    "ROW_BITS",
    "WarpEngine",
    "require_memory",
]

_MOVED = ("qpos", "qvel", "act", "history", "plastic", "qacc_warmstart")
"""State components that physics writes, besides the time."""
LARGEST = 1e10
"""`mjMAXVAL`: larger positions and velocities count as divergence, as in MuJoCo."""
CONSTRAINT_FORCES = frozenset({"cacc", "cfrc_int", "cfrc_ext"})
_OVERFLOW = mjw.OverflowType
ROW_BITS = int(_OVERFLOW.NEFC | _OVERFLOW.NJMAX_NNZ)
_CONTACTS = int(_OVERFLOW.BROADPHASE | _OVERFLOW.NARROWPHASE | _OVERFLOW.CCD)
_SENSORS = int(_OVERFLOW.CONTACT_MATCH | _OVERFLOW.TACTILE)
COLLISION_BITS = int(_OVERFLOW.HFIELD | _OVERFLOW.EPA_HORIZON)
"""Two geoms of one world whose collision was not found: its result is wrong."""


class WarpEngine(HostEngine):
    """N simulations of one model on a device of Warp.

    States, model fields and writes are those of `HostEngine`: float64 arrays on the host, copied to
    the device before and from it after physics. Each call begins from the rows, so that the device
    has no state of its own.

    Physics is float32, and adds up in an order that may differ between runs on a GPU. The time is
    added up on the host, in float64.

    Args:
        model: The compiled scene; the batch and the device copy it.
        num_envs: N.
        num_threads: Threads on the host, which compute derived constants; 0 is every core.
        device: ``cpu``, ``cuda`` or ``cuda:N``.
        nconmax: Contacts for each environment, from a memory shared by all; None is Warp's
            estimate.
        njmax: Rows of constraints for each environment; None is Warp's estimate.

    Attributes:
        worlds: The device's copy.

    Raises:
        ConfigError: If MuJoCo Warp lacks something that the model has; lists all of it.
    """

    name = f"mujoco_warp {mjw.__version__}"

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        num_threads: int = 0,
        device: str = "cpu",
        nconmax: int | None = None,
        njmax: int | None = None,
    ) -> None:
        problems = unsupported(model)
        if problems:
            raise ConfigError(problems)
        super().__init__(model, num_envs, num_threads, False)
        self.worlds = WarpWorlds(model, num_envs, device, nconmax, njmax)
        self._diverged = _Diverged(num_envs)
        self._divergence = self._diverged
        self._only_kinematics = True
        self._model_changed = False

    # -- reads -------------------------------------------------------------------------------------

    def derived(self, name: str) -> F64:
        if name not in self._derived:
            self._derived[name] = self._empty(name)
            self._only_kinematics &= name in KINEMATIC_STAGES and name != "sensordata"
            self._mark_all_dirty()
        if self._any_dirty:
            self._refresh()
        return self._derived[name]

    def _empty(self, name: str) -> F64:
        """An array for a field of all environments, shaped as the batch's."""
        out: F64 = np.zeros(self._batch.bind(name).shape)
        if self.worlds.width(name) != out[0].size:
            fields = [field for field in mujoco.batch.DATA_FIELDS if self.worlds.width(field)]
            raise ValueError(
                f"MuJoCo Warp has no field {name!r}; there are {', '.join(sorted(fields))}."
                f"{did_you_mean(name, fields)}"
            )
        return out

    def _refresh(self) -> None:
        self._upload()
        if self._only_kinematics:
            self.worlds.kinematics()
        else:
            self.worlds.position_and_velocity()
        for name, out in self._derived.items():
            self.worlds.read(name, out)
        self._mark_all_clean()

    def acceleration(self, name: str) -> F64:
        output = self._accelerations.get(name)
        if output is None:
            live = self._empty(name)
            if name in CONSTRAINT_FORCES:
                self.worlds.want_constraint_forces()
            self._upload()
            self.worlds.forward()
            self._check_memory(None)
            self.worlds.read(name, live)
            # The reads of `derived` are out of date.
            self._mark_all_dirty()
            output = PhysicsOutput(live, live.copy())
            self._accelerations[name] = output
        return output.copy

    def _read_accelerations(self, env_ids: EnvIndex | None) -> None:
        for name, output in self._accelerations.items():
            self.worlds.read(name, output.live)
        self._copy_accelerations(env_ids)

    def cast_rays(
        self,
        origins: F64,
        directions: F64,
        geoms: NDArray[np.bool_],
        env_ids: EnvIndex | None = None,
        *,
        normal: bool = False,
    ) -> RayHits:
        self.derived("geom_xpos")  # the kinematics of the current state
        count = self.num_envs if env_ids is None else len(env_ids)
        envs: Any = ALL if env_ids is None else env_ids
        rays = np.broadcast_shapes(np.shape(origins), np.shape(directions), (1, 1, 3))[1]
        # The device casts rays in all worlds: those of the others are not read.
        shape = (self.num_envs, rays, 3)
        all_origins = np.zeros(shape, np.float32)
        all_directions = np.ones(shape, np.float32)
        all_origins[envs] = np.broadcast_to(origins, (count, rays, 3))
        all_directions[envs] = np.broadcast_to(directions, (count, rays, 3))
        distance, geom, normals = self.worlds.rays(all_origins, all_directions, geoms)
        return RayHits(
            distance[envs].astype(np.float64),
            geom[envs],
            normals[envs].astype(np.float64) if normal else None,
        )

    # -- physics -----------------------------------------------------------------------------------

    def step(self, nstep: int, env_ids: EnvIndex | None = None) -> None:
        if self._fields.stale:
            self._set_const_now()
        for listener in self.listeners:
            listener.on_physics(PhysicsEvent("before", nstep, env_ids, self._rows))
        self._upload()
        readings: list[F64] = []
        if self._history:
            shape = (self.num_envs, self.model.nsensordata)

            def keep_reading() -> None:
                sensordata = np.zeros(shape)
                self.worlds.read("sensordata", sensordata)
                readings.append(sensordata)

            self.worlds.step(nstep, keep_reading)
        else:
            self.worlds.step(nstep)
        # All of them stepped: those of others are not read back.
        if readings:
            steps = np.stack(readings, axis=1)
            self._history.append(steps if env_ids is None else steps[env_ids], env_ids)
        self._read_rows(nstep, ALL if env_ids is None else env_ids)
        self._check_memory(env_ids)
        self._mark(env_ids)
        self._read_accelerations(env_ids)
        for listener in self.listeners:
            listener.on_physics(PhysicsEvent("after", nstep, env_ids, self._rows))

    def _read_rows(self, nstep: int, rows: Any) -> None:
        for name in _MOVED:
            view = self._views.get(name)
            if view is not None and view.shape[1]:
                view[rows] = self.worlds.download(name)[rows]
        timestep = self.model_values("opt.timestep").reshape(-1, 1)
        if len(timestep) > 1:
            timestep = timestep[rows]
        for _ in range(nstep):  # as MuJoCo adds it up
            self._views["time"][rows] += timestep

    def _check_memory(self, env_ids: EnvIndex | None) -> None:
        """Mark environments that diverged.

        Raises:
            ConfigError: If the memory for contacts, constraints or sensors was not enough.
        """
        overflow = self.worlds.counts().overflow
        diverged: NDArray[np.bool_] = np.zeros(self.num_envs, np.bool_)
        for name in ("qpos", "qvel"):
            diverged |= ~(np.abs(self._views[name]) < LARGEST).all(axis=1)
        if overflow.any():
            # A state that is not finite any more may need any amount of rows.
            require_memory(np.where(diverged, overflow & ~ROW_BITS, overflow), self.worlds)
            diverged |= (overflow & COLLISION_BITS) != 0
        if env_ids is not None:
            diverged[np.setdiff1d(np.arange(self.num_envs), env_ids)] = False
        if diverged.any():
            self._diverged.add(diverged)

    def forward(self, env_ids: EnvIndex | None = None) -> None:
        self._history.begin(env_ids)
        self._upload()
        self.worlds.forward()
        self._check_memory(env_ids)
        self._read_accelerations(env_ids)
        for name, out in self._derived.items():
            self.worlds.read(name, out)
        self._mark_all_clean()
        self.version += 1
        self._notify(Write("forward", "", env_ids, ALL, None))

    # -- writes ------------------------------------------------------------------------------------

    def write_model(
        self, field: str, values: Any, env_ids: EnvIndex | None = None, columns: Columns = ALL
    ) -> None:
        self._model_changed = True
        super().write_model(field, values, env_ids, columns)

    def set_const(self, env_ids: EnvIndex | None = None) -> None:
        self._model_changed = True
        super().set_const(env_ids)

    def _upload(self) -> None:
        """Copy the states to the device, and the model fields that differ if they changed."""
        if self._fields.stale:
            self._set_const_now()
        if self._model_changed:
            self._model_changed = False
            self._put_fields()
        self.worlds.upload(self._rows)

    def _put_fields(self) -> None:
        """Copy the model fields that differ, and poses of geoms that depend on them."""
        if self.worlds.put_fields(self._fields.expanded()):
            position = self._batch.bind("geom_xpos")
            matrix = self._batch.bind("geom_xmat")
            self._call(self._batch.forward, None, stage=int(mujoco.mjtStage.mjSTAGE_POS))
            self.worlds.put_poses_of_geoms(position, matrix)


_USES = {"njmax": "rows of constraints", "nconmax": "contacts and pairs of geoms near each other"}


def require_memory(overflow: NDArray[np.int32], worlds: WarpWorlds) -> None:
    """Check that no memory was too small.

    Args:
        overflow: (N,) bits of `mujoco_warp.OverflowType`.
        worlds: The device's copy.

    Raises:
        ConfigError: If the memory for contacts, constraints or sensors was not enough.
    """
    _require((overflow & ROW_BITS) != 0, "njmax", worlds.njmax)
    _require((overflow & _CONTACTS) != 0, "nconmax", worlds.nconmax)
    if (overflow & _SENSORS).any():
        message = "contact sensors match more contacts than MuJoCo Warp keeps, 64"
        raise ConfigError([Problem("sim.engine", f"{message}: use sim.engine=mujoco")])


def _require(full: NDArray[np.bool_], key: str, limit: int) -> None:
    """Raise ConfigError if the memory of a key was not enough for environments (N,)."""
    if full.any():
        ids = np.flatnonzero(full)
        listed = ", ".join(map(str, ids[:8].tolist())) + (", ..." if len(ids) > 8 else "")
        message = (
            f"{limit} {_USES[key]} for each environment are too few (environments {listed}): "
            f"set sim.warp.{key}={2 * limit}"
        )
        raise ConfigError([Problem(f"sim.warp.{key}", message)])


class _Diverged:
    """Which environments diverged: their state is not finite, or a collision was not found.

    Args:
        num_envs: N.
    """

    def __init__(self, num_envs: int) -> None:
        self._mask: NDArray[np.bool_] = np.zeros(num_envs, np.bool_)

    def add(self, mask: NDArray[np.bool_]) -> None:
        """Mark environments (N,)."""
        self._mask |= mask

    def begin(self) -> None:
        """Clear all marks."""
        self._mask[:] = False

    def add_failed(self, env_ids: EnvIndex) -> None:
        """Mark environments in which MuJoCo raised on the host."""
        self._mask[env_ids] = True

    def forget(self, env_ids: Any) -> None:
        """Clear the marks of environments that were reset (indices or a slice)."""
        self._mask[env_ids] = False

    def take(self) -> NDArray[np.bool_] | None:
        """(N,) mask of environments that diverged since the last call, or None."""
        if not self._mask.any():
            return None
        diverged = self._mask.copy()
        self._mask[:] = False
        return diverged

"""`DeviceEngine`: `Engine` on MuJoCo Warp whose arrays are on its device. Methods are as in `api`.

Importing this module imports Warp (extra ``gpu``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import ALL, F64, Columns, PhysicsEvent, RayHits, Write
from embodichain.lab.sim.engine.cpu.cpu_engine import KINEMATIC_STAGES, entries
from embodichain.lab.sim.engine.device.device_array import (
    DeviceArray,
    EnvMask,
    HostTransferError,
    on_device,
)
from embodichain.lab.sim.engine.fields import DERIVED_FIELDS
from embodichain.lab.sim.engine.sensor_history import SensorHistory
from embodichain.lab.sim.engine.warp.device_fields import DeviceFields
from embodichain.lab.sim.engine.warp.torch_stream import torch_stream
from embodichain.lab.sim.engine.warp.warp_engine import (
    COLLISION_BITS,
    CONSTRAINT_FORCES,
    LARGEST,
    ROW_BITS,
    WarpEngine,
    require_memory,
)
from embodichain.utils.arrays import tensor_of

if TYPE_CHECKING:
    from embodichain.lab.sim.drawing.views import Look, Optics, Output
    from embodichain.lab.sim.engine.warp.device_cameras import DeviceCameras, DevicePictures

__all__ = ["DeviceEngine"]


@wp.kernel  # type: ignore[untyped-decorator]
def _check(
    qpos: wp.array2d[wp.float32],
    qvel: wp.array2d[wp.float32],
    overflow: wp.array[int],
    wild: wp.array[wp.bool],
    seen: wp.array[int],
    largest: wp.float32,
    collision_bits: int,
    row_bits: int,
) -> None:
    i = wp.tid()
    bad = (overflow[i] & collision_bits) != 0
    for j in range(qpos.shape[1]):
        if not (wp.abs(qpos[i, j]) < largest):
            bad = bool(True)  # noqa: UP018  (a variable of Warp)
    for j in range(qvel.shape[1]):
        if not (wp.abs(qvel[i, j]) < largest):
            bad = bool(True)  # noqa: UP018  (a variable of Warp)
    bits = overflow[i]
    if bad:
        wild[i] = True
        bits = bits & ~row_bits  # a state that is not finite any more may need any amount of rows
    seen[i] = seen[i] | bits


_NO_ROWS = np.empty((0, 0))
"""Rows that listeners get: they read components of the state instead."""
_OF_ACTUATORS = frozenset({"qfrc_actuator", "actuator_force"})
_OF_CENTRES = frozenset({"subtree_com", "cdof"})
_OF_VELOCITIES = frozenset({"cvel", "cdof_dot"})


@dataclass(frozen=True, eq=False)
class _DeviceOutput:
    """A field that physics writes: see `PhysicsOutput`."""

    live: DeviceArray
    copy: DeviceArray


class DeviceEngine(WarpEngine):
    """N simulations of one model; states and fields are `DeviceArray`, views of Warp's memory.

    Nothing is copied from or to the host in a step, and nothing waits for the device. Environments
    are None (all) or an `EnvMask`. Model fields that were written are on the device (`fields`); the
    batch on the host gets copies where something asks for them. `forward` computes a field when it
    is next read.

    An overflow of memory for contacts or constraints is reported by the next steps, as soon as the
    device has computed it.

    Attributes:
        fields: The model fields.

    Args:
        model: The compiled scene.
        num_envs: N.
        num_threads: Threads on the host, which compute derived constants; 0 is every core.
        device: ``cpu``, ``cuda`` or ``cuda:N``.
        nconmax: Contacts for each environment; None is Warp's estimate.
        njmax: Rows of constraints for each environment; None is Warp's estimate.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        num_threads: int = 0,
        device: str = "cpu",
        nconmax: int | None = None,
        njmax: int | None = None,
    ) -> None:
        super().__init__(model, num_envs, num_threads, device, nconmax, njmax)
        self.device = torch.device(device)
        self.worlds.upload(self._rows)
        self._time = torch.zeros((num_envs, 1), dtype=torch.float64, device=self.device)
        self._states = {
            name: DeviceArray(self._view_of_state(name, columns.stop - columns.start))
            for name, columns in self._layout.items()
        }
        # Fields that `forward` has to compute when they are read, and for which environments: a
        # mask of each, at one address, so that a captured step can read that of the step before.
        self._late: set[str] = set()
        self._late_masks: dict[str, DeviceArray] = {}
        self._outputs: dict[str, _DeviceOutput] = {}
        self._wild = torch.zeros(num_envs, dtype=torch.bool, device=self.device)
        self._overflow = torch.zeros(num_envs, dtype=torch.int32, device=self.device)
        # Written by the device and read by the host without waiting.
        pinned = self.device.type == "cuda"
        self._seen = torch.zeros(num_envs, dtype=torch.int32, pin_memory=pinned)
        self._derived_views: dict[str, DeviceArray] = {}
        self._views_made = 0
        self._history = SensorHistory(num_envs, lambda array: on_device(array, self.device))
        self.fields = DeviceFields(self.worlds, self._fields, model, num_envs, self.device)

    def _view_of_state(self, name: str, width: int) -> torch.Tensor:
        """(N, width) live numbers of a state component."""
        if not width:
            return torch.zeros((self.num_envs, 0), device=self.device)
        if name == "time":  # in float64, which Warp's is not
            return self._time
        return self.worlds.view(name, width)

    @property
    def revision(self) -> int:
        """Increases when more fields are computed or differ: captured steps are out of date."""
        return self._views_made + self.fields.revision

    # -- reads -------------------------------------------------------------------------------------

    @property
    def state_names(self) -> list[str]:
        """Names of the state components."""
        return list(self._layout)

    @property
    def constants_late(self) -> bool:
        """Whether constants will be computed from model fields that were written."""
        return self._fields.stale

    @property
    def rows(self) -> F64:
        raise HostTransferError("state rows of the host do not exist: use host_rows()")

    def host_rows(self) -> F64:
        """Copy the states to the host, (N, nstate) float64; waits for the device."""
        rows: F64 = np.zeros_like(self._rows)
        for name, columns in self._layout.items():
            rows[:, columns] = self._states[name].host()
        return rows

    @property
    def versions(self) -> NDArray[np.int64]:
        return np.full(self.num_envs, self.version)

    def state(self, name: str) -> Any:
        return self._states[name]

    def derived(self, name: str) -> Any:
        view = self._derived_views.get(name)
        if view is None:
            shape = self._empty(name).shape
            view = DeviceArray(self.worlds.view(name).reshape(shape))
            self._derived_views[name] = view
            self._views_made += 1
            self._only_kinematics &= name in KINEMATIC_STAGES and name != "sensordata"
            self._any_dirty = True
        if self._any_dirty:
            self._refresh()
        return view

    def _refresh(self) -> None:
        self._upload()
        with self._stream():
            if self._only_kinematics:
                names = self._derived_views.keys()
                self.worlds.kinematics(centres=bool(names & _OF_CENTRES), **self._kinds())
            else:
                self.worlds.position_and_velocity()
        self._any_dirty = False

    def _kinds(self) -> dict[str, bool]:
        """Which fields of `WarpWorlds.kinematics` are in use."""
        names = self._derived_views.keys()
        has_cameras = any(name.startswith(("cam_", "light_")) for name in names)
        return {"cameras": has_cameras, "velocities": bool(names & _OF_VELOCITIES)}

    def _stream(self) -> Any:
        """Launch Warp's kernels on torch's stream, in the order of the calls."""
        return wp.ScopedStream(torch_stream(self.device), sync_enter=False)

    @contextmanager
    def capturing(self) -> Iterator[Any]:
        """Capture launches in a graph that torch has begun; nothing computed before is reused.

        Yields:
            An object that owns memory of the graph, to be kept as long as the graph.
        """
        self._mark(None)
        stream = torch_stream(self.device)
        with self._stream(), wp.ScopedCapture(stream=stream, external=True) as capture:
            yield capture

    def acceleration(self, name: str) -> Any:
        output = self._outputs.get(name)
        if output is None:
            shape = self._empty(name).shape
            if name in CONSTRAINT_FORCES:
                self.worlds.want_constraint_forces()
            self._upload()
            with self._stream():
                self.worlds.forward()
            self._any_dirty = True
            live = DeviceArray(self.worlds.view(name).reshape(shape))
            output = _DeviceOutput(live, live.copy())
            self._outputs[name] = output
            none = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
            self._late_masks[name] = DeviceArray(none)
            self._views_made += 1
        if name in self._late:
            self._compute_late(name)
        return output.copy

    def _compute_late(self, name: str) -> None:
        """Compute a field where `forward` was called after the last step."""
        self._late.remove(name)
        self._upload()
        with self._stream():
            if name in _OF_ACTUATORS:  # needs neither contacts nor the solver
                self.worlds.actuation(**self._kinds())
            else:
                self.worlds.forward()
        if self._only_kinematics:
            self._any_dirty = False
        output = self._outputs[name]
        mask = self._late_masks[name]
        output.copy[EnvMask(mask.tensor)] = output.live
        mask[...] = False

    def keep_sensors(self, columns: slice, depth: int) -> None:
        super().keep_sensors(columns, depth)
        self._views_made += 1

    def cast_rays(
        self,
        origins: Any,
        directions: Any,
        geoms: NDArray[np.bool_],
        env_ids: Any = None,
        *,
        normal: bool = False,
    ) -> RayHits:
        self.derived("geom_xpos")  # the kinematics of the current state
        rays = np.broadcast_shapes(origins.shape, directions.shape, (1, 1, 3))[1]
        shape = (self.num_envs, rays, 3)
        origins = tensor_of(np.broadcast_to(origins, shape))
        directions = tensor_of(np.broadcast_to(directions, shape))
        with self._stream():
            hits = self.worlds.cast(origins.contiguous(), directions.contiguous(), geoms)
        arrays: list[Any] = [DeviceArray(part) for part in hits]
        distance, geom, normals = arrays
        return RayHits(distance, geom, normals if normal else None)

    def pictures(
        self, camera: int, optics: Optics, outputs: Sequence[Output], look: Look
    ) -> DevicePictures:
        """Draw a camera in all environments; see `DeviceCameras.draw`."""
        lights = ("light_xpos", "light_xdir") if self.model.nlight else ()
        for name in ("geom_xpos", "geom_xmat", "cam_xpos", "cam_xmat", *lights):
            self.derived(name)  # poses of the current state
        with self._stream():
            return self._cameras.draw(camera, optics, outputs, look, self.version)

    @cached_property
    def _cameras(self) -> DeviceCameras:
        from embodichain.lab.sim.engine.warp.device_cameras import DeviceCameras

        return DeviceCameras(
            worlds=self.worlds,
            model=self.model,
            count=self.num_envs,
            device=str(self.device),
            written=self.fields.written,
        )

    # -- physics -----------------------------------------------------------------------------------

    def step(self, nstep: int, env_ids: Any = None) -> None:
        if env_ids is not None:
            message = "physics steps of some environments are not available on a device"
            raise HostTransferError(f"{message}: use sim.warp.arrays=host")
        self._upload()
        for listener in self.listeners:
            listener.on_physics(PhysicsEvent("before", nstep, None, _NO_ROWS))
        with self._stream():
            self._step_worlds(nstep)
        self._time += nstep * self._timestep
        for listener in self.listeners:
            listener.on_physics(PhysicsEvent("after", nstep, None, _NO_ROWS))
        self._check_states()
        self._mark(None)
        self._late.clear()
        for name, output in self._outputs.items():
            output.copy[...] = output.live
            self._late_masks[name][...] = False

    def _step_worlds(self, nstep: int) -> None:
        if not self._history:
            self.worlds.step(nstep)
            return
        sensors = self.worlds.view("sensordata")
        readings: list[DeviceArray] = []
        self.worlds.step(nstep, lambda: readings.append(DeviceArray(sensors.clone())))
        self._history.append(np.stack(readings, axis=1), None)

    @property
    def _timestep(self) -> Any:
        steps = self.model_values("opt.timestep").reshape(-1)
        if len(steps) > 1:
            raise HostTransferError("timesteps that differ between environments: use host arrays")
        return float(steps[0])

    def _check_states(self) -> None:
        """Mark environments that diverged, and memory that was not enough, on the device."""
        tensors = [
            self._states["qpos"].tensor,
            self._states["qvel"].tensor,
            self.worlds.view("overflow"),
            self._wild,
            self._overflow,
        ]
        arrays = [wp.from_torch(tensor) for tensor in tensors]
        limits = [wp.float32(LARGEST), COLLISION_BITS, ROW_BITS]
        with self._stream():
            wp.launch(_check, self.num_envs, [*arrays, *limits], device=str(self.device))

    def check_memory(self) -> None:
        """Report overflows that the host has seen; does not wait for the device.

        Raises:
            ConfigError: If the memory for contacts, constraints or sensors was not enough.
        """
        if self._seen.any():
            require_memory(self._seen.numpy(), self.worlds)
        self._seen.copy_(self._overflow, non_blocking=True)

    def forward(self, env_ids: Any = None) -> None:
        for mask in self._late_masks.values():
            mask[ALL if env_ids is None else env_ids] = True
        self._late.update(self._outputs)
        self._history.begin(env_ids)
        self.version += 1

    def take_diverged(self) -> Any:
        diverged = DeviceArray(self._wild.clone())
        self._wild.zero_()
        return diverged

    def reset(self, env_ids: Any = None, row: F64 | None = None) -> None:
        state = self._default_row if row is None else row
        self._write_row(state, env_ids, np.arange(len(state)))
        DeviceArray(self._wild)[ALL if env_ids is None else env_ids] = False
        self._mark(env_ids)
        self._notify(Write("reset", "row", env_ids, ALL, None))

    # -- writes ------------------------------------------------------------------------------------

    def write(self, field: str, values: Any, env_ids: Any = None, columns: Columns = ALL) -> None:
        if field == "row":
            places = np.arange(len(self._default_row))[columns]
            self._write_row(values, env_ids, places)
        else:
            self._states[field][entries(env_ids, columns)] = values
        self._mark(env_ids)
        if self.listeners:
            self._notify(Write("state", field, env_ids, columns, None))

    def _write_row(self, values: Any, env_ids: Any, places: NDArray[np.int64]) -> None:
        """Set columns of state rows, from a number or an array (k,) or (N, k) of the host."""
        numbers = np.asarray(values, np.float64)
        if not numbers.ndim:
            numbers = np.full(len(places), numbers)
        for name, columns in self._layout.items():
            is_here = (places >= columns.start) & (places < columns.stop)
            if not is_here.any():
                continue
            part: Any = numbers[..., is_here]
            if part.ndim > 1:
                part = DeviceArray(torch.from_numpy(part.copy()).to(self.device))
            part_columns: Any = places[is_here] - columns.start
            if len(part_columns) == columns.stop - columns.start:
                part_columns = ALL
            self._states[name][entries(env_ids, part_columns)] = part

    def write_model(
        self, field: str, values: Any, env_ids: Any = None, columns: Columns = ALL
    ) -> None:
        self._constants_before(field)
        self.fields.write(field, values, env_ids, columns)
        self._mark(env_ids)
        self._notify(Write("model", field, env_ids, columns, None))

    def model_field(self, field: str) -> Any:
        self._constants_before(field)
        return self.fields.view(field)

    @property
    def models_may_differ(self) -> bool:
        return True

    def model_values(self, field: str) -> Any:
        self._constants_before(field)
        return self.fields.values(field)

    def _constants_before(self, field: str) -> None:
        """Compute constants that are out of date if this field is one of them."""
        if self._fields.stale and field in DERIVED_FIELDS:
            self.set_const()

    def set_const_later(self, env_ids: Any = None) -> None:
        self._fields.stale = True
        self._mark(env_ids)

    def set_const(self, env_ids: Any = None) -> None:
        """Compute constants of all environments: those of the others do not change."""
        self._fields.stale = False
        with self._stream():
            self.fields.set_const()
        self._mark(None)
        self._notify(Write("set_const", "", None, ALL, None))

    def _mark(self, env_ids: Any) -> None:
        self.version += 1
        self._any_dirty = True

    def _upload(self) -> None:
        if self._fields.stale:
            self.set_const()
        if self.fields.moved:
            with self._stream():
                self.worlds.kinematics()
            self.fields.place_geoms(
                DeviceArray(self.worlds.view("geom_xpos")),
                DeviceArray(self.worlds.view("geom_xmat")),
                (DeviceArray(self.worlds.view("xpos")), DeviceArray(self.worlds.view("xquat"))),
            )

    def _pull_fields(self) -> None:
        """Copy the model fields to the batch on the host; waits for the device."""
        for name, values in self.fields.host().items():
            self._fields.view(name)[...] = values
        if self.fields.has_constants or self._fields.stale:
            self._batch.set_const(None)

    # -- whole simulations -------------------------------------------------------------------------

    def model_of(self, env_id: int) -> mujoco.MjModel:
        self._pull_fields()
        return self._batch.get_model(env_id)

    def model_fields(self) -> dict[str, NDArray[Any]]:
        self._pull_fields()
        return super().model_fields()

    def data_of(self, env_id: int) -> mujoco.MjData:
        self._rows[...] = self.host_rows()
        return super().data_of(env_id)

    def load_state_dict(self, state: dict[str, Any]) -> None:
        acceleration = {
            name: on_device(values, self.device) for name, values in state["acceleration"].items()
        }
        super().load_state_dict({**state, "acceleration": acceleration})
        self._wild.zero_()

    def state_dict(self) -> dict[str, Any]:
        return {
            "rows": self.host_rows(),
            "model": self.model_fields(),
            "warning": self._batch.warning.copy(),
            "acceleration": {name: self.acceleration(name).host() for name in self._outputs},
            "sensor_history": _hosted(self._history.state_dict()),
        }


def _hosted(state: dict[str, Any]) -> dict[str, Any]:
    """A state with its arrays on the host."""
    return {
        name: _hosted(part) if isinstance(part, dict) else part.host()
        for name, part in state.items()
    }

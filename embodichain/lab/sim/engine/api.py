"""`Engine`: interface for stepping N environments; writes, listeners, types of arrays.

`CpuEngine` implements it on `mujoco.batch`, `WarpEngine` on MuJoCo Warp.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.utils.array_types import F64, EnvIds, EnvIndex, Floats

if TYPE_CHECKING:
    from embodichain.lab.sim.drawing.commands import ShownCommand

__all__ = [
    "ALL",
    "F64",
    "Columns",
    "Engine",
    "EngineListener",
    "EnvIndex",
    "PhysicsEvent",
    "RayHits",
    "Write",
    "WriteOp",
]

Columns = slice | NDArray[np.int64]
"""Columns of a flattened field: (k,) indices, or a slice of them."""
ALL = slice(None)
WriteOp = Literal["state", "model", "reset", "set_const", "forward"]


class Write(NamedTuple):
    """One write to the simulation outside physics, exactly as it was applied.

    Attributes:
        op: ``state`` sets columns of state rows; ``model`` sets columns of a per-environment model
            field; ``reset`` sets rows to MuJoCo's reset state (`mj_resetData`); ``set_const``
            recomputes derived constants (`mj_setConst`); ``forward`` ran `mj_forward` (the row may
            be unchanged). ``values`` is None for the last three.
        field: A component of the state row (``qpos``, ``ctrl``, ``mocap_pos``, ``row`` for whole
            rows...) or a model field (``body_mass``, ``opt.gravity``); empty for other ops.
        env_ids: (n,) environments, or None for all N; a mask with arrays on a device.
        columns: Columns within the flattened field.
        values: (n, k) float64, or None. It may be a live view of the engine: copy it to store it.
            None for all ops with arrays on a device.
    """

    op: WriteOp
    field: str
    env_ids: EnvIndex | None
    columns: Columns
    values: F64 | None


class PhysicsEvent(NamedTuple):
    """Physics is about to step (``before``) or has just stepped (``after``).

    Attributes:
        phase: ``before`` or ``after``.
        nstep: Physics steps of this call.
        env_ids: (n,) environments that step, or None for all.
        rows: (N, nstate) **live** integration-state rows: copy them to store them. Empty with
            arrays on a device.
        failed: (m,) environments in which MuJoCo raised and the previous row was kept; set in
            phase ``after``.
    """

    phase: Literal["before", "after"]
    nstep: int
    env_ids: EnvIndex | None
    rows: F64
    failed: EnvIds | None = None


class RayHits(NamedTuple):
    """What R rays hit in n environments.

    Attributes:
        distance: (n, R) in lengths of the ray's direction; -1 where nothing is hit.
        geom: (n, R) geom ids; -1 where nothing is hit.
        normal: (n, R, 3) unit normals of the surfaces, 0 where nothing is hit; None if not wanted.
    """

    distance: Floats
    geom: NDArray[np.int32]
    normal: Floats | None = None


class EngineListener(Protocol):
    """Is called for everything that changes the simulation."""

    def on_write(self, write: Write) -> None:
        """Called after a write was applied to the rows or model fields."""

    def on_physics(self, event: PhysicsEvent) -> None:
        """Called right before and right after physics steps."""


class Engine(Protocol):
    """N simulations of one model.

    Row *i* of an array is environment *i*. Arrays are float64 of numpy, and `env_ids` are sorted
    unique indices; with arrays on a device they are `DeviceArray` and a mask. None is all. Reads
    marked *fresh* first run the position and velocity stages of environments in which rows have
    changed.
    """

    name: str
    """What computes physics: ``mujoco``, or ``mujoco_warp 4.0.0``."""
    version: int
    """Increases with every change that may affect positions, velocities, accelerations or the
    model."""
    model: mujoco.MjModel
    num_envs: int
    has_gravity: bool
    """Whether the model's gravity, which may be zero, acts."""
    listeners: list[EngineListener]
    commands: Sequence[ShownCommand] = ()
    """Commands of the task, for pictures alone."""
    reports_writes: bool = True
    """Whether listeners are told of every write; else of what differs between two copies."""

    @property
    def versions(self) -> NDArray[np.int64]:
        """(N,) `version` of the last change of each environment's positions or model."""

    @property
    def rows(self) -> F64:
        """(N, nstate) live integration-state rows (`mjSTATE_INTEGRATION`). Do not write."""

    def component(self, name: str) -> slice:
        """Columns of a state component (``qpos``, ``mocap_pos``...) within a row.

        Raises:
            KeyError: If there is no such component; lists them.
        """

    def state(self, name: str) -> Floats:
        """(N, width) live view of a state component. Do not write: use `write`.

        A component's view remains valid for the engine's lifetime, so handles may store it and
        slices of it.
        """

    def derived(self, name: str) -> Floats:
        """(N, ...) fresh position- or velocity-stage field (``xpos``, ``cvel``, ``sensordata``)."""

    def acceleration(self, name: str) -> Floats:
        """(N, ...) acceleration-stage field (``qfrc_actuator``) of the last physics step.

        After `forward` it is that of the current state. The first request of a field computes it
        at the current state. The array is valid until the next step or full `forward`.
        """

    def keep_sensors(self, columns: slice, depth: int) -> None:
        """Keep columns of ``sensordata`` of the last ``depth`` physics steps from now on."""

    def kept_sensors(self, columns: slice, depth: int) -> Floats:
        """(N, depth, k) what `keep_sensors` keeps, the oldest first. Do not write.

        Environments that have not stepped since `forward` have its readings in every step.
        """

    def cast_rays(
        self,
        origins: Floats,
        directions: Floats,
        geoms: NDArray[np.bool_],
        env_ids: EnvIndex | None = None,
        *,
        normal: bool = False,
    ) -> RayHits:
        """Intersect rays with geoms at the current positions (`mj_ray`), visual geoms included.

        Args:
            origins: Broadcasts to (n, R, 3), metres.
            directions: Broadcasts to (n, R, 3); not zero.
            geoms: (ngeom,) geoms that rays can hit; invisible ones (alpha 0) are left out as well.
            env_ids: (n,) environments, or None for all.
            normal: Whether to return normals.
        """

    def step(self, nstep: int, env_ids: EnvIndex | None = None) -> None:
        """Advance physics by ``nstep`` steps of the model's timestep; see `take_diverged`."""

    def forward(self, env_ids: EnvIndex | None = None) -> None:
        """Compute all derived fields, acceleration stage included, without stepping."""

    def reset(self, env_ids: EnvIndex | None = None, row: Floats | None = None) -> None:
        """Set rows to MuJoCo's reset state (`mj_resetData`): time, ctrl, act, warm start...

        Also clears the warning counters.

        Args:
            env_ids: (n,) environments, or None for all.
            row: (nstate,) the state to set afterwards, as `write` does, or None.
        """

    def write(
        self, field: str, values: Any, env_ids: EnvIndex | None = None, columns: Columns = ALL
    ) -> None:
        """Set columns of a state component. All state changes outside physics use this method.

        Args:
            field: The component (``qpos``, ``ctrl``, ``mocap_pos``...), or ``row`` for whole rows.
            values: Broadcasts to (n, k); copied.
            env_ids: (n,) environments, or None for all.
            columns: (k,) columns within the component.
        """

    def write_model(
        self, field: str, values: Any, env_ids: EnvIndex | None = None, columns: Columns = ALL
    ) -> None:
        """Set columns of a model field per environment, as `write` does; see `set_const`.

        Raises:
            ValueError: If the field (of `MjModel`, or ``opt.NAME``) is not in
                `mujoco.batch.MODEL_FIELDS`, those that can differ between environments.
        """

    def model_field(self, field: str) -> NDArray[Any]:
        """(N, size) flattened per-environment values of a model field. Do not write."""

    @property
    def models_may_differ(self) -> bool:
        """Whether `model_values` may have a row for each environment for fields that are written.

        False until the first `write_model`; always True on a device.
        """

    def model_values(self, field: str) -> NDArray[Any]:
        """(N or 1, ...) values of a model field; one row if all environments share it.

        Unlike `model_field`, it does not make the field one that differs. Do not write.
        """

    def set_const(self, env_ids: EnvIndex | None = None) -> None:
        """Recompute derived model constants (`mj_setConst`) immediately.

        Raises:
            ConfigError: If MuJoCo refuses the model fields of an environment.
        """

    def set_const_later(self, env_ids: EnvIndex | None = None) -> None:
        """Call `set_const` before the next read or step, once for all writes until then."""

    def take_diverged(self) -> NDArray[np.bool_] | None:
        """(N,) mask of environments that diverged since the last call, or None."""

    def model_of(self, env_id: int) -> mujoco.MjModel:
        """A copy of one environment's model, with that environment's field values."""

    def data_of(self, env_id: int) -> mujoco.MjData:
        """One environment as an MjData with derived fields computed; its model as in `model_of`."""

    def model_fields(self) -> dict[str, NDArray[Any]]:
        """Name -> (N, ...) copies of per-environment model fields, derived ones included."""

    def state_dict(self) -> dict[str, Any]:
        """Rows, per-environment model fields, warning counters, acceleration fields (copies)."""

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue exactly where `state_dict` was taken."""

    def close(self) -> None:
        """Free the simulations' memory, whatever still refers to the engine; using it is an error.

        Views of states and fields stay valid, and keep the memory of the simulations as they do.
        """

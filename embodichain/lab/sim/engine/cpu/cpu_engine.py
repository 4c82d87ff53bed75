"""`HostEngine` keeps states and models on the host; `CpuEngine` steps them with `mujoco.batch`.

Methods are documented in `api`. Use an instance from one Python thread at a time (`mujoco.batch`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import mujoco
import numpy as np
from mujoco import batch as mjbatch
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import (
    ALL,
    F64,
    Columns,
    Engine,
    EngineListener,
    EnvIndex,
    PhysicsEvent,
    RayHits,
    Write,
)
from embodichain.lab.sim.engine.cpu.forked_batch import guard_against_forks
from embodichain.lab.sim.engine.cpu.mujoco_process import (
    all_cores,
    install_log_handler,
    stop_timers,
)
from embodichain.lab.sim.engine.fields import DERIVED_FIELDS, ModelFields, row_layout
from embodichain.lab.sim.engine.sensor_history import SensorHistory
from embodichain.utils.array_types import EnvIds
from embodichain.utils.errors import ConfigError
from embodichain.utils.short_repr import short_repr
from embodichain.utils.suggest import did_you_mean
from embodichain.utils.uncopied import Uncopied

__all__ = ["KINEMATIC_STAGES", "CpuEngine", "HostEngine", "PhysicsOutput", "entries"]

_STAGE_NONE = int(mujoco.mjtStage.mjSTAGE_NONE)
_STAGE_POS = int(mujoco.mjtStage.mjSTAGE_POS)
_STAGE_VEL = int(mujoco.mjtStage.mjSTAGE_VEL)
_STAGE_ACC = int(mujoco.mjtStage.mjSTAGE_ACC)

KINEMATIC_STAGES = dict.fromkeys(
    (
        "xpos", "xquat", "xmat", "xipos", "ximat", "xanchor", "xaxis", "geom_xpos", "geom_xmat",
        "site_xpos", "site_xmat", "cam_xpos", "cam_xmat", "light_xpos", "light_xdir",
        "subtree_com", "cdof",
    ),
    _STAGE_POS,
) | dict.fromkeys(("cvel", "cdof_dot", "sensordata"), _STAGE_VEL)  # fmt: skip
"""Fields that do not depend on contacts -> the stage that computes each."""

# They change no position- or velocity-stage field.
_INPUTS = frozenset({"ctrl", "qfrc_applied", "xfrc_applied"})
# Models with bookkeeping in the MjData need one per environment (MuJoCo's manual, "batch").
_HIDDEN_STATE = int(mujoco.mjtEnableBit.mjENBL_SLEEP) | int(mujoco.mjtEnableBit.mjENBL_IPC)
_NO_CONTACT = np.int32(mujoco.mjtDisableBit.mjDSBL_CONTACT)
_NO_CONSTRAINT = np.int32(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
_NO_GRAVITY = int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
_NO_SENSOR = np.int32(mujoco.mjtDisableBit.mjDSBL_SENSOR)
# Warnings that mean the state is no longer physics.
_DIVERGED = [
    int(getattr(mujoco.mjtWarning, f"mjWARN_{name}"))
    for name in ("BADQPOS", "BADQVEL", "BADQACC", "BADCTRL", "CONTACTFULL", "CNSTRFULL")
]


class _DivergenceMarks(Protocol):
    """Which environments diverged since they were last asked for."""

    def begin(self) -> None: ...

    def add_failed(self, env_ids: EnvIds) -> None: ...

    def forget(self, env_ids: Any) -> None: ...

    def take(self) -> NDArray[np.bool_] | None: ...


@dataclass(frozen=True, eq=False)
class PhysicsOutput:
    """A field that physics writes.

    Attributes:
        live: (N, ...) the output, which computing derived fields overwrites.
        copy: (N, ...) what it was after the last step or full forward.
    """

    live: F64
    copy: F64


class HostEngine(Uncopied, Engine):
    """State rows, model fields and writes of N simulations; subclasses compute the physics.

    Rows and model fields are those of a `mujoco.batch.Batch`, on the host and in float64, whatever
    computes physics from them. The batch also computes derived constants (`mj_setConst`).

    Args:
        model: The compiled scene; the batch copies it.
        num_envs: N.
        num_threads: Threads of the batch; 0 uses every core this process may run on.
        persistent: See `CpuEngine`.
    """

    _divergence: _DivergenceMarks

    def __init__(
        self, model: mujoco.MjModel, num_envs: int, num_threads: int, persistent: bool | None
    ) -> None:
        install_log_handler()
        stop_timers()
        threads = num_threads or all_cores()
        has_hidden_state = bool(model.opt.enableflags & _HIDDEN_STATE) or model.nplugin > 0
        self.model = model
        self.num_envs = num_envs
        self.has_gravity = not model.opt.disableflags & _NO_GRAVITY
        self.version = 0
        self.num_threads = min(threads, num_envs)
        self.persistent = has_hidden_state if persistent is None else persistent
        self.listeners: list[EngineListener] = []
        self._batch: Any = mjbatch.Batch(
            model, num_envs, nthread=self.num_threads, persistent=self.persistent
        )
        if self.num_threads > 1:
            guard_against_forks(self)

        # States and models.
        self._plain_reset = not has_hidden_state  # a row is all that a reset changes
        self._batch.reset(stage=_STAGE_NONE)
        self._rows: F64 = self._batch.state
        self._default_row: F64 = self._rows[0].copy()
        self._layout = row_layout(model)
        self._views: dict[str, F64] = {
            name: self._rows[:, columns] for name, columns in self._layout.items()
        }
        self._fields = ModelFields(self._batch, num_envs)

        # What physics computes of them.
        self._derived: dict[str, F64] = {}
        self._accelerations: dict[str, PhysicsOutput] = {}
        self._history = SensorHistory(num_envs, np.array)

        # Where derived fields are out of date: they are computed when somebody reads one. Most
        # writes are to all environments, and most reads follow another read, so one flag answers
        # for both: `_any_dirty` spares a read the search of the mask, `_all_dirty` a write to it.
        # While `_all_dirty` is set, `_dirty` has no meaning.
        self._any_dirty = True
        self._all_dirty = True
        self._dirty = np.ones(num_envs, np.bool_)

        # The version since which each environment is as it is, for those who store what they read
        # (`versions`). A change of all environments is one number, not N.
        self._all_changed = 0
        self._changed: NDArray[np.int64] = np.zeros(num_envs, np.int64)

    def close(self) -> None:
        self.__dict__.clear()  # terms of the environment may refer to the engine until it is freed

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"no {name!r}" if vars(self) else "the simulation was destroyed")

    def __repr__(self) -> str:
        """Return class, N, sizes of the model, and the number of threads."""
        if not vars(self):
            return f"{type(self).__name__}(closed)"
        return short_repr(
            self,
            num_envs=self.num_envs,
            nq=self.model.nq,
            nv=self.model.nv,
            nu=self.model.nu,
            num_threads=self.num_threads,
        )

    def lose_threads(self, instead: Any) -> None:
        """Use this object instead of the batch, whose threads a forked process does not have."""
        self._batch = instead

    # -- reads -------------------------------------------------------------------------------------

    @property
    def versions(self) -> NDArray[np.int64]:
        return np.maximum(self._changed, self._all_changed)

    @property
    def rows(self) -> F64:
        return self._rows

    def component(self, name: str) -> slice:
        try:
            return self._layout[name]
        except KeyError:
            raise KeyError(
                f"no state component {name!r}; there are {', '.join(self._layout)}."
                f"{did_you_mean(name, self._layout)}"
            ) from None

    def state(self, name: str) -> F64:
        return self._views[name]

    def _copy_accelerations(self, env_ids: EnvIndex | None) -> None:
        for output in self._accelerations.values():
            if env_ids is None:
                output.copy[...] = output.live
            else:
                output.copy[env_ids] = output.live[env_ids]

    def keep_sensors(self, columns: slice, depth: int) -> None:
        self.acceleration("sensordata")  # the first request computes it
        self._history.keep(columns, depth)

    def kept_sensors(self, columns: slice, depth: int) -> F64:
        return self._history.read(columns, depth, self.acceleration("sensordata"))

    def _call(self, function: Any, *args: Any, **kwargs: Any) -> EnvIds | None:
        """Run a batch call; remember and return the environments in which MuJoCo raised."""
        try:
            function(*args, **kwargs)
        except mjbatch.SimulationError as error:
            failed = np.asarray(error.ids, np.int64)
            self._divergence.add_failed(failed)
            return failed
        return None

    def reset(self, env_ids: EnvIndex | None = None, row: F64 | None = None) -> None:
        where: Any = ALL if env_ids is None else env_ids
        if self._plain_reset and self._fields.resets_alike:
            # The same row as `Batch.reset` gives, a hundred times faster: it loads no MjData.
            self._rows[where] = self._default_row
            self._batch.warning[where] = 0
        else:
            self._batch.reset(env_ids, stage=_STAGE_NONE)
        self._mark(env_ids)
        self._divergence.forget(where)
        self._notify(Write("reset", "row", env_ids, ALL, None))
        if row is not None:
            self.write("row", row, env_ids)

    def take_diverged(self) -> NDArray[np.bool_] | None:
        return self._divergence.take()

    # -- writes ------------------------------------------------------------------------------------

    def write(
        self, field: str, values: Any, env_ids: EnvIndex | None = None, columns: Columns = ALL
    ) -> None:
        view = self._rows if field == "row" else self._views[field]
        where = entries(env_ids, columns)
        view[where] = values
        if field not in _INPUTS:
            self._mark(env_ids)
        if self.listeners:
            self._notify(Write("state", field, env_ids, columns, view[where]))

    def write_model(
        self, field: str, values: Any, env_ids: EnvIndex | None = None, columns: Columns = ALL
    ) -> None:
        fields = self._fields
        if fields.stale and field in DERIVED_FIELDS:
            self._set_const_now()  # it must not undo this write
        view = fields.view(field)
        view[entries(env_ids, columns)] = values
        self._mark(env_ids)
        if self.listeners:
            written = view[entries(env_ids, columns)].astype(np.float64, copy=False)
            self._notify(Write("model", field, env_ids, columns, written))

    def model_field(self, field: str) -> NDArray[Any]:
        fields = self._fields
        if fields.stale and field in DERIVED_FIELDS:
            self._set_const_now()
        return fields.view(field)

    @property
    def models_may_differ(self) -> bool:
        return self._fields.any

    def model_values(self, field: str) -> NDArray[Any]:
        fields = self._fields
        if fields.stale and field in DERIVED_FIELDS:
            self._set_const_now()
        return fields.values(field)

    def set_const(self, env_ids: EnvIndex | None = None) -> None:
        try:
            self._batch.set_const(env_ids)
        except mjbatch.SimulationError as error:  # of the model, not of a state: no divergence
            raise ConfigError(f"model fields that MuJoCo does not take: {error}") from error
        self._mark(env_ids)
        self._notify(Write("set_const", "", env_ids, ALL, None))

    def set_const_later(self, env_ids: EnvIndex | None = None) -> None:
        self._fields.mark(env_ids)
        self._mark(env_ids)

    def _set_const_now(self) -> None:
        self.set_const(self._fields.take_stale())

    def _mark(self, env_ids: EnvIndex | None) -> None:
        """Note that positions or the model changed: a new version, and derived fields are dirty."""
        self.version += 1
        self._any_dirty = True
        if env_ids is None:
            self._all_dirty = True
            self._all_changed = self.version
            return
        self._changed[env_ids] = self.version
        if not self._all_dirty:
            self._dirty[env_ids] = True

    def _mark_all_dirty(self) -> None:
        """Have derived fields computed again at the next read, though nothing has changed."""
        self._any_dirty = True
        self._all_dirty = True

    def _mark_all_clean(self) -> None:
        """Note that derived fields are computed in all environments."""
        self._dirty[:] = False
        self._any_dirty = False
        self._all_dirty = False

    def _notify(self, write: Write) -> None:
        for listener in self.listeners:
            listener.on_write(write)

    # -- whole simulations -------------------------------------------------------------------------

    def model_of(self, env_id: int) -> mujoco.MjModel:
        if self._fields.stale:
            self._set_const_now()
        return self._batch.get_model(env_id)

    def data_of(self, env_id: int) -> mujoco.MjData:
        model = self.model_of(env_id) if self._fields.any else self.model
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, self._rows[env_id], mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(model, data)
        return data

    def model_fields(self) -> dict[str, NDArray[Any]]:
        return {name: np.array(values) for name, values in self._fields.expanded().items()}

    def state_dict(self) -> dict[str, Any]:
        if self._fields.stale:
            self._set_const_now()
        return {
            "rows": self._rows.copy(),
            "model": self.model_fields(),
            "warning": self._batch.warning.copy(),
            "acceleration": {
                name: output.copy.copy() for name, output in self._accelerations.items()
            },
            "sensor_history": self._history.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        fields = self._fields
        model = state["model"]
        fields.take_stale()
        for field in fields.expanded().keys() - model.keys():
            self.write_model(field, fields.default(field))
        self._write_model_fields(model)
        if DERIVED_FIELDS & model.keys():
            # MuJoCo also sets model flags that are not fields; it must not change derived ones.
            self.set_const()
            self._write_model_fields(model)
        self.write("row", state["rows"])
        for field, values in state["acceleration"].items():
            self.acceleration(field)[...] = values
        self._history.load_state_dict(state.get("sensor_history", {}))
        # Counters are restored as a baseline: only new warnings count as divergence.
        self._divergence.begin()

    def _write_model_fields(self, fields: dict[str, NDArray[Any]]) -> None:
        for field, values in fields.items():
            self.write_model(field, values.reshape(self.num_envs, -1))


class CpuEngine(HostEngine):
    """N simulations of one model on a pool of threads.

    Args:
        model: The compiled scene; the batch copies it.
        num_envs: N.
        num_threads: Physics threads; 0 uses every core this process may run on.
        persistent: One MjData per environment (True) or per thread (False). Per thread, the data
            stays in the cache, which makes steps up to 15 % faster, and reads of poses compute
            poses only. Per environment, a step reuses stages that a read has computed. None is
            False, unless the model needs True. Results are the same to the bit.
    """

    name = "mujoco"

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        num_threads: int = 0,
        persistent: bool | None = None,
    ) -> None:
        super().__init__(model, num_envs, num_threads, persistent)
        self._kinematics = _Kinematics()
        self._divergence = _Divergence(self._batch)

    def derived(self, name: str) -> F64:
        if name not in self._derived:
            self._derived[name] = self._batch.bind(name)
            self._kinematics.need(name)
            self._mark_all_dirty()
        if self._any_dirty:
            self._refresh()
        return self._derived[name]

    def _refresh(self) -> None:
        if self._fields.stale:
            self._set_const_now()
        ids = None if self._all_dirty else np.flatnonzero(self._dirty)
        if self._kinematics.enough and not self.persistent:
            flags = self._fields.internal("opt.disableflags")
            self._call(self._kinematics.forward, self._batch, flags, ids)
        else:
            self._call(self._batch.forward, ids, _STAGE_VEL)
        self._mark_all_clean()

    def acceleration(self, name: str) -> F64:
        output = self._accelerations.get(name)
        if output is None:
            if self._fields.stale:
                self._set_const_now()
            live = self._batch.bind(name)
            self._call(self._batch.forward, None, stage=_STAGE_ACC)
            output = PhysicsOutput(live, live.copy())
            self._accelerations[name] = output
        return output.copy

    def cast_rays(
        self,
        origins: F64,
        directions: F64,
        geoms: NDArray[np.bool_],
        env_ids: EnvIndex | None = None,
        *,
        normal: bool = False,
    ) -> RayHits:
        if self._fields.stale:
            self._set_const_now()
        # mj_ray chooses geoms by group: put them into group 0 during the call, others into 5.
        group = self._fields.internal("geom_group")
        before = group.copy()
        group[:] = np.where(geoms, 0, 5)
        try:
            hits = self._batch.ray(
                origins, directions, geomgroup=[1, 0, 0, 0, 0, 0], ids=env_ids, normal=normal
            )
        finally:
            group[...] = before
        return RayHits(*hits)

    def step(self, nstep: int, env_ids: EnvIndex | None = None) -> None:
        if self._fields.stale:
            self._set_const_now()
        listeners = self.listeners
        if listeners:
            event = PhysicsEvent("before", nstep, env_ids, self._rows)
            for listener in listeners:
                listener.on_physics(event)
        if self._history:
            failed = self._step_keeping_sensors(nstep, env_ids)
        else:
            failed = self._call(self._batch.step, env_ids, nstep, _STAGE_NONE)
        self._mark(env_ids)
        self._copy_accelerations(env_ids)
        if listeners:
            event = PhysicsEvent("after", nstep, env_ids, self._rows, failed)
            for listener in listeners:
                listener.on_physics(event)

    def _step_keeping_sensors(self, nstep: int, env_ids: EnvIndex | None) -> EnvIds | None:
        """Step as `Batch.step` does, to the bit, and keep the sensors of each physics step."""
        num_envs = self.num_envs if env_ids is None else len(env_ids)
        steps = np.zeros((num_envs, nstep, self.model.nsensordata))
        before = self._views["time"][:, 0].copy()
        warned = self._batch.warning.tobytes()
        failed = self._roll_out(steps, env_ids)
        if self._batch.warning.tobytes() != warned:
            ids = np.arange(num_envs) if env_ids is None else env_ids
            self._step_on(steps, ids, before[ids], failed)
        self._history.append(steps, env_ids)
        return failed

    def _roll_out(self, steps: F64, env_ids: EnvIndex | None) -> EnvIds | None:
        """Step, with sensors into ``steps`` (n, nstep, nsensordata); return where MuJoCo raised."""
        return self._call(
            self._batch.rollout,
            steps.shape[1],
            record=["sensordata"],
            ids=env_ids,
            out={"sensordata": steps},
        )

    def _step_on(self, steps: F64, ids: EnvIndex, before: F64, failed: EnvIds | None) -> None:
        """Take the steps that a rollout has left out: it stops where a warning is counted.

        Args:
            steps: (n, nstep, nsensordata) the sensors of each step; completed.
            ids: (n,) the environments.
            before: (n,) their time before the steps, s.
            failed: Environments in which MuJoCo raised, which stay where they are.
        """
        timestep = self.model_values("opt.timestep").reshape(-1)
        if len(timestep) > 1:
            timestep = timestep[ids]
        elapsed = self._views["time"][ids, 0] - before
        completed_steps = np.rint(elapsed / timestep).astype(np.int64)
        has_failed = np.zeros(len(ids), np.bool_)
        if failed is not None:
            has_failed |= np.isin(ids, failed)
        for step in range(steps.shape[1]):
            late = np.flatnonzero((completed_steps <= step) & ~has_failed)
            if not len(late):
                continue
            single_step = np.zeros((len(late), 1, steps.shape[2]))
            failed = self._roll_out(single_step, ids[late])
            steps[late, step] = single_step[:, 0]
            if failed is not None:
                has_failed |= np.isin(ids, failed)

    def forward(self, env_ids: EnvIndex | None = None) -> None:
        if self._fields.stale:
            self._set_const_now()
        self._history.begin(env_ids)
        self._call(self._batch.forward, env_ids, stage=_STAGE_ACC)
        self._copy_accelerations(env_ids)
        if env_ids is None:
            self._mark_all_clean()
        elif not self._all_dirty:
            self._dirty[env_ids] = False
            self._any_dirty = bool(self._dirty.any())
        self.version += 1
        self._notify(Write("forward", "", env_ids, ALL, None))


def entries(env_ids: EnvIndex | None, columns: Columns) -> tuple[Any, Any]:
    """Return the numpy index of columns in environments' rows; None is all environments."""
    if env_ids is None:
        return ALL, columns
    if isinstance(columns, slice):
        return env_ids, columns
    return env_ids[:, None], columns


class _Kinematics:
    """Forward kinematics of a batch, at less than half the cost of position and velocity stages.

    Contacts are switched off meanwhile, so contact memory overflow is detected by the next step.

    Attributes:
        enough: Whether it computes all requested fields.
    """

    def __init__(self) -> None:
        self.enough = True
        self._stage = _STAGE_POS
        self._left_out = np.array([[_NO_CONTACT | _NO_CONSTRAINT | _NO_SENSOR]])

    def need(self, name: str) -> None:
        """Also compute this field from now on."""
        stage = KINEMATIC_STAGES.get(name)
        if stage is None:
            self.enough = False
        else:
            self._stage = max(self._stage, stage)
        if name == "sensordata":  # a sensor may be about the constraint of a joint's limit
            self._left_out = np.array([[_NO_CONTACT]])

    def forward(
        self, batch: mjbatch.Batch, flags: NDArray[np.int32], env_ids: EnvIndex | None
    ) -> None:
        """Compute the fields at the batch's current state.

        Args:
            batch: The batch.
            flags: (N, 1) its live ``opt.disableflags``; restored afterwards.
            env_ids: (n,) environments, or None for all.

        Raises:
            mujoco.batch.SimulationError: If MuJoCo raised in an environment.
        """
        before = flags.copy()
        flags[...] = before | self._left_out  # one number in place takes three times as long
        try:
            batch.forward(env_ids, stage=self._stage)
        finally:
            flags[...] = before


class _Divergence:
    """Detects divergence by MuJoCo's warning counters, and stores where MuJoCo raised.

    Args:
        batch: The batch; its current counters are the baseline.
    """

    def __init__(self, batch: mjbatch.Batch) -> None:
        self._warning: NDArray[np.int32] = batch.warning
        self._numbers: NDArray[np.int32] = batch.warning[:, :, 1]
        self.begin()

    def begin(self) -> None:
        """Set the baseline to the current counters: only new warnings count."""
        self._counts: NDArray[np.int32] = self._numbers[:, _DIVERGED].copy()
        self._warned = self._warning.tobytes()
        self._failed: NDArray[np.bool_] | None = None

    def add_failed(self, env_ids: EnvIds) -> None:
        """Remember environments (n,) in which MuJoCo raised."""
        if self._failed is None:
            self._failed = np.zeros(len(self._warning), np.bool_)
        self._failed[env_ids] = True

    def forget(self, env_ids: Any) -> None:
        """Clear the divergence of environments that were reset (indices or a slice)."""
        self._counts[env_ids] = self._numbers[:, _DIVERGED][env_ids]
        self._warned = self._warning.tobytes()
        if self._failed is not None:
            self._failed[env_ids] = False

    def take(self) -> NDArray[np.bool_] | None:
        """(N,) mask of environments that diverged since the last call, or None."""
        warned = self._warning.tobytes()  # comparing bytes is 10 times faster than a sum
        if warned == self._warned and self._failed is None:
            return None
        counts = self._numbers[:, _DIVERGED]
        mask: NDArray[np.bool_] = np.asarray((counts > self._counts).any(axis=1))
        self._counts[:] = counts
        self._warned = warned
        if self._failed is not None:
            mask |= self._failed
            self._failed = None
        return mask if mask.any() else None

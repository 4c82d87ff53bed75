"""`CpuEngine`: the engine contract on `mujoco.batch.Batch`.

Rows, fields and writes live here; what a joint or a body is does not. One instance must not be
used from several Python threads at once (`mujoco.batch` says so).
"""

from __future__ import annotations

import os
from typing import Any

import mujoco
import numpy as np
from mujoco import batch as mjbatch
from numpy.typing import NDArray

from embodichain.lab.sim.engine.acceleration import AccelerationFields
from embodichain.lab.sim.engine.base import F64, EngineListener, EnvIndex, PhysicsEvent, Write
from embodichain.lab.sim.engine.divergence import Divergence
from embodichain.lab.sim.engine.kinematics import Kinematics
from embodichain.lab.sim.engine.layout import row_layout
from embodichain.lab.sim.engine.model_fields import DERIVED_FIELDS, ModelFields
from embodichain.lab.sim.engine.mujoco_log import install_log_handler
from embodichain.lab.sim.engine.pool import Pool
from embodichain.lab.sim.engine.rows import left, picked, where
from embodichain.lab.sim.engine.timers import stop_timers
from embodichain.utils.suggest import did_you_mean

__all__ = ["CpuEngine"]

_STAGE_NONE = int(mujoco.mjtStage.mjSTAGE_NONE)
_STAGE_VEL = int(mujoco.mjtStage.mjSTAGE_VEL)
_STAGE_ACC = int(mujoco.mjtStage.mjSTAGE_ACC)

# They change no position- or velocity-stage field.
_INPUTS = frozenset({"ctrl", "qfrc_applied", "xfrc_applied"})
# Models whose bookkeeping lives in the MjData need one each (MuJoCo's manual, "batch").
_HIDDEN_STATE = int(mujoco.mjtEnableBit.mjENBL_SLEEP) | int(mujoco.mjtEnableBit.mjENBL_IPC)


class CpuEngine:
    """N simulations of one model on a pool of threads.

    Args:
        model: The compiled scene; the batch keeps its own copy.
        num_envs: N.
        num_threads: Physics threads; 0 is every core this process may run on.
        persistent: One MjData per environment (True) or per thread (False). A thread's stays in
            its cache, which makes steps up to 15 % faster, and a look at poses computes those
            alone; an environment's own continues from the stages that a look has computed. None is
            False, unless the model needs the former. No byte of a step depends on it.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        num_threads: int = 0,
        persistent: bool | None = None,
    ) -> None:
        install_log_handler()
        stop_timers()
        threads = num_threads or len(os.sched_getaffinity(0))
        hidden = bool(model.opt.enableflags & _HIDDEN_STATE) or model.nplugin > 0
        self.model = model
        self.num_envs = num_envs
        self.num_threads = min(threads, num_envs)
        self.persistent = hidden if persistent is None else persistent
        self.listeners: list[EngineListener] = []
        self._layout = row_layout(model)
        self._plain_reset = not hidden
        self._batch = mjbatch.Batch(
            model, num_envs, nthread=self.num_threads, persistent=self.persistent
        )
        self._batch.reset(stage=_STAGE_NONE)
        self._rows: F64 = self._batch.state
        self._views: dict[str, F64] = {
            name: self._rows[:, cols] for name, cols in self._layout.items()
        }
        self._revisions = dict.fromkeys(self._layout, 0)
        self._revision = 0  # of all components
        resets = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.steps_write_inputs = resets or model.nplugin > 0
        self._fields = ModelFields(self._batch, num_envs)
        self._default_row: F64 = self._rows[0].copy()
        self._derived: dict[str, F64] = {}
        self._kinematics = Kinematics()
        self._acc = AccelerationFields()
        self._dirty = np.ones(num_envs, np.bool_)
        self._any_dirty = True
        self._all_dirty = True
        self._divergence = Divergence(self._batch)
        self._pool = Pool(self._batch)

    # -- reads ---------------------------------------------------------------------------------

    @property
    def rows(self) -> F64:
        """(N, nstate) live integration-state rows. Do not write."""
        return self._rows

    def component(self, name: str) -> slice:
        """Columns of a state component within a row; KeyError names the ones that exist."""
        try:
            return self._layout[name]
        except KeyError:
            raise KeyError(
                f"no state component {name!r}; there are {', '.join(self._layout)}."
                f"{did_you_mean(name, self._layout)}"
            ) from None

    def state(self, name: str) -> F64:
        """(N, width) live view of a state component, flattened. Read only."""
        return self._views[name]

    def revision(self, name: str) -> int:
        """A number that is another one when a state component was changed outside physics.

        Also after a step that may have changed what physics only reads.
        """
        return self._revision + self._revisions[name]

    def derived(self, name: str) -> F64:
        """(N, ...) position- or velocity-stage field, fresh for every environment."""
        if name not in self._derived:
            self._derived[name] = self._batch.bind(name)
            self._kinematics.need(name)
            self._any_dirty = self._all_dirty = True
        if self._any_dirty:
            self._refresh()
        return self._derived[name]

    def _refresh(self) -> None:
        if self._fields.stale:
            self._set_const_now()
        ids = None if self._all_dirty else np.flatnonzero(self._dirty)
        self._acc.keep()
        if self._kinematics.enough and not self.persistent:
            flags = self._fields.own("opt.disableflags")
            self._call(self._kinematics.forward, self._batch, flags, ids)
        else:
            self._call(self._batch.forward, ids, stage=_STAGE_VEL)
        self._dirty[:] = False
        self._any_dirty = self._all_dirty = False

    def acceleration(self, name: str) -> F64:
        """(N, ...) acceleration-stage field as of the last physics step or full forward.

        The first request for a field computes it at the current state.
        """
        found = self._acc.get(name)
        return self._first_acceleration(name) if found is None else found

    def acceleration_now(self, name: str) -> F64:
        """The same, good only until the engine is asked for anything else: saves a copy."""
        found = self._acc.now.get(name)
        return self._first_acceleration(name) if found is None else found

    def _first_acceleration(self, name: str) -> F64:
        if self._fields.stale:
            self._set_const_now()
        self._acc.keep()
        output = self._batch.bind(name)
        self._call(self._batch.forward, None, stage=_STAGE_ACC)
        self._acc.add(name, output)
        return self._acc.now[name]

    # -- physics -------------------------------------------------------------------------------

    def step(self, nstep: int, env_ids: EnvIndex | None = None) -> None:
        """Advance physics by ``nstep`` steps of the model's timestep."""
        if self._fields.stale:
            self._set_const_now()
        listeners = self.listeners
        if listeners:
            event = PhysicsEvent("before", nstep, env_ids, self._rows)
            for listener in listeners:
                listener.on_physics(event)
        if env_ids is not None:
            self._acc.keep()
        self._pool.began()
        failed = self._call(self._batch.step, env_ids, nstep=nstep, stage=_STAGE_NONE)
        self._pool.ended()
        self._revision += self.steps_write_inputs
        if env_ids is None:
            self._any_dirty = self._all_dirty = True
        else:
            self._mark(env_ids)
        self._acc.took(env_ids)
        if listeners:
            event = PhysicsEvent("after", nstep, env_ids, self._rows, failed)
            for listener in listeners:
                listener.on_physics(event)

    def stay_awake(self) -> None:
        """Keep threads from falling asleep between two steps, if these follow at once.

        Not where fields are looked at between steps, which asks them anyway, nor where a listener
        has work for other cores.
        """
        if not (self._derived or self.listeners or self.persistent) and self._pool.sleeps_soon():
            self._acc.keep()
            self._pool.ask()

    def forward(self, env_ids: EnvIndex | None = None) -> None:
        """Compute every stage without stepping, the acceleration fields' too."""
        if self._fields.stale:
            self._set_const_now()
        if env_ids is not None:
            self._acc.keep()
        self._call(self._batch.forward, env_ids, stage=_STAGE_ACC)
        self._acc.took(env_ids)
        if env_ids is None:
            self._dirty[:] = False
            self._any_dirty = self._all_dirty = False
        elif not self._all_dirty:
            self._dirty[env_ids] = False
            self._any_dirty = bool(self._dirty.any())
        self._notify(Write("forward", "", env_ids, slice(None), None))

    def _call(self, function: Any, *args: Any, **kwargs: int) -> EnvIndex | None:
        """Run a batch call; remember and return the environments in which MuJoCo raised."""
        try:
            function(*args, **kwargs)
        except mjbatch.SimulationError as error:
            failed = np.asarray(error.ids, np.int64)
            self._divergence.failed(failed)
            return failed
        return None

    def reset(self, env_ids: EnvIndex | None = None) -> None:
        """Give rows MuJoCo's reset state and clear their warning counters."""
        rows: Any = slice(None) if env_ids is None else env_ids
        if self._plain_reset and self._fields.resets_alike:
            # What `Batch.reset` leaves in a row, without loading every simulation's MjData: a
            # hundredth of the time.
            self._rows[rows] = self._default_row
            self._batch.warning[rows] = 0
        else:
            self._acc.keep()
            self._batch.reset(env_ids, stage=_STAGE_NONE)
        self._revision += 1
        self._mark(env_ids)
        self._divergence.forget(rows)
        self._notify(Write("reset", "row", env_ids, slice(None), None))

    def take_diverged(self) -> NDArray[np.bool_] | None:
        """(N,) mask of environments that diverged since the last call, or None for nobody."""
        return self._divergence.take()

    # -- writes --------------------------------------------------------------------------------

    def write(
        self,
        field: str,
        values: Any,
        env_ids: EnvIndex | None = None,
        columns: NDArray[np.int64] | slice = slice(None),
    ) -> None:
        """Set columns of a state component.

        Args:
            field: The component (``qpos``, ``ctrl``, ``mocap_pos``...), or ``row`` for whole rows.
            values: Broadcasts to (n, k); kept by nobody.
            env_ids: (n,) sorted unique environments, or None for all.
            columns: (k,) columns within the component, or a slice of them.
        """
        if field == "row":
            view = self._rows
            self._revision += 1
        else:
            view = self._views[field]
            self._revisions[field] += 1
        if env_ids is None:
            view[:, columns] = values
        else:
            view[where(env_ids, columns)] = values
        if not self._all_dirty and field not in _INPUTS:
            self._mark(env_ids)
        if self.listeners:
            taken = left(view, values, env_ids, columns)
            self._notify(Write("state", field, env_ids, columns, taken))

    def write_model(
        self,
        field: str,
        values: Any,
        env_ids: EnvIndex | None = None,
        columns: NDArray[np.int64] | slice = slice(None),
    ) -> None:
        """Set columns of a flattened model field per environment; see `set_const`.

        Args:
            field: An `MjModel` field or ``opt.NAME``, one of `mujoco.batch.MODEL_FIELDS`.
            values: Broadcasts to (n, k).
            env_ids: (n,) sorted unique environments, or None for all.
            columns: (k,) columns within the flattened field, or a slice of them.

        Raises:
            ValueError: If the field cannot differ between environments.
        """
        fields = self._fields
        if fields.stale and fields.is_derived(field):
            self._set_const_now()  # it must not undo this write
        if field == "opt.disableflags":
            self.steps_write_inputs = True
        view = fields.view(field)
        view[where(env_ids, columns)] = values
        self._mark(env_ids)
        if self.listeners:
            self._notify(Write("model", field, env_ids, columns, picked(view, env_ids, columns)))

    def model_field(self, field: str) -> NDArray[Any]:
        """(N, size) flattened per-environment values of a model field. Do not write."""
        fields = self._fields
        if fields.stale and fields.is_derived(field):
            self._set_const_now()
        return fields.view(field)

    def set_const(self, env_ids: EnvIndex | None = None) -> None:
        """Recompute the constants MuJoCo derives from model fields, at once."""
        self._acc.keep()
        self._call(self._batch.set_const, env_ids)
        self._mark(env_ids)
        self._notify(Write("set_const", "", env_ids, slice(None), None))

    def set_const_later(self, env_ids: EnvIndex | None = None) -> None:
        """Recompute constants before anybody can see them: once for all writes until then."""
        self._fields.mark(env_ids)
        self._mark(env_ids)

    def _set_const_now(self) -> None:
        self.set_const(self._fields.take_stale())

    def _mark(self, env_ids: EnvIndex | None) -> None:
        self._any_dirty = True
        if env_ids is None:
            self._all_dirty = True
        elif not self._all_dirty:
            self._dirty[env_ids] = True

    def _notify(self, write: Write) -> None:
        for listener in self.listeners:
            listener.on_write(write)

    # -- whole simulations -----------------------------------------------------------------------

    def model_of(self, env_id: int) -> mujoco.MjModel:
        """A copy of one environment's model, its own field values included."""
        if self._fields.stale:
            self._set_const_now()
        return self._batch.get_model(env_id)

    def data_of(self, env_id: int) -> mujoco.MjData:
        """One environment as an MjData: derived fields computed, its model with its own values."""
        model = self.model_of(env_id) if self._fields.any else self.model
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, self._rows[env_id], mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(model, data)
        return data

    def model_fields(self) -> dict[str, NDArray[Any]]:
        """Per-environment model fields as they are (copies); constants may be out of date."""
        return {k: np.array(v) for k, v in self._fields.expanded().items()}

    def state_dict(self) -> dict[str, Any]:
        """Rows, per-environment model fields, counters and acceleration fields (copies)."""
        if self._fields.stale:
            self._set_const_now()
        return {
            "rows": self._rows.copy(),
            "model": self.model_fields(),
            "warning": self._batch.warning.copy(),
            "acceleration": self._acc.copies(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue exactly where `state_dict` was taken."""
        fields, model = self._fields, state["model"]
        fields.take_stale()
        for field in fields.expanded().keys() - model.keys():
            self.write_model(field, fields.default(field))
        for again in range(2 if DERIVED_FIELDS & model.keys() else 1):
            if again:
                self.set_const()  # for flags of the model that are no fields
            for field, values in model.items():
                self.write_model(field, values.reshape(self.num_envs, -1))
        self.write("row", state["rows"])
        for field, values in state["acceleration"].items():
            self.acceleration(field)
            self._acc.restore(field, values)
        # Counters are restored as a baseline: only new warnings count as divergence.
        self._divergence.begin()

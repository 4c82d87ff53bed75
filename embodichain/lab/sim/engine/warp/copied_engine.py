"""`CopiedEngine`: states and model fields of a `DeviceEngine` on the host, as they were recently.

Importing this module imports Warp (extra ``gpu``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import ALL, EnvIndex, PhysicsEvent, Write
from embodichain.lab.sim.engine.cpu.cpu_engine import HostEngine
from embodichain.lab.sim.engine.device.device_values import HostTransferError
from embodichain.lab.sim.engine.fields import DERIVED_FIELDS
from embodichain.utils.array_types import EnvIds

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.warp.device_engine import DeviceEngine

__all__ = ["CopiedEngine"]

_LAST = ("ctrl", "qfrc_applied", "xfrc_applied")
"""What actions write, after all else that happens before physics; written as a whole."""
_BITS = {1: np.uint8, 4: np.uint32, 8: np.uint64}

States = Mapping[str, NDArray[Any]]
"""State component -> (N, width) numbers."""


class CopiedEngine(HostEngine):
    """Rows and model fields as `HostEngine` has them, from copies; it computes no physics.

    Its listeners are told what differs between a copy and the one before, as writes: of several
    writes between two copies they see the result. Numbers are those of the device, which float64
    represents. Derived constants are computed on the host from the fields.

    Args:
        engine: What is copied: its present state, waiting for the device.
    """

    reports_writes = False

    def __init__(self, engine: DeviceEngine) -> None:
        super().__init__(engine.model, engine.num_envs, engine.num_threads, False)
        self.name = engine.name
        self._rows[...] = engine.host_rows()
        fields = engine.model_fields()
        self._write_model_fields(fields)
        if DERIVED_FIELDS & fields.keys():
            self.set_const()  # as in `load_state_dict`
            self._write_model_fields(fields)
        self._latest: dict[str, NDArray[Any]] = {}

    # -- what only the device computes -------------------------------------------------------------

    def derived(self, name: str) -> NoReturn:
        """Refuse."""
        self._refuse(f"the field {name}")

    acceleration = derived

    def cast_rays(self, *args: Any, **kwargs: Any) -> NoReturn:
        """Refuse."""
        self._refuse("intersections of rays")

    def step(self, nstep: int, env_ids: EnvIndex | None = None) -> NoReturn:
        """Refuse."""
        self._refuse("physics")

    def forward(self, env_ids: EnvIndex | None = None) -> NoReturn:
        """Refuse."""
        self._refuse("derived fields")

    def _refuse(self, what: str) -> NoReturn:
        raise HostTransferError(f"a copy of states has not {what}: use sim.warp.arrays=host")

    # -- copies ------------------------------------------------------------------------------------

    def put_states(self, states: States) -> None:
        """Apply state components that may have been written, as writes of what differs."""
        for name in sorted(states, key=lambda name: name in _LAST):
            env_ids = self._store_changes(name, states[name])
            if not len(env_ids):
                continue
            if name in _LAST or 2 * len(env_ids) > self.num_envs:
                self._write(name, states[name], None)
            else:
                self._write(name, states[name][env_ids], env_ids)

    def _write(self, name: str, values: NDArray[Any], env_ids: EnvIndex | None) -> None:
        self.write(name, values.astype(np.float64), env_ids)

    def _store_changes(self, name: str, new: NDArray[Any]) -> EnvIds:
        """Store a component; return environments (n,) in which it has other bits than before."""
        old = self._latest.get(name)
        self._latest[name] = new
        if old is not None and old.dtype == new.dtype:
            bits = _BITS[new.dtype.itemsize]
            if old.tobytes() == new.tobytes():
                return np.zeros(0, np.int64)
            differs = old.view(bits) != new.view(bits)
        else:
            row_values = np.ascontiguousarray(self._views[name])
            differs = row_values.view(np.uint64) != new.astype(np.float64).view(np.uint64)
        return np.flatnonzero(differs.any(axis=1))

    def put_reset(self, env_ids: EnvIndex, states: States) -> None:
        """Set the rows of environments that were reset.

        Args:
            env_ids: (n,) environments.
            states: Components of all N after the reset, those that were written.
        """
        if not len(env_ids):
            return
        for name, values in states.items():
            latest = self._latest.get(name)
            if latest is None:
                latest = self._views[name].astype(values.dtype)
                self._latest[name] = latest
            latest[env_ids] = values[env_ids]
            self._views[name][env_ids] = values[env_ids]
        self._notify(Write("reset", "row", env_ids, ALL, None))

    def put_physics(self, nstep: int, states: States) -> None:
        """Set what physics steps have written.

        Args:
            nstep: Physics steps.
            states: The components that physics writes, after it.
        """
        self._tell("before", nstep)
        for name, values in states.items():
            self._latest[name] = values
            self._views[name][...] = values
        self._tell("after", nstep)

    def _tell(self, phase: Any, nstep: int) -> None:
        for listener in self.listeners:
            listener.on_physics(PhysicsEvent(phase, nstep, None, self._rows))

    def put_fields(self, fields: States, constants: bool) -> None:
        """Apply model fields that may have been written, as writes of what differs.

        Args:
            fields: Name -> (N, size) values, rounded to the device's type of numbers.
            constants: Whether derived constants were computed from them.
        """
        changed = np.zeros(self.num_envs, np.bool_)
        for name, new in fields.items():
            differs = self._fields.view(name).astype(new.dtype) != new
            rows = np.flatnonzero(differs.any(axis=1))
            columns = np.flatnonzero(differs.any(axis=0))
            if len(rows):
                changed[rows] = True
                is_all = len(rows) == self.num_envs
                values = new[np.ix_(rows, columns)].astype(np.float64)
                self.write_model(name, values, None if is_all else rows, columns)
        if constants and changed.any():
            self.set_const(None if changed.all() else np.flatnonzero(changed))

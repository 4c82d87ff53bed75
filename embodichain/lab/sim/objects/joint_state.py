"""Positions, velocities, efforts and position limits of an articulation's joints."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.objects._arrays import Columns, columns_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.base import F64, EnvIndex
    from embodichain.lab.sim.host import Binding

__all__ = ["JointLimits", "JointState"]


class JointState:
    """Reads of D joints in N environments: (N, D) float64, live views or copies; do not write.

    Args:
        binding: The articulation's place in the simulation.
        width: D.
    """

    def __init__(self, binding: Binding[EntityIndex], width: int) -> None:
        self._binding = binding
        self._width = width
        self.qpos_columns: Columns = slice(0)
        self.dofs: Columns = slice(0)
        # Efforts that were set by hand since the last physics step: (N, D), None if there are none.
        self._set: NDArray[np.bool_] | None = None
        self._set_at: F64 = np.zeros(0)  # (N,) simulated seconds

    def bind(self) -> None:
        """Look up the columns of the joints; called once the scene is compiled."""
        index = self._binding.index
        self.qpos_columns = columns_of(index.qpos_adr)
        self.dofs = columns_of(index.dof_adr)
        # The first request of an acceleration field computes it anew, so it is made here.
        self._binding.engine.acceleration("qfrc_actuator")

    def qpos(self) -> F64:
        """(N, D) rad or m."""
        engine = self._binding.engine
        return engine.state("qpos")[:, self.qpos_columns]

    def qvel(self) -> F64:
        """(N, D) rad/s or m/s."""
        engine = self._binding.engine
        return engine.state("qvel")[:, self.dofs]

    def qacc(self) -> F64:
        """(N, D) rad/s^2 or m/s^2 of the last physics step."""
        engine = self._binding.engine
        return engine.acceleration("qacc")[:, self.dofs]

    def qf(self) -> F64:
        """(N, D) drive effort of the last physics step, N m or N, without passive damping."""
        engine = self._binding.engine
        return engine.acceleration("qfrc_actuator")[:, self.dofs]

    def efforts(self) -> F64:
        """(N, D) `qf`; an effort that was set since the last physics step has that value."""
        efforts = self.qf()
        marks = self._marks()
        if marks is None:
            return efforts
        applied = self._binding.engine.state("qfrc_applied")[:, self.dofs]
        return np.where(marks, applied, efforts)

    def set_efforts(self, values: F64, joints: NDArray[np.int64], ids: EnvIndex | None) -> None:
        """Apply efforts (n, k) beside the drives, until they are overwritten or reset."""
        engine, index = self._binding.engine, self._binding.index
        engine.write("qfrc_applied", values, ids, np.asarray(index.dof_adr, np.int64)[joints])
        marks, count = self._marks(), self._binding.num_envs
        if marks is None:
            marks = np.zeros((count, self._width), np.bool_)
        marks[np.ix_(np.arange(count) if ids is None else ids, joints)] = True
        self._set, self._set_at = marks, self._time().copy()

    def forget_efforts(self, ids: EnvIndex | None) -> None:
        """Note that a reset has cleared the efforts of environments (n,), or of all."""
        if self._set is not None:
            self._set[slice(None) if ids is None else ids] = False

    def _time(self) -> F64:
        return self._binding.engine.state("time").reshape(-1)

    def _marks(self) -> NDArray[np.bool_] | None:
        """Efforts set in environments whose time has not advanced since."""
        if self._set is not None:
            self._set &= (self._time() == self._set_at)[:, None]
            if not self._set.any():
                self._set = None
        return self._set


class JointLimits:
    """Position limits of D joints in N environments, rad or m; infinite where there are none.

    Args:
        compiled: (D, 2) lower and upper limits that all environments begin with.
        count: N.

    Attributes:
        compiled: (D, 2).
    """

    def __init__(self, compiled: F64, count: int) -> None:
        self.compiled = compiled
        self._count = count
        self._low, self._high = compiled.T.copy()
        self._own: F64 | None = None  # (N, D, 2), once an environment has limits of its own

    @property
    def values(self) -> F64:
        """(N, D, 2); do not write."""
        shape = (self._count, *self.compiled.shape)
        return np.broadcast_to(self.compiled, shape) if self._own is None else self._own

    def of(self, joints: NDArray[np.int64], ids: EnvIndex | None) -> tuple[F64, F64]:
        """Lower and upper limits of joints (k,) in environments (n,): (k,) each, or (n, k)."""
        if self._own is None:
            return self._low[joints], self._high[joints]
        rows = slice(None) if ids is None else ids[:, None]
        picked = self._own[rows, joints]
        return picked[..., 0], picked[..., 1]

    def clamp(self, values: F64, joints: NDArray[np.int64], ids: EnvIndex | None) -> F64:
        """Return positions (n, k) of joints, moved into their limits."""
        low, high = self.of(joints, ids)
        return np.minimum(np.maximum(values, low), high)

    def set(
        self,
        side: Literal[0, 1],
        values: F64,
        joints: NDArray[np.int64],
        ids: EnvIndex | None,
    ) -> None:
        """Give environments limits of their own: (n, k) lower (0) or upper (1) ones."""
        if self._own is None:
            self._own = self.values.copy()
        self._own[(slice(None) if ids is None else ids[:, None], joints, side)] = values

    def restore(self, values: F64) -> None:
        """Take over (N, D, 2) limits."""
        same = bool((values == self.compiled).all())
        self._own = None if same else values.copy()

"""`JointLimits`: lower and upper joint positions, shared until an environment has its own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["JointLimits"]


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

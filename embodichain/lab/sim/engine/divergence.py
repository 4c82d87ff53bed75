"""`Divergence`: which environments have diverged since the last call."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from mujoco import batch as mjbatch
from numpy.typing import NDArray

from embodichain.lab.sim.engine.base import EnvIndex

__all__ = ["Divergence"]

# Counters that mean the state is no longer physics.
_DIVERGED = [
    int(getattr(mujoco.mjtWarning, f"mjWARN_{name}"))
    for name in ("BADQPOS", "BADQVEL", "BADQACC", "BADCTRL", "CONTACTFULL", "CNSTRFULL")
]


class Divergence:
    """Compares MuJoCo's warning counters of a batch, and stores where MuJoCo raised.

    Args:
        batch: The batch; its counters now are the baseline.
    """

    def __init__(self, batch: mjbatch.Batch) -> None:
        self._warning: NDArray[np.int32] = batch.warning
        self._numbers: NDArray[np.int32] = batch.warning[:, :, 1]
        self.begin()

    def begin(self) -> None:
        """Take the warnings so far as the baseline: only new ones count."""
        self._counts: NDArray[np.int32] = self._numbers[:, _DIVERGED].copy()
        self._warned = self._warning.tobytes()
        self._failed: NDArray[np.bool_] | None = None

    def failed(self, env_ids: EnvIndex) -> None:
        """Remember environments (n,) in which MuJoCo raised."""
        if self._failed is None:
            self._failed = np.zeros(len(self._warning), np.bool_)
        self._failed[env_ids] = True

    def forget(self, rows: Any) -> None:
        """Begin anew where environments were reset: their indices, or a slice."""
        self._counts[rows] = self._numbers[:, _DIVERGED][rows]
        self._warned = self._warning.tobytes()
        if self._failed is not None:
            self._failed[rows] = False

    def take(self) -> NDArray[np.bool_] | None:
        """(N,) mask of environments that diverged since the last call, or None."""
        warned = self._warning.tobytes()  # compared as a whole: a tenth of a sum's time
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

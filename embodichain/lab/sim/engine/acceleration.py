"""`AccelerationFields`: what the last physics step computed, whatever the batch computes besides.

A call of the batch writes its outputs for every environment that it is for, so a look at poses
leaves nothing of the step's. Copying them after every step would cost more than reading them.
"""

from __future__ import annotations

import numpy as np

from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["AccelerationFields"]


class AccelerationFields:
    """Outputs of a batch as of the last step or full forward, copied only when that is needed.

    Whoever calls the batch says so: `keep` before a call that computes something else or is for
    some environments only, and `took` after a step or a full forward.

    Attributes:
        now: Name -> (N, ...), good until the batch is called again. Do not write.
    """

    def __init__(self) -> None:
        self._outputs: dict[str, F64] = {}
        self._kept: dict[str, F64] = {}
        self.now = self._kept

    def add(self, name: str, output: F64) -> None:
        """Look after one more output from now on; what was there before it must be kept."""
        self._outputs[name] = output
        self._kept[name] = output.copy()

    def keep(self) -> None:
        """Copy what the next call of the batch would overwrite."""
        if self.now is self._outputs:
            self.now = self._kept
            for name, output in self._outputs.items():
                np.copyto(self._kept[name], output)

    def took(self, env_ids: EnvIndex | None) -> None:
        """Take what the batch has just computed for these environments, or for all of them."""
        if env_ids is None:
            self.now = self._outputs
            return
        for name, output in self._outputs.items():
            self._kept[name][env_ids] = output[env_ids]

    def get(self, name: str) -> F64 | None:
        """(N, ...) a field, good until the next step or full forward; None if it is not here."""
        self.keep()
        return self._kept.get(name)

    def copies(self) -> dict[str, F64]:
        """All of them, by name."""
        self.keep()
        return {name: kept.copy() for name, kept in self._kept.items()}

    def restore(self, name: str, values: F64) -> None:
        """Give a field that is here other values."""
        self.keep()
        self._kept[name][...] = values

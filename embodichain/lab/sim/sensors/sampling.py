"""`Sampler`: readings of a sensor, of the current state or taken at a rate."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.api import Engine, EnvIndex

__all__ = ["Readings", "Sampler"]

Readings = tuple[NDArray[Any], ...]
"""Arrays (N, ...) that a sensor measures together."""

_TOLERANCE = 1e-6
"""Periods: MuJoCo's time is a sum of steps, so that a multiple of the period may be just missed."""


class Sampler:
    """Readings of a sensor in N environments; measured only when they are read and due.

    Without a rate, readings are of the current state. With a rate, an environment keeps its
    readings until the next multiple of 1 / rate of its simulated time; the first read at or after
    it measures again, as does the first read after a reset. Another read at the time of a
    measurement is of the state at that moment: writes at that time are included.

    Args:
        engine: The engine.
        measure: Takes (n,) environments, or None for all, and returns arrays (n, ...); they may be
            live views, which are valid until the engine's `version` changes.
        rate: Hz of simulated time; None is no rate.
    """

    def __init__(
        self, engine: Engine, measure: Callable[[EnvIndex | None], Readings], rate: float | None
    ) -> None:
        self._engine = engine
        self._measure = measure
        self._rate = rate
        self._version = -1
        self._readings: Readings = ()
        self._taken = np.full(engine.num_envs, np.inf)

    def read(self) -> Readings:
        """Return arrays (N, ...): do not write or store."""
        version = self._engine.version
        if self._version != version:
            if self._rate is None:
                self._readings = self._measure(None)
            else:
                self._sample(self._rate)
            self._version = version
        return self._readings

    def _sample(self, rate: float) -> None:
        """Measure the environments that are due."""
        time = self._engine.state("time")[:, 0]
        period = np.floor(time * rate + _TOLERANCE)
        # The time of no measurement is infinite.
        kept = (self._taken < time) & (np.floor(self._taken * rate + _TOLERANCE) == period)
        if not kept.any():
            self._readings = tuple(part.copy() for part in self._measure(None))
            self._taken[:] = time
        elif not kept.all():
            due = np.flatnonzero(~kept)
            for part, measured in zip(self._readings, self._measure(due), strict=True):
                part[due] = measured
            self._taken[due] = time[due]

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Make these environments (None: all) measure at the next read."""
        self._taken[slice(None) if env_ids is None else env_ids] = np.nan
        self._version = -1

    def state_dict(self) -> dict[str, Any]:
        """The readings and their times (copies); empty without a rate."""
        if self._rate is None:
            return {}
        return {"taken": self._taken.copy(), "readings": [part.copy() for part in self._readings]}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self.reset(None)
        if state:
            self._taken[:] = state["taken"]
            self._readings = tuple(part.copy() for part in state["readings"])

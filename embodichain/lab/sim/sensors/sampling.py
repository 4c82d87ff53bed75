"""`Sampler`: readings of a sensor, of the current state or taken at a rate."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.utils.arrays import may_be_set

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.api import Engine, EnvIndex
    from embodichain.utils.arrays import Arrays

__all__ = ["Readings", "Sampler"]

Readings = tuple[NDArray[Any], ...]
"""Arrays (N, ...) that a sensor measures together."""

_TOLERANCE = 1e-6
"""Periods: MuJoCo's time is a sum of steps, so that a multiple of the period may be just missed."""


class Sampler:
    """Readings of a sensor in N environments; measured only when they are read and due.

    Without a rate, readings are of the current state. With a rate, an environment keeps its
    readings until the next multiple of 1 / rate of its simulated time; the first read at or after
    it measures again, as does the first read after a reset. If something is written after a
    measurement, at the same simulated time, a further read measures again.

    Args:
        engine: The engine.
        arrays: Makes the arrays.
        measure: Takes (n,) environments, or None for all, and returns arrays (n, ...); they may be
            live views, which are valid until the engine's `version` changes.
        rate: Hz of simulated time; None means no rate.
        of_positions: Whether readings follow from positions and the model alone, and `measure`
            returns new arrays. Environments in which these have not changed are then not measured
            again: after a reset, only those that were reset. On a device all are measured.
    """

    def __init__(
        self,
        engine: Engine,
        arrays: Arrays,
        measure: Callable[[EnvIndex | None], Readings],
        rate: float | None,
        of_positions: bool = False,
    ) -> None:
        self._engine = engine
        self._arrays = arrays
        self._measure = measure
        self._rate = rate
        self._of_positions = of_positions and not arrays.on_device
        self._version = -1
        self._readings: Readings = ()
        self._times = arrays.full(engine.num_envs, np.inf)
        self._versions = arrays.full(engine.num_envs, -1, np.int64)

    def read(self) -> Readings:
        """Return arrays (N, ...): do not write or store."""
        version = self._engine.version
        if self._version != version:
            if self._rate is None and not self._of_positions:
                self._readings = self._measure(None)
            else:
                self._measure_due(version)
            self._version = version
        return self._readings

    def _measure_due(self, version: int) -> None:
        """Measure the environments that are due."""
        time = self._engine.state("time")[:, 0]
        is_current = self._is_current(time)
        if not (self._readings and may_be_set(is_current)):
            measured = self._measure(None)
            copied = tuple(part.copy() for part in measured)
            self._readings = measured if self._of_positions else copied
        elif may_be_set(~is_current):
            due = self._arrays.where(~is_current)
            readings = tuple(part.copy() for part in self._readings)
            for part, new in zip(readings, self._measure(due), strict=True):
                part[due] = new
            self._readings = readings
        self._times = np.where(is_current, self._times, time)
        self._versions[~is_current] = version

    def _is_current(self, time: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(N,) environments that keep their readings."""
        is_current: NDArray[np.bool_] = np.zeros_like(time, np.bool_)
        if self._of_positions:
            is_current |= self._engine.versions <= self._versions
        if self._rate is not None:
            # Where it was never measured, the time is infinite, so this is False.
            period = np.floor(time * self._rate + _TOLERANCE)
            last_period = np.floor(self._times * self._rate + _TOLERANCE)
            is_current |= (self._times < time) & (last_period == period)
        return is_current

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Make these environments (None: all) measure at the next read."""
        where = slice(None) if env_ids is None else env_ids
        self._times[where] = np.inf
        self._versions[where] = -1
        self._version = -1

    def state_dict(self) -> dict[str, Any]:
        """The readings and their times (copies); empty without a rate."""
        if self._rate is None:
            return {}
        return {"times": self._times.copy(), "readings": [part.copy() for part in self._readings]}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self.reset(None)
        if state:
            self._times[:] = state["times"]
            self._readings = tuple(part.copy() for part in state["readings"])

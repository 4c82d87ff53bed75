"""`SensorHistory`: the last physics steps of columns of ``sensordata``, for N environments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.engine.api import ALL, F64, EnvIndex
from embodichain.utils.arrays import may_be_set

__all__ = ["SensorHistory"]

_Key = tuple[int, int, int]


class SensorHistory:
    """Keeps what sensors measured in the last physics steps; `Engine` describes its methods.

    Args:
        num_envs: N.
        put: Copies an array of the host to where arrays are.
    """

    def __init__(self, num_envs: int, put: Callable[[NDArray[Any]], Any]) -> None:
        self._num_envs = num_envs
        self._put = put
        # Arrays are written in place: a captured step (`StepGraph`) finds them at their address.
        self._parts: dict[_Key, Any] = {}
        self._fresh = put(np.ones(num_envs, np.bool_))
        """(N,) environments without a physics step since their last `forward`."""

    def __bool__(self) -> bool:
        """Whether any columns are kept."""
        return bool(self._parts)

    def keep(self, columns: slice, depth: int) -> None:
        """Keep columns from now on.

        Args:
            columns: Columns of ``sensordata``.
            depth: Number of physics steps.
        """
        key = columns.start, columns.stop, depth
        if key not in self._parts:
            self._parts[key] = self._put(np.zeros((self._num_envs, depth, key[1] - key[0])))

    def read(self, columns: slice, depth: int, now: F64) -> F64:
        """(N, depth, k) columns in the last physics steps, the oldest first. Do not write.

        Args:
            columns: As given to `keep`.
            depth: As given to `keep`.
            now: (N, nsensordata) the present ``sensordata``: all steps of environments that have
                not stepped since their reset.
        """
        values: F64 = self._parts[columns.start, columns.stop, depth]
        if not may_be_set(self._fresh):
            return values
        return np.where(self._fresh[:, None, None], now[:, None, columns], values)

    def begin(self, env_ids: EnvIndex | None) -> None:
        """Forget the steps of environments (n,), None for all."""
        self._fresh[ALL if env_ids is None else env_ids] = True

    def append(self, steps: Sequence[F64] | F64, env_ids: EnvIndex | None) -> None:
        """Add physics steps.

        Args:
            steps: (n, s, nsensordata) ``sensordata`` in s physics steps.
            env_ids: (n,) the environments that stepped, None for all.
        """
        where: Any = ALL if env_ids is None else env_ids
        readings: Any = steps
        for (start, stop, depth), values in self._parts.items():
            new = readings[:, -depth:, start:stop]
            missing = depth - new.shape[1]
            if missing:
                # Before its first step, an environment has that step's readings.
                fresh = self._fresh[where][:, None, None]
                old = np.where(fresh, new[:, :1], values[where][:, -missing:])
                new = np.concatenate([old, new], axis=1)
            values[where] = new
        self._fresh[where] = False

    def state_dict(self) -> dict[str, Any]:
        """What is kept (copies)."""
        parts = {":".join(map(str, key)): values.copy() for key, values in self._parts.items()}
        return {"fresh": self._fresh.copy(), "parts": parts}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where `state_dict` was taken; columns that were not kept then begin anew."""
        saved = state.get("parts", {})
        keys = {":".join(map(str, key)): key for key in self._parts}
        if keys.keys() != saved.keys():
            self.begin(None)
            return
        self._fresh[...] = self._put(state["fresh"])
        for name, key in keys.items():
            self._parts[key][...] = self._put(saved[name])

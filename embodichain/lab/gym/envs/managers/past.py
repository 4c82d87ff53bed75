"""`Past`: the last values of an observation; `Delay`: the value of some steps ago."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.base import EnvIndex
    from embodichain.utils.random import RandomStreams

__all__ = ["Delay", "Past", "Rows"]


@dataclass(frozen=True, slots=True)
class Rows:
    """Which environments an observation is of.

    Attributes:
        stepped: (n,) environments that stepped or were reset, or None for all; empty for an
            observation between two steps.
        fresh: (N,) bool, environments whose episode has no earlier observation, or None.
    """

    stepped: EnvIndex | None
    fresh: NDArray[np.bool_] | None


class Past:
    """The last values of each environment, the oldest first.

    Args:
        num_envs: N.
        depth: Number of values.

    Attributes:
        values: (N, depth, ...), None before the first value.
    """

    def __init__(self, num_envs: int, depth: int) -> None:
        self._num_envs = num_envs
        self._depth = depth
        self.values: NDArray[Any] | None = None

    def append(
        self, value: NDArray[Any], rows: Rows, before: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """Append a value where environments stepped.

        Args:
            value: (N, ...), left as it is.
            rows: Environments that did not step keep their values; for fresh ones all values but
                the last are `before`.
            before: (N, ...); None is the value itself.

        Returns:
            (N, depth, ...): do not write into it.
        """
        newest = value[:, None]
        old = self.values
        if old is None:
            old = np.zeros((self._num_envs, self._depth, *value.shape[1:]), value.dtype)
        moved = np.concatenate([old[:, 1:], newest], axis=1)
        stepped = np.ones(self._num_envs, np.bool_)
        if rows.stepped is not None:
            stepped[:] = False
            stepped[rows.stepped] = True
            moved = np.where(_column(stepped, moved), moved, old)
        if rows.fresh is not None:
            filled = newest if before is None else before[:, None]
            moved = np.where(_column(rows.fresh, moved), filled, moved)
            moved[rows.fresh, -1] = value[rows.fresh]
        # An observation between two steps changes nothing that is stored.
        self.values = (
            moved if rows.stepped is None else np.where(_column(stepped, moved), moved, old)
        )
        return moved


def _column(mask: NDArray[np.bool_], like: NDArray[Any]) -> NDArray[np.bool_]:
    return mask.reshape(-1, *[1] * (like.ndim - 1))


class Delay:
    """Returns the value of some steps ago; at the beginning of an episode the one before it.

    Args:
        steps: Control steps, or [low, high]: each episode of each environment draws its own.
        stream: Name of its random stream.
        streams: The environment's random numbers.

    Attributes:
        past: The values that are still delayed.
        lag: (N,) int64 current delay in steps.
    """

    def __init__(self, steps: int | list[int], stream: str, streams: RandomStreams) -> None:
        self._low, self._high = (steps, steps) if isinstance(steps, int) else steps
        self._stream = stream
        self._streams = streams
        self.past = Past(streams.num_envs, self._high + 1)
        self.lag: NDArray[np.int64] = np.full(streams.num_envs, self._low, np.int64)
        self._rows = np.arange(streams.num_envs)

    def restart(self, env_ids: EnvIndex | None) -> None:
        """Draw the delay of a new episode; (n,) environments, or None for all."""
        if self._low == self._high:
            return
        drawn = self._streams.uniform(self._stream, (), self._low, self._high + 1, env_ids)
        # A number just below the upper bound may round up to it.
        steps = np.minimum(drawn, self._high).astype(np.int64)
        self.lag[slice(None) if env_ids is None else env_ids] = steps

    def __call__(
        self, value: NDArray[Any], rows: Rows, before: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """(N, ...) the delayed value; `before` is the one before an episode's first."""
        recent = self.past.append(value, rows, before)
        delayed: NDArray[Any] = recent[self._rows, self._high - self.lag]
        return delayed

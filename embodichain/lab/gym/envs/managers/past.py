"""`Past`: the last values of an observation, and what delays and histories make of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import torch

    from embodichain.lab.sim.engine.base import EnvIndex
    from embodichain.utils.random import RandomStreams
else:
    torch = lazy_loader.load("torch")

__all__ = ["Delay", "Past", "Rows"]


@dataclass(frozen=True, slots=True)
class Rows:
    """Which environments an observation is of.

    Attributes:
        stepped: (n,) environments that moved on, or None for all; nobody when someone only looks.
        fresh: (N,) bool, environments whose episode has no earlier observation; None is nobody.
    """

    stepped: EnvIndex | None
    fresh: NDArray[np.bool_] | None


class Past:
    """The last values of each environment, the oldest first.

    Args:
        num_envs: N.
        depth: How many.

    Attributes:
        values: (N, depth, ...), None before the first value.
    """

    def __init__(self, num_envs: int, depth: int) -> None:
        self._num_envs = num_envs
        self._depth = depth
        self.values: torch.Tensor | None = None

    def seen(self, value: torch.Tensor, rows: Rows) -> torch.Tensor:
        """Take a value in where environments stepped.

        Args:
            value: (N, ...), left as it is.
            rows: Environments that did not step keep their values; fresh ones have had this value
                all along.

        Returns:
            (N, depth, ...): do not write into it.
        """
        newest = value.unsqueeze(1)
        old = self.values
        if old is None:
            old = newest.new_zeros((self._num_envs, self._depth, *value.shape[1:]))
        moved = torch.cat([old[:, 1:], newest], dim=1)
        if rows.stepped is not None:
            stepped = torch.zeros(self._num_envs, dtype=torch.bool)
            stepped[torch.from_numpy(rows.stepped)] = True
            moved = torch.where(_column(stepped, moved), moved, old)
        if rows.fresh is not None:
            fresh = _column(torch.from_numpy(rows.fresh), moved)
            moved = torch.where(fresh, newest.expand_as(moved), moved)
        if rows.stepped is None:
            self.values = moved
        else:  # who only looks leaves no trace
            self.values = torch.where(_column(stepped, moved), moved, old)
        return moved


def _column(mask: torch.Tensor, like: torch.Tensor) -> torch.Tensor:
    return mask.reshape(-1, *[1] * (like.ndim - 1))


class Delay:
    """Hands on the value of some steps ago; at the beginning of an episode its first one.

    Args:
        steps: Control steps, or [low, high]: each episode of each environment draws its own.
        stream: Name of its random stream.
        streams: The environment's random numbers.

    Attributes:
        past: The values on their way.
        lag: (N,) int64 steps in force.
    """

    def __init__(self, steps: int | list[int], stream: str, streams: RandomStreams) -> None:
        self._low, self._high = (steps, steps) if isinstance(steps, int) else steps
        self._stream = stream
        self._streams = streams
        self.past = Past(streams.num_envs, self._high + 1)
        self.lag: NDArray[np.int64] = np.full(streams.num_envs, self._low, np.int64)
        self._rows = torch.arange(streams.num_envs)

    def restart(self, env_ids: EnvIndex | None) -> None:
        """Draw the delay of a new episode; (n,) environments, or None for all."""
        if self._low == self._high:
            return
        drawn = self._streams.uniform(self._stream, (), self._low, self._high + 1, env_ids)
        self.lag[slice(None) if env_ids is None else env_ids] = drawn.astype(np.int64)

    def __call__(self, value: torch.Tensor, rows: Rows) -> torch.Tensor:
        """(N, ...) the delayed value."""
        seen = self.past.seen(value, rows)
        if self._low == self._high:
            return seen[:, 0].clone()
        return seen[self._rows, torch.from_numpy(self._high - self.lag)]

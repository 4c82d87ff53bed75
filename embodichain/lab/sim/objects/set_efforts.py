"""`SetEfforts`: which joint efforts were set by hand since the last physics step."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["SetEfforts"]


class SetEfforts:
    """Marks (environment, joint); a mark counts while the environment's time stands still.

    Args:
        width: D joints.
    """

    def __init__(self, width: int) -> None:
        self._width = width
        self._marks: NDArray[np.bool_] | None = None  # (N, D); None: nothing is set
        self._since: F64 = np.zeros(0)  # (N,) seconds

    def mark(self, time: F64, joints: NDArray[np.int64], ids: EnvIndex | None) -> None:
        """Note that efforts were set.

        Args:
            time: (N,) seconds of simulated time.
            joints: (k,) joint indices.
            ids: (n,) environments, or None for all.
        """
        marks = self._current(time)
        if marks is None:
            marks = np.zeros((len(time), self._width), np.bool_)
        marks[np.ix_(np.arange(len(time)) if ids is None else ids, joints)] = True
        self._marks, self._since = marks, time.copy()

    def over(self, efforts: F64, applied: F64, time: F64) -> F64:
        """(N, D) efforts, with those that were set in their place."""
        marks = self._current(time)
        return efforts if marks is None else np.where(marks, applied, efforts)

    def forget(self, ids: EnvIndex | None) -> None:
        """Take marks back: a reset clears what was set."""
        if self._marks is not None:
            self._marks[slice(None) if ids is None else ids] = False

    def __bool__(self) -> bool:
        """Whether anything may be marked."""
        return self._marks is not None

    def _current(self, time: F64) -> NDArray[np.bool_] | None:
        """The marks that still count; old ones are dropped."""
        if self._marks is not None:
            self._marks &= (time == self._since)[:, None]
            if not self._marks.any():
                self._marks = None
        return self._marks

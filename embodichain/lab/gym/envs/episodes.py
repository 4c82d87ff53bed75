"""`Episodes`: counters of N environments' episodes, and how they end."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["NO_LIMIT", "Episodes"]

NO_LIMIT = 2**31 - 1
"""`max_episode_steps` of an environment whose episodes are not limited."""

Mask = NDArray[np.bool_]


class Episodes:
    """Counts steps and episodes; all arrays may be read, and are written here only.

    Args:
        num_envs: N.
        limit: Control steps after which an episode is truncated, or `NO_LIMIT`.

    Attributes:
        limit: That.
        elapsed: (N,) int32 finished control steps of the current episodes.
        ids: (N,) int64 number of the current episode, from 0; -1 before the first reset.
        success: (N,) bool whether the last step was a success.
        pending: (N,) bool environments that the next step resets instead of stepping, or None
            (autoreset mode NEXT_STEP only).
        last_action: (N, A) float64 action as last given; zeros at the start of an episode. Replaced
            and never written to: observers may store it.
        cut: (N,) bool episodes that end, as truncated, with the next step, or None.
    """

    def __init__(self, num_envs: int, limit: int) -> None:
        self.limit = limit
        self.elapsed: NDArray[np.int32] = np.zeros(num_envs, np.int32)
        self.ids: NDArray[np.int64] = np.full(num_envs, -1, np.int64)
        self.success: Mask = np.zeros(num_envs, np.bool_)
        self.pending: Mask | None = None
        self.cut: Mask | None = None
        self.last_action: NDArray[np.float64] = np.zeros((num_envs, 0))

    @property
    def begun(self) -> bool:
        """Whether every environment was reset."""
        return bool(self.ids[0] >= 0)

    def set_last_action(self, ids: NDArray[np.int64], action: Any) -> None:
        """Set the last action of environments (n,)."""
        self.last_action = self.last_action.copy()
        self.last_action[ids] = action

    def advance(self) -> None:
        """Count a control step of all environments."""
        self.elapsed += 1

    def begin(self, ids: NDArray[np.int64]) -> None:
        """Start the next episode of environments (n,)."""
        self.elapsed[ids] = 0
        self.ids[ids] += 1
        self._forget(ids)
        if self.cut is not None:
            self.cut[ids] = False

    def restore(self, ids: NDArray[np.int64], elapsed: int, episode: int) -> None:
        """Continue an episode in environments (n,)."""
        self.elapsed[ids] = elapsed
        self.ids[ids] = episode
        self._forget(ids)
        self.settle(ids)

    def _forget(self, ids: NDArray[np.int64]) -> None:
        self.success = self.success.copy()  # those handed out stay as they are
        self.success[ids] = False

    def settle(self, ids: NDArray[np.int64]) -> None:
        """Environments (n,) were reset explicitly: no reset of theirs is pending."""
        if self.pending is not None:
            self.pending[ids] = False

    def truncate(self, ids: Any) -> None:
        """End the episodes of environments with the next step."""
        if self.cut is None:
            self.cut = np.zeros_like(self.success)
        self.cut[ids] = True

    def over(self) -> Mask:
        """(N,) episodes that are truncated after this step: at the limit, or cut."""
        over: Mask = self.elapsed >= np.int32(self.limit)
        if self.cut is not None:
            over |= self.cut
            self.cut = None
        return over

    def state_dict(self) -> dict[str, Any]:
        """Return copies of everything but the limit."""
        return {
            "elapsed": self.elapsed.copy(),
            "ids": self.ids.copy(),
            "success": self.success.copy(),
            "last_action": self.last_action.copy(),
            "pending": None if self.pending is None else self.pending.copy(),
            "cut": None if self.cut is None else self.cut.copy(),
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self.elapsed, self.ids = saved["elapsed"].copy(), saved["ids"].copy()
        self.success, self.last_action = saved["success"].copy(), saved["last_action"].copy()
        self.pending = None if saved["pending"] is None else saved["pending"].copy()
        self.cut = None if saved["cut"] is None else saved["cut"].copy()

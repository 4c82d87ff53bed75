"""`Judge`: base of terms that are a number, or a yes or no, of each environment.

Rewards, metrics and terminations share one signature; such a term only says how its value comes
about; `Recalling` also remembers earlier steps. Also sums over columns in a fixed order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp import _spatial

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["Judge", "Recalling", "action_rows", "any_column", "mean", "total"]


class Judge(Term):
    """A term whose value follows from the scene alone: subclasses define `value`."""

    def value(self) -> NDArray[np.float64] | NDArray[np.bool_]:
        """(N,) float64 or bool of the current state."""
        raise NotImplementedError

    def __call__(
        self, env: TermContext, obs: Any, action: Any, info: dict[str, Any]
    ) -> torch.Tensor:
        """(N,) float32 or bool."""
        return _spatial.tensor(self.value())


def total(values: F64) -> F64:
    """Sum of the rows, (N, K) -> (N,), from the first column on; 0 where K is 0."""
    if values.shape[1] == 0:
        return np.zeros(len(values))
    found = values[:, 0]
    for column in range(1, values.shape[1]):
        found = found + values[:, column]
    return found


def mean(values: F64) -> F64:
    """Mean of the rows, (N, K) -> (N,), summed in the order of the columns."""
    found: F64 = total(values) / max(values.shape[1], 1)
    return found


def any_column(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether a row holds a True, (N, K) -> (N,)."""
    return np.asarray(mask.any(axis=1))


def action_rows(action: Any) -> F64:
    """(N, A) float64 copy of the action that rewards see.

    Raises:
        TypeError: If it is no tensor: a `TensorDict` has no order of its own.
    """
    if not hasattr(action, "detach") or not hasattr(action, "ndim"):
        raise TypeError(f"this term needs an action tensor, got {type(action).__name__}")
    rows: F64 = action.detach().numpy().astype(np.float64)
    return rows


class Recalling(Judge):
    """A term that needs what it saw in earlier steps of the episode.

    Args:
        num_envs: N.
        depth: How many steps back.

    Attributes:
        calls: (N,) int64 steps seen in this episode, the current one included.
    """

    def __init__(self, num_envs: int, depth: int = 1) -> None:
        self.calls: NDArray[np.int64] = np.zeros(num_envs, np.int64)
        self._rows: list[F64] = []
        self._depth = depth

    def recall(self, rows: F64) -> list[F64]:
        """Keep a copy of this step's rows (N, K), and return those of the steps before.

        The last one first; they mean something where `calls` is then above 1, above 2...
        """
        rows = rows.copy()
        before = self._rows or [rows] * self._depth
        self._rows = [rows, *before[: self._depth - 1]]
        self.calls = self.calls + 1
        return before

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Forget the steps of these environments."""
        self.calls = self.calls.copy()
        self.calls[slice(None) if env_ids is None else env_ids] = 0

    def state_dict(self) -> dict[str, Any]:
        """Everything kept (copies)."""
        return {"calls": self.calls.copy(), "rows": [rows.copy() for rows in self._rows]}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self.calls = state["calls"].copy()
        self._rows = [rows.copy() for rows in state["rows"]]

"""`ActionPipeline`: the delay and the noise between an action and its term.

An action without either never comes here. Before physics nothing is "only looked at": every call is
a step of all environments.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np

from embodichain.lab.gym.envs.cfg import ActionTermCfg
from embodichain.lab.gym.envs.managers.noise import Noise

if TYPE_CHECKING:
    import torch
    from numpy.typing import NDArray

    from embodichain.lab.sim.engine.base import F64, EnvIndex
    from embodichain.utils.random import RandomStreams
else:
    torch = lazy_loader.load("torch")

__all__ = ["ActionPipeline"]


class ActionPipeline:
    """Delays the actions of one term by whole control steps, then adds noise.

    With a delay of d steps the term receives the action of d steps ago; in the first d steps of an
    episode, when none has arrived, the one that changes nothing (`ActionTerm.hold`).

    Args:
        name: The term's name.
        cfg: Its declaration.
        width: Its columns A.
        streams: Where random numbers come from: each environment draws its own, the delay once an
            episode, the noise in every step.

    Attributes:
        hold: Gives the action, (A,) or (N, A), that changes nothing now.

    Raises:
        ConfigError: If a list of the noise's is not one value a column.
    """

    hold: Callable[[], F64]

    def __init__(self, name: str, cfg: ActionTermCfg, width: int, streams: RandomStreams) -> None:
        path = f"actions.{name}"
        self._streams, self._stream = streams, path
        count = streams.num_envs
        delay = cfg.delay
        self._shortest, self._longest = (delay, delay) if isinstance(delay, int) else delay
        self._lags: NDArray[np.int64] = np.full(count, self._shortest, np.int64)
        self._past: F64 = np.zeros((self._longest, count, width))
        self._empty: NDArray[np.bool_] = np.ones(count, np.bool_)
        self._rows = np.arange(count)
        self._noise = None if cfg.noise is None else Noise(cfg.noise, (width,), path, streams)

    def __call__(self, action: torch.Tensor) -> torch.Tensor:
        """(N, A) float32 what the term receives for this step's action."""
        values: NDArray[Any] = action.numpy()
        if self._longest:
            values = self._delayed(values).astype(np.float32)
        if self._noise is not None:
            values = self._noise.apply(values, None)
        return torch.from_numpy(values)

    def _delayed(self, action: NDArray[np.float32]) -> F64:
        past = self._past
        if self._empty.any():
            past = past.copy()
            past[:, self._empty] = np.broadcast_to(self.hold(), action.shape)[self._empty]
            self._empty = np.zeros_like(self._empty)
        recent = np.concatenate([action[None], past])  # recent[d] is the action of d steps ago
        self._past = recent[:-1]
        found: F64 = recent[self._lags, self._rows]
        return found

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Forget these environments' actions, and draw their delays."""
        where: Any = slice(None) if env_ids is None else env_ids
        self._empty = self._empty.copy()
        self._empty[where] = True
        if self._longest > self._shortest:
            high = self._longest + 1
            drawn = self._streams.uniform(
                f"{self._stream}.delay", (1,), self._shortest, high, env_ids
            )
            self._lags = self._lags.copy()
            # min: a number just below `high` may round up to it.
            self._lags[where] = np.minimum(drawn[:, 0], self._longest).astype(np.int64)

    def state_dict(self) -> dict[str, Any]:
        """Actions under way, and delays (copies)."""
        return {"past": self._past.copy(), "lags": self._lags.copy(), "empty": self._empty.copy()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._past, self._lags = state["past"].copy(), state["lags"].copy()
        self._empty = state["empty"].copy()

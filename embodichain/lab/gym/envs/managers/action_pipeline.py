"""`ActionPipeline`: the delay and the noise between an action and its term.

Every call is a step of all environments.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np

from embodichain.lab.gym.envs.cfg import ActionTermCfg
from embodichain.lab.gym.envs.managers.noise import Noise
from embodichain.lab.gym.envs.managers.past import Delay, Rows

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
        self._delay: Delay | None = None
        if cfg.delay not in (0, [0, 0]):
            self._delay = Delay(cfg.delay, f"{path}.delay", streams)
        self._fresh: NDArray[np.bool_] = np.ones(streams.num_envs, np.bool_)
        self._noise = None if cfg.noise is None else Noise(cfg.noise, (width,), path, streams)

    def __call__(self, action: torch.Tensor) -> torch.Tensor:
        """(N, A) float32 what the term receives for this step's action."""
        values: NDArray[Any] = action.numpy()
        if self._delay is not None:
            rows, hold = Rows(None, None), None
            if self._fresh.any():
                rows = Rows(None, self._fresh)
                hold = np.broadcast_to(self.hold(), values.shape)
                self._fresh = np.zeros_like(self._fresh)
            values = self._delay(values, rows, hold).astype(np.float32)
        if self._noise is not None:
            values = self._noise.apply(values, None)
        return torch.from_numpy(values)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Forget these environments' actions, and draw their delays."""
        self._fresh = self._fresh.copy()
        self._fresh[slice(None) if env_ids is None else env_ids] = True
        if self._delay is not None:
            self._delay.restart(env_ids)

    def state_dict(self) -> dict[str, Any]:
        """Actions under way, and delays (copies)."""
        if self._delay is None:
            return {}
        past, lag = self._delay.past.values, self._delay.lag.copy()
        return {
            "past": None if past is None else past.copy(),
            "lag": lag,
            "fresh": self._fresh.copy(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        if self._delay is None:
            return
        past = state["past"]
        self._delay.past.values = None if past is None else past.copy()
        self._delay.lag[:] = state["lag"]
        self._fresh = state["fresh"].copy()

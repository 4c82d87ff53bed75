"""`ObservationEntry`: one term's place in the observation, and what is done to its value.

In this order, which is Isaac Lab's: noise, clip, scale, delay, history.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import lazy_loader

from embodichain.lab.gym.envs.cfg import ObservationCfg
from embodichain.lab.gym.envs.managers.base import BuiltTerm
from embodichain.lab.gym.envs.managers.noise import Noise
from embodichain.lab.gym.envs.managers.past import Delay, Past, Rows
from embodichain.lab.gym.utils.tensordicts import put
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex
    from embodichain.lab.sim.types import EnvObs
else:
    torch = lazy_loader.load("torch")

__all__ = ["ObservationEntry"]


class ObservationEntry:
    """Computes one term and puts it into the observation.

    Args:
        env: The environment.
        term: The term.
        corrupted: Whether its noise is on.

    Attributes:
        term: The term; another one may take its place.
        path: Where its value stands.
        width: Columns it has in the flattened vector; 0 before the first value.
        remembers: Whether it keeps anything between steps.
    """

    def __init__(self, env: TermContext, term: BuiltTerm[ObservationCfg], corrupted: bool) -> None:
        cfg = term.cfg
        self.term = term
        self.path = tuple((cfg.name or term.name).split("/"))
        self.width = 0
        self._env = env
        self._key = f"observations.{term.name}"
        self._modify = cfg.mode == "modify"
        self._clip = cfg.clip
        self._scale: float | torch.Tensor | None = None
        if cfg.scale is not None:
            scale = cfg.scale
            self._scale = scale if isinstance(scale, (int, float)) else torch.tensor(scale)
        self._noise_cfg = cfg.noise if corrupted else None
        self._noise: Noise | None = None
        self._delay: Delay | None = None
        if cfg.delay not in (0, [0, 0]):
            self._delay = Delay(cfg.delay, f"{self._key}.delay", env.streams)
        self._past: Past | None = None
        if cfg.history_length:
            self._past = Past(env.num_envs, cfg.history_length)
        self._flat = cfg.flatten_history_dim
        self._old = self._delay is not None or self._past is not None
        self.remembers = self._old or self._noise_cfg is not None
        self._checked = False
        self._fits = False

    def compute(self, obs: EnvObs, rows: Rows) -> None:
        """Set the entry in ``obs``.

        Args:
            obs: What is observed already.
            rows: For whom noise is drawn and the past moves on.
        """
        if self._modify and not self._checked:
            self._find(obs)
        value = self.term.call(self._env, obs[self.path] if self._modify else obs)
        if not self._checked:
            self._check(value)
        if self._noise is not None:
            value = self._noise.apply(value, rows.stepped)
        if self._clip is not None:
            value = value.clamp(self._clip[0], self._clip[1])
        if self._scale is not None:
            value = value * self._scale
        if value.dtype is torch.float64:
            value = value.to(torch.float32)
        if self._old:
            value = self._of_the_past(value, rows)
        if not self._checked:
            self.width = math.prod(value.shape[1:])
            self._fits = value.device == obs.device
            self._checked = True
        if self._fits:
            put(obs, self.path, value)
        else:
            obs.set(self.path, value)

    def _of_the_past(self, value: torch.Tensor, rows: Rows) -> torch.Tensor:
        if self._delay is not None:
            value = self._delay(value, rows)
        if self._past is None:
            return value
        seen = self._past.seen(value, rows).clone()
        return seen.reshape(len(seen), -1) if self._flat else seen

    def restart(self, env_ids: EnvIndex | None) -> None:
        """Begin the episode of these environments; (n,), or None for all."""
        if self._delay is not None:
            self._delay.restart(env_ids)

    # -- checking the first value --------------------------------------------------------------

    def _find(self, obs: EnvObs) -> None:
        known = [k if isinstance(k, str) else "/".join(k) for k in obs.keys(True, True)]
        wanted = "/".join(self.path)
        if wanted not in known:
            message = f"nothing to modify is called {wanted!r}; before it: {', '.join(known)}"
            hint = did_you_mean(wanted, known).strip()
            raise ConfigError([Problem(f"{self._key}.name", message, hint)])

    def _check(self, value: Any) -> None:
        """Check the shape of a term's value, and build the noise that fits it."""
        count = self._env.num_envs
        wrong = type(value).__name__
        if isinstance(value, torch.Tensor):
            wrong = "" if value.shape[:1] == (count,) else str(tuple(value.shape))
        if wrong:
            raise ValueError(
                f"observation term {self.term.name!r} must return a tensor of shape "
                f"({count}, ...), got {wrong}"
            )
        if isinstance(self._scale, torch.Tensor) and self._scale.shape != value.shape[-1:]:
            message = (
                f"has {len(self._scale)} values; the term's value is {tuple(value.shape)}, "
                "and its last dimension counts"
            )
            raise ConfigError([Problem(f"{self._key}.scale", message)])
        if self._noise_cfg is not None:
            shape = tuple(value.shape[1:])
            self._noise = Noise(self._noise_cfg, shape, self._key, self._env.streams)

    # -- saving --------------------------------------------------------------------------------

    def state_dict(self) -> dict[str, Any]:
        """What it remembers (copies)."""
        state: dict[str, Any] = {}
        if self._noise is not None:
            state["noise"] = self._noise.last.clone()
        if self._delay is not None:
            state["lag"] = self._delay.lag.copy()
            state["delayed"] = _copy(self._delay.past.values)
        if self._past is not None:
            state["history"] = _copy(self._past.values)
        return state

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        if self._noise is not None:
            self._noise.last = state["noise"].clone()
        if self._delay is not None:
            self._delay.lag[:] = state["lag"]
            self._delay.past.values = _copy(state["delayed"])
        if self._past is not None:
            self._past.values = _copy(state["history"])


def _copy(values: torch.Tensor | None) -> torch.Tensor | None:
    return None if values is None else values.clone()

"""`ObservationEntry`: one term's entry of the observation, and what is done to its value.

In this order, which is Isaac Lab's: noise, clip, scale, delay, history.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import ObservationCfg
from embodichain.lab.gym.envs.managers.base import BuiltTerm
from embodichain.lab.gym.envs.managers.noise import Noise
from embodichain.lab.gym.envs.managers.past import Delay, Past, Rows
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex

__all__ = ["ObservationEntry"]


class ObservationEntry:
    """Computes one entry.

    Args:
        env: The environment.
        term: The term.
        corrupted: Whether its noise is on.

    Attributes:
        term: The term; `set_params` replaces it.
        path: The entry's place in the observation.
        modifies: Whether it changes an entry that exists.
        key: Its key path in the config.
        remembers: Whether it has a state between steps.
    """

    def __init__(self, env: TermContext, term: BuiltTerm[ObservationCfg], corrupted: bool) -> None:
        cfg = term.cfg
        self.term = term
        self.path = tuple((cfg.name or term.name).split("/"))
        self.key = f"observations.{term.name}"
        self.modifies = cfg.mode == "modify"
        self._env = env
        self._clip = cfg.clip
        self._scale: Any = cfg.scale
        if isinstance(cfg.scale, list):
            self._scale = np.asarray(cfg.scale, np.float32)
        self._noise_cfg = cfg.noise if corrupted else None
        self._noise: Noise | None = None
        self._delay: Delay | None = None
        if cfg.delay not in (0, [0, 0]):
            self._delay = Delay(cfg.delay, f"{self.key}.delay", env.streams)
        self._past: Past | None = None
        if cfg.history_length:
            self._past = Past(env.num_envs, cfg.history_length)
        self._flat = cfg.flatten_history_dim
        self.remembers = bool(self._delay or self._past or self._noise_cfg is not None)
        self._changes = self.remembers or self._clip is not None or self._scale is not None
        self._checked = False

    def value(self, obs: Any, rows: Rows) -> NDArray[Any]:
        """Evaluate the term.

        Args:
            obs: What the term is called with: the observation, or the entry to modify.
            rows: Environments for which noise is drawn and the past is extended.

        Returns:
            (N, ...); it may share memory with the simulation.

        Raises:
            ValueError: If the term's value is not (N, ...); names the term.
        """
        found = self.term.call(self._env, obs)
        if not self._checked:
            self._check(found)
        value: NDArray[Any] = found if type(found) is np.ndarray else found.numpy(force=True)
        if not self._changes:
            return value
        if value.dtype == np.float64:
            value = value.astype(np.float32)
        if self._noise is not None:
            value = self._noise.apply(value, rows.stepped)
        if self._clip is not None:
            value = np.clip(value, self._clip[0], self._clip[1])
        if self._scale is not None:
            value = value * self._scale
        if self._delay is not None:
            value = self._delay(value, rows)
        if self._past is not None:
            value = self._past.append(value, rows)
            return value.reshape(len(value), -1) if self._flat else value
        return value

    def restart(self, env_ids: EnvIndex | None) -> None:
        """Begin the episode of these environments; (n,), or None for all."""
        if self._delay is not None:
            self._delay.restart(env_ids)

    def _check(self, value: Any) -> None:
        """Check the shape of the first value, and build the noise that fits it."""
        count = self._env.num_envs
        wrong = type(value).__name__
        if hasattr(value, "shape") and hasattr(value, "dtype"):
            wrong = "" if tuple(value.shape[:1]) == (count,) else str(tuple(value.shape))
        if wrong:
            raise ValueError(
                f"observation term {self.term.name!r} must return a tensor of shape "
                f"({count}, ...), got {wrong}"
            )
        if isinstance(self._scale, np.ndarray) and self._scale.shape != tuple(value.shape[-1:]):
            message = (
                f"has {len(self._scale)} values; the term's value is {tuple(value.shape)}, "
                "and its last dimension counts"
            )
            raise ConfigError([Problem(f"{self.key}.scale", message)])
        if self._noise_cfg is not None:
            shape = tuple(value.shape[1:])
            self._noise = Noise(self._noise_cfg, shape, self.key, self._env.streams)
        self._checked = True

    # -- saving --------------------------------------------------------------------------------

    def state_dict(self) -> dict[str, Any]:
        """Noise, delay and history (copies)."""
        state: dict[str, Any] = {}
        if self._noise is not None:
            state["noise"] = self._noise.last.copy()
        if self._delay is not None:
            state["lag"] = self._delay.lag.copy()
            state["delayed"] = _copy(self._delay.past.values)
        if self._past is not None:
            state["history"] = _copy(self._past.values)
        return state

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        if self._noise is not None:
            self._noise.last = state["noise"].copy()
        if self._delay is not None:
            self._delay.lag[:] = state["lag"]
            self._delay.past.values = _copy(state["delayed"])
        if self._past is not None:
            self._past.values = _copy(state["history"])


def _copy(values: NDArray[Any] | None) -> NDArray[Any] | None:
    return None if values is None else values.copy()

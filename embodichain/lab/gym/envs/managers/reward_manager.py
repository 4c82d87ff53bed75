"""`RewardManager`: the sum of weighted reward terms, and the sum of each over an episode.

Terms are in `envs/mdp/rewards`.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import RewardCfg
from embodichain.lab.gym.envs.managers.base import Manager, checked_rows
from embodichain.lab.gym.envs.managers.term_rows import TermRows

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex

__all__ = ["RewardManager"]

F32 = NDArray[np.float32]


class RewardManager(Manager[RewardCfg]):
    """Adds up value x weight over the terms; never x dt.

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> reward.

    Attributes:
        weights: Name -> current weight; another object when one has changed.
    """

    def __init__(self, env: TermContext, cfgs: Mapping[str, RewardCfg]) -> None:
        weights = {name: float(cfg.weight) for name, cfg in cfgs.items()}
        self.weights: Mapping[str, float] = MappingProxyType(weights)
        super().__init__(env, "rewards", "reward", cfgs)
        # Arrays (T, N), replaced and never written to: those handed out stay as they are.
        self._sums: F32 = np.zeros((len(self.terms), self.num_envs), np.float32)
        self._sums_before = self._sums
        self._names = tuple(self.terms)

    def _bind(self) -> None:
        self._checked = False
        self._calls = [(name, t.call) for name, t in self.terms.items()]
        replacing = [i for i, t in enumerate(self.terms.values()) if t.cfg.mode == "replace"]
        self._first = replacing[-1] + 1 if replacing else 0
        weights = [self.weights[name] for name in self.terms]
        self._factors: F32 = np.array(weights, np.float32)[:, None]

    @property
    def episode_sums(self) -> TermRows:
        """Name -> (N,) float32 sum of value x weight since the episode began (copies)."""
        return TermRows(self._names, self._sums)

    def set_weight(self, name: str, weight: float) -> None:
        """Give a term another weight from the next step on."""
        if self.weights[name] != weight:
            self.weights = MappingProxyType({**self.weights, name: float(weight)})
            self._bind()

    def compute(self, rewards: F32 | None, obs: Any, action: Any, info: dict[str, Any]) -> F32:
        """Evaluate every term of this step.

        Args:
            rewards: (N,) of the environment's own hooks, or None; terms are added to it, and one
                with ``mode: replace`` replaces the sum before it.
            obs: The step's observation.
            action: The step's action.
            info: Gains ``rewards`` (values without weights) and ``episode_sums`` (with weights,
                this step included), neither of which changes afterwards.

        Returns:
            (N,) float32.

        Raises:
            ValueError: If a term's value has another shape than (N,); names the term.
        """
        if not self._calls:
            info["rewards"], info["episode_sums"] = {}, {}
            return np.zeros(self.num_envs, np.float32) if rewards is None else rewards
        values = np.empty(self._sums.shape, np.float32)
        for row, (name, call) in enumerate(self._calls):
            value = call(self.env, obs, action, info)
            if not self._checked:
                checked_rows(value, self.num_envs, "reward", name)
            values[row] = value if type(value) is np.ndarray else value.numpy(force=True)
        self._checked = True
        parts = np.empty((len(values) + 1, self.num_envs), np.float32)
        parts[0] = 0.0 if rewards is None else rewards
        weighted = np.multiply(values, self._factors, out=parts[1:])
        self._sums_before, self._sums = self._sums, self._sums + weighted
        # One row after the other: the rounding does not depend on the number of environments.
        total: F32 = np.add.accumulate(parts[self._first :], axis=0)[-1]
        info["rewards"] = TermRows(self._names, values)
        info["episode_sums"] = self.episode_sums
        return total

    def take_back(self, rows: NDArray[np.bool_]) -> None:
        """Undo the last step in the sums of environments, (N,) bool."""
        self._sums = np.where(rows, self._sums_before, self._sums)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Start the sums of these environments anew."""
        super().reset(env_ids)
        self._sums = self._sums.copy()
        self._sums[:, slice(None) if env_ids is None else env_ids] = 0.0

    def state_dict(self) -> dict[str, Any]:
        """Sums and weights, and the state of terms that are classes (copies)."""
        return {
            **super().state_dict(),
            "weights": dict(self.weights),
            "episode_sums": dict(zip(self._names, self._sums.copy(), strict=True)),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        self.weights = MappingProxyType(dict(state["weights"]))
        self._bind()
        sums = [np.asarray(state["episode_sums"][name], np.float32) for name in self._names]
        self._sums = np.array(sums, np.float32).reshape(len(sums), self.num_envs)

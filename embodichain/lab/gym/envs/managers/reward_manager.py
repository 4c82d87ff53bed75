"""`RewardManager`: rewards a term by term, their weights, and their sums over an episode.

The terms themselves are in `envs/mdp/rewards.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import RewardCfg
from embodichain.lab.gym.envs.managers.base import Manager, checked_rows
from embodichain.lab.gym.envs.managers.term_rows import TermRows

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex
else:
    torch = lazy_loader.load("torch")

__all__ = ["RewardManager"]


class RewardManager(Manager[RewardCfg]):
    """Adds up value x weight over the terms; never x dt.

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> reward.

    Attributes:
        weights: Name -> weight in force; another object when one has changed.
    """

    def __init__(self, env: TermContext, cfgs: Mapping[str, RewardCfg]) -> None:
        weights = {name: float(cfg.weight) for name, cfg in cfgs.items()}
        self.weights: Mapping[str, float] = MappingProxyType(weights)
        super().__init__(env, "rewards", "reward", cfgs)
        # Numbers of all terms together, (T, N): one operation instead of one a term.
        self._sums = self._sums_before = np.zeros((len(self.terms), self.num_envs), np.float32)
        self._checked = False

    def _bind(self) -> None:
        self._calls = [(name, t.call, t.cfg.mode == "replace") for name, t in self.terms.items()]
        weights = [self.weights[name] for name in self.terms]
        self._factors = np.array(weights, np.float32)[:, None]

    @property
    def episode_sums(self) -> TermRows:
        """Name -> (N,) float32 sum of value x weight since the episode began (copies)."""
        return TermRows(self.terms, self._sums.copy())

    def set_weight(self, name: str, weight: float) -> None:
        """Give a term another weight from the next step on."""
        if self.weights[name] != weight:
            self.weights = MappingProxyType({**self.weights, name: float(weight)})
            self._bind()

    def compute(
        self, rewards: torch.Tensor, obs: Any, action: Any, info: dict[str, Any]
    ) -> torch.Tensor:
        """Evaluate every term of this step.

        Args:
            rewards: (N,) float32, what the environment's own hooks give; terms are added to it, and
                one with ``mode: replace`` takes the place of all before it.
            obs: The step's observation.
            action: The step's action.
            info: Gains ``rewards`` (values without weights) and ``episode_sums`` (with weights,
                this step included). Both are left alone afterwards.

        Returns:
            (N,) float32.

        Raises:
            ValueError: If a term's value has another shape than (N,); names the term.
        """
        if not self._calls:
            info["rewards"], info["episode_sums"] = {}, {}
            return rewards
        values = np.empty(self._sums.shape, np.float32)
        for row, (name, call, _) in enumerate(self._calls):
            value = call(self.env, obs, action, info)
            if not self._checked:
                checked_rows(value, self.num_envs, "reward", name)
            values[row] = value.numpy()
        total: NDArray[np.float32] = rewards.numpy()
        # What does not fit, or is no number, is found later: its environment has diverged.
        with np.errstate(over="ignore", invalid="ignore"):
            weighted = values * self._factors
            for paid, (_, _, replaces) in zip(weighted, self._calls, strict=True):
                total = paid if replaces else total + paid
            self._sums_before, self._sums = self._sums, self._sums + weighted
        self._checked = True
        info["rewards"] = TermRows(self.terms, values)
        info["episode_sums"] = self.episode_sums
        return torch.from_numpy(total)

    def take_back(self, rows: NDArray[np.bool_]) -> None:
        """Make the last step not count in the sums of environments, (N,) bool."""
        self._sums = np.where(rows, self._sums_before, self._sums)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Start the sums of these environments anew; what `info` holds is left alone."""
        super().reset(env_ids)
        self._sums[:, slice(None) if env_ids is None else env_ids] = 0.0

    def state_dict(self) -> dict[str, Any]:
        """Sums and weights, and the state of terms that are classes (copies)."""
        return {
            **super().state_dict(),
            "weights": dict(self.weights),
            "episode_sums": self.episode_sums,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        self.weights = MappingProxyType(dict(state["weights"]))
        self._bind()
        for row, name in zip(self._sums, self.terms, strict=True):
            row[:] = state["episode_sums"][name].numpy()

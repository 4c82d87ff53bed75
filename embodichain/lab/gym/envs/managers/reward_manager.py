"""`RewardManager`: rewards a term by term, their weights, and their sums over an episode.

The terms themselves are in `envs/mdp/rewards.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import lazy_loader

from embodichain.lab.gym.envs.cfg import RewardCfg
from embodichain.lab.gym.envs.managers.base import Manager, checked_rows

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.base_env import BaseEnv
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
        weights: Name -> weight in force.
        episode_sums: Name -> (N,) float32 sum of value x weight since the episode began.
    """

    def __init__(self, env: BaseEnv, cfgs: Mapping[str, RewardCfg]) -> None:
        self.weights = {name: float(cfg.weight) for name, cfg in cfgs.items()}
        super().__init__(env, "rewards", "reward", cfgs)
        self.episode_sums: dict[str, torch.Tensor] = {}
        if self.terms:
            self.episode_sums = {n: torch.zeros(self.num_envs) for n in self.terms}
        self._checked = False

    def _bind(self) -> None:
        self._calls = [
            (name, t.call, self.weights[name], t.cfg.mode == "replace")
            for name, t in self.terms.items()
        ]

    def set_weight(self, name: str, weight: float) -> None:
        """Give a term another weight from the next step on."""
        if self.weights[name] != weight:
            self.weights[name] = float(weight)
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
        values: dict[str, torch.Tensor] = {}
        sums: dict[str, torch.Tensor] = {}
        for name, call, weight, replace in self._calls:
            value = call(self.env, obs, action, info)
            if not self._checked:
                checked_rows(value, self.num_envs, "reward", name)
            if value.dtype != torch.float32:
                value = value.to(torch.float32)
            values[name] = value
            weighted = value if weight == 1.0 else value * weight
            rewards = weighted if replace else rewards + weighted
            sums[name] = self.episode_sums[name] + weighted
        self._checked = True
        self.episode_sums = sums
        info["rewards"] = values
        info["episode_sums"] = {name: total.clone() for name, total in sums.items()}
        return rewards

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Start the sums of these environments anew; what `info` holds is left alone."""
        super().reset(env_ids)
        where: Any = slice(None) if env_ids is None else env_ids
        for name, total in self.episode_sums.items():
            total = total.clone()
            total[where] = 0.0
            self.episode_sums[name] = total

    def state_dict(self) -> dict[str, Any]:
        """Sums and weights, and the state of terms that are classes (copies)."""
        return {
            **super().state_dict(),
            "weights": dict(self.weights),
            "episode_sums": {name: total.clone() for name, total in self.episode_sums.items()},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        self.weights = dict(state["weights"])
        self._bind()
        self.episode_sums = {name: total.clone() for name, total in state["episode_sums"].items()}

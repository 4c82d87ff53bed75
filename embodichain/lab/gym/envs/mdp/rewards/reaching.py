"""Built-in rewards. All of them can be metrics as well, and `within_distance` can end episodes.

Values are (N,); the reward manager multiplies them by their weight, never by dt.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np

from embodichain.lab.gym.envs.managers.base import Term
from embodichain.lab.gym.envs.managers.param_types import Positive
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _spatial

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.engine.base import EnvIndex
else:
    torch = lazy_loader.load("torch")

__all__ = [
    "ActionSmoothnessPenalty",
    "distance_between_objects",
    "joint_velocity_penalty",
    "success_reward",
    "within_distance",
]


@register_term("reward", "metric")
def distance_between_objects(
    env: BaseEnv,
    obs: Any,
    action: Any,
    info: dict[str, Any],
    source_entity_cfg: ResolvedEntity,
    target_entity_cfg: ResolvedEntity,
    exponential: bool = False,
    sigma: Positive = 1.0,
    use_xy_only: bool = False,
) -> torch.Tensor:
    """-d, or exp(-d^2 / (2 sigma^2)), with d the distance in metres between two entities.

    EmbodiChain's reward of the same name.

    Args:
        env: The environment.
        obs: Unused.
        action: Unused.
        info: Unused.
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.
        exponential: Whether to use the second formula, which lies in (0, 1].
        sigma: Its width in metres.
        use_xy_only: Whether heights are ignored.
    """
    d = _spatial.distance(source_entity_cfg, target_entity_cfg, use_xy_only)
    if not exponential:
        return _spatial.tensor(-d)
    return torch.exp(_spatial.tensor(d * d * (-0.5 / (sigma * sigma))))


@register_term("reward", "metric", "termination")
def within_distance(
    env: BaseEnv,
    obs: Any,
    action: Any,
    info: dict[str, Any],
    source_entity_cfg: ResolvedEntity,
    target_entity_cfg: ResolvedEntity,
    threshold: Positive,
    use_xy_only: bool = False,
) -> torch.Tensor:
    """1 (true) where two entities are closer than a threshold, else 0.

    Args:
        env: The environment.
        obs: Unused.
        action: Unused.
        info: Unused.
        source_entity_cfg: An entity, or a link of one.
        target_entity_cfg: Likewise.
        threshold: Metres.
        use_xy_only: Whether heights are ignored.
    """
    d = _spatial.distance(source_entity_cfg, target_entity_cfg, use_xy_only)
    return _spatial.tensor(d < threshold)


@register_term("reward", "metric")
def success_reward(env: BaseEnv, obs: Any, action: Any, info: dict[str, Any]) -> torch.Tensor:
    """1 where the task's success holds at this step, else 0. EmbodiChain's of the same name.

    Success is the metric `success`; in a task without one, ``info["success"]``: what the
    terminations of kind success or the environment's `evaluate` say.
    """
    success = info.get("metrics", {}).get("success")
    if success is None:
        success = info.get("success")
    return torch.zeros(env.num_envs) if success is None else (success != 0).to(torch.float32)


@register_term("reward", "metric")
def joint_velocity_penalty(
    env: BaseEnv, obs: Any, action: Any, info: dict[str, Any], entity_cfg: ResolvedEntity
) -> torch.Tensor:
    """-|qvel|, the Euclidean norm over the picked joints, rad/s. EmbodiChain's of the same name.

    Args:
        env: The environment.
        obs: Unused.
        action: Unused.
        info: Unused.
        entity_cfg: The robot; its joint names or control parts pick joints.
    """
    qvel = entity_cfg.asset.read_qvel()
    picked = qvel if entity_cfg.all_joints else qvel[:, list(entity_cfg.joint_ids)]
    return _spatial.tensor(-_spatial.norm(picked))


@register_term("reward", "metric", name="action_smoothness_penalty")
class ActionSmoothnessPenalty(Term):
    """-|a - a_previous|, the Euclidean norm over the action; 0 in an episode's first step.

    EmbodiChain's reward of the same name, which works without a rollout buffer here.
    """

    def __init__(self, env: BaseEnv) -> None:
        self._previous: torch.Tensor | None = None
        self._fresh = torch.ones(env.num_envs, dtype=torch.bool)

    def __call__(
        self, env: BaseEnv, obs: Any, action: torch.Tensor, info: dict[str, Any]
    ) -> torch.Tensor:
        """The penalty of this step."""
        previous = action if self._previous is None else self._previous
        change = (action - previous).numpy().astype(np.float64)
        value = torch.where(self._fresh, 0.0, _spatial.tensor(-_spatial.norm(change)))
        self._previous = action.clone()
        self._fresh = torch.zeros_like(self._fresh)
        return value

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Forget the previous action of these environments."""
        self._fresh[slice(None) if env_ids is None else torch.from_numpy(env_ids)] = True

    def state_dict(self) -> dict[str, Any]:
        """The previous action and who has none (copies)."""
        previous = None if self._previous is None else self._previous.clone()
        return {"previous": previous, "fresh": self._fresh.clone()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._previous = None if state["previous"] is None else state["previous"].clone()
        self._fresh = state["fresh"].clone()

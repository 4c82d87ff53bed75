"""Penalties on actions and on how they change.

They see the action as given to `step` (after `_preprocess_action`), in its own units. Values are
positive unless said otherwise: give them negative weights.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.mdp import _spatial
from embodichain.lab.gym.envs.mdp._judge import Recalling, action_rows, total

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext

__all__ = ["ActionAccL2", "ActionRateL2", "ActionSmoothnessPenalty", "action_l2"]

Info = dict[str, Any]


@register_term("reward", "metric")
def action_l2(env: TermContext, obs: Any, action: Any, info: Info) -> torch.Tensor:
    """Sum of the squared actions. Isaac Lab's of the same name.

    Example:
        ``{func: action_l2, weight: -0.01}``
    """
    rows = action_rows(action)
    return _spatial.tensor(total(rows * rows))


@register_term("reward", "metric", name="action_smoothness_penalty")
class ActionSmoothnessPenalty(Recalling):
    """-|a - a_previous|, the Euclidean norm over the action; 0 in an episode's first step.

    EmbodiChain's reward of the same name, which works without a rollout buffer here.

    Example:
        ``{func: action_smoothness_penalty, weight: 0.01}``
    """

    def __init__(self, env: TermContext) -> None:
        super().__init__(env.num_envs)

    def __call__(self, env: TermContext, obs: Any, action: Any, info: Info) -> torch.Tensor:
        """(N,) float32, not positive."""
        rows = action_rows(action)
        change = rows - self.recall(rows)[0]
        return _spatial.tensor(np.where(self.calls > 1, -_spatial.norm(change), 0.0))


@register_term("reward", "metric", name="action_rate_l2")
class ActionRateL2(Recalling):
    """Sum of squares of the action's change since the last step; 0 in an episode's first step.

    Isaac Lab's of the same name, which counts the first step's change from 0.

    Example:
        ``{func: action_rate_l2, weight: -0.01}``
    """

    def __init__(self, env: TermContext) -> None:
        super().__init__(env.num_envs)

    def __call__(self, env: TermContext, obs: Any, action: Any, info: Info) -> torch.Tensor:
        """(N,) float32."""
        rows = action_rows(action)
        change = rows - self.recall(rows)[0]
        return _spatial.tensor(np.where(self.calls > 1, total(change * change), 0.0))


@register_term("reward", "metric", name="action_acc_l2")
class ActionAccL2(Recalling):
    """Sum of squares of a - 2 a' + a'' over the last three actions; 0 in the first two steps.

    mjlab's of the same name, which takes the actions before an episode for 0.

    Example:
        ``{func: action_acc_l2, weight: -0.01}``
    """

    def __init__(self, env: TermContext) -> None:
        super().__init__(env.num_envs, depth=2)

    def __call__(self, env: TermContext, obs: Any, action: Any, info: Info) -> torch.Tensor:
        """(N,) float32."""
        rows = action_rows(action)
        last, second = self.recall(rows)
        bend = rows - 2.0 * last + second
        return _spatial.tensor(np.where(self.calls > 2, total(bend * bend), 0.0))

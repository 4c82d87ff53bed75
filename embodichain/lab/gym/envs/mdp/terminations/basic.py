"""Built-in terminations: time and place. `within_distance` stands among the rewards.

`kind` in the config says what an end means; the time limit `max_episode_steps` needs no term.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.managers.base import Term
from embodichain.lab.gym.envs.managers.param_types import Box3, Positive
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.mdp import _spatial

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["OutOfBounds", "time_out"]


@register_term("termination", "metric")
def time_out(
    env: BaseEnv, obs: Any, action: Any, info: dict[str, Any], time_limit_s: Positive
) -> torch.Tensor:
    """True once an episode has lasted so long, this step included.

    Args:
        env: The environment.
        obs: Unused.
        action: Unused.
        info: Unused.
        time_limit_s: Seconds of simulated time, rounded to control steps.
    """
    steps = max(1, round(time_limit_s / env.step_dt))
    over: torch.Tensor = env.elapsed_steps + 1 >= steps
    return over


@register_term("termination", "metric", name="out_of_bounds")
class OutOfBounds(Term):
    """True where an entity is outside a box: an object that fell, or was thrown away.

    Args:
        entity_cfg: The entity, or a link of one.
        bounds: [[x, y, z] low, [x, y, z] high] in metres, environment's frame.
    """

    def __init__(self, env: BaseEnv, entity_cfg: ResolvedEntity, bounds: Box3) -> None:
        self._entity = entity_cfg
        self._low, self._high = np.asarray(bounds, np.float64)

    def __call__(self, env: BaseEnv, obs: Any, action: Any, info: dict[str, Any]) -> torch.Tensor:
        """(N,) bool."""
        position = _spatial.position(self._entity)
        return _spatial.tensor(((position < self._low) | (position > self._high)).any(axis=1))

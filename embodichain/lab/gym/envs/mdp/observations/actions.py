"""The observation of what was done last."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext

__all__ = ["LastAction"]


@register_term("observation", name="last_action")
class LastAction(Term):
    """(N, A) the action of the last step, as given: before clip, delay and noise.

    Zeros after a reset. Isaac Lab's and mjlab's observation of the same name.

    Example:
        ``{func: last_action}``

    Args:
        action_name: One action term, to observe its slice alone; None is the whole action.
    """

    def __init__(self, env: TermContext, action_name: str | None = None) -> None:
        declared = env.cfg.actions
        if action_name is not None and action_name not in declared:
            known = ", ".join(declared) or "none"
            message = f"no action term is called {action_name!r}; there are: {known}"
            hint = did_you_mean(action_name, declared).strip()
            raise ConfigError([Problem("action_name", message, hint)])
        self._name = action_name

    def __call__(self, env: TermContext, obs: Any) -> torch.Tensor:
        """The observation."""
        action = env.last_action
        if self._name is None:
            return action
        return action[:, env.action_manager.slices[self._name]].contiguous()

"""Rewards that ask how the step ended, not what the scene looks like; and a constant.

Terminations and metrics of the step are known when rewards are computed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import lazy_loader

from embodichain.lab.gym.envs.managers.registry import register_term

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
else:
    torch = lazy_loader.load("torch")

__all__ = ["constant", "is_alive", "is_terminated", "success_reward"]


@register_term("reward", "metric")
def success_reward(env: TermContext, obs: Any, action: Any, info: dict[str, Any]) -> torch.Tensor:
    """1 where the task's success holds at this step, else 0. EmbodiChain's of the same name.

    Success is the metric `success`; in a task without one, ``info["success"]``: what the
    terminations of kind success or the environment's `evaluate` say.

    Example:
        ``{func: success_reward, weight: 10.0}``
    """
    success = info.get("metrics", {}).get("success")
    if success is None:
        success = info.get("success")
    return torch.zeros(env.num_envs) if success is None else (success != 0).to(torch.float32)


@register_term("reward", "metric")
def is_terminated(env: TermContext, obs: Any, action: Any, info: dict[str, Any]) -> torch.Tensor:
    """1 where a termination of kind success or fail ends the episode, else 0.

    Running out of time is no termination. An environment that diverges gets no reward at all.
    Isaac Lab's reward of the same name: give it a negative weight.

    Example:
        ``{func: is_terminated, weight: -200.0}``
    """
    return _terminated(env, info).to(torch.float32)


@register_term("reward", "metric")
def is_alive(env: TermContext, obs: Any, action: Any, info: dict[str, Any]) -> torch.Tensor:
    """1 where `is_terminated` is 0, and 0 where it is 1. Isaac Lab's reward of the same name.

    Example:
        ``{func: is_alive, weight: 1.0}``
    """
    return (~_terminated(env, info)).to(torch.float32)


def _terminated(env: TermContext, info: dict[str, Any]) -> torch.Tensor:
    if env.cfg.ignore_terminations:
        return torch.zeros(env.num_envs, dtype=torch.bool)
    ended: torch.Tensor = info["success"] | info["fail"]
    return ended


@register_term("reward", "metric")
def constant(
    env: TermContext, obs: Any, action: Any, info: dict[str, Any], value: float = 1.0
) -> torch.Tensor:
    """The same number in every step: a price of time, or a point to start from.

    Args:
        env: The environment.
        obs: Unused.
        action: Unused.
        info: Unused.
        value: The number.

    Example:
        ``{func: constant, weight: -0.01}``
    """
    return torch.full((env.num_envs,), float(value))

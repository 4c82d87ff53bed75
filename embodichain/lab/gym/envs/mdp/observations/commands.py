"""Observations of commands."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.term import Term

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext

__all__ = ["GeneratedCommand"]


@register_term("observation", name="generated_command")
class GeneratedCommand(Term):
    """(N, K) the command in force, in the command's own units. Isaac Lab's ``generated_commands``.

    Example:
        ``{func: generated_command, params: {command_name: velocity}}``

    Args:
        command_name: The command.
    """

    def __init__(self, env: TermContext, command_name: str) -> None:
        self._name = env.command_manager.require(command_name, "command_name")

    def __call__(self, env: TermContext, obs: Any) -> torch.Tensor:
        """The observation."""
        return env.command_manager.get_command(self._name)

"""Commands as terms read them: by name, with enough columns."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64

__all__ = ["columns"]


def columns(
    env: TermContext, name: str, least: int, key: str = "command_name"
) -> Callable[[], F64]:
    """Return what reads a command: (N, K) float64, a live view.

    Args:
        env: The environment.
        name: The command.
        least: Columns that are needed.
        key: The parameter that names it, for messages.

    Raises:
        ConfigError: If there is no such command, or it has fewer columns.
    """
    manager = env.command_manager
    manager.require(name, key)
    found = manager.values(name).shape[1]
    if found < least:
        message = f"command {name!r} has {found} columns, at least {least} are needed"
        raise ConfigError([Problem(key, message)])
    return lambda: manager.values(name)

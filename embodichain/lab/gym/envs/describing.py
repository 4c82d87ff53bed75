"""What an environment says of itself: `describe` for its `repr`, `warn_undrawn` of `render`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym

__all__ = ["describe", "describe_space", "warn_undrawn"]


def describe(kind: str, task: str | None, *facts: str, action: Any, observation: Any) -> str:
    """Return the `repr` of an environment in one line.

    Args:
        kind: Name of its class.
        task: Name of its task; None if it was not made of one.
        *facts: Such as ``num_envs=4``.
        action: Space of one environment's actions.
        observation: Space of one environment's observations.
    """
    parts = [
        *([] if task is None else [repr(task)]),
        *facts,
        f"action={describe_space(action)}",
        f"observation={describe_space(observation)}",
    ]
    return f"{kind}({', '.join(parts)})"


def describe_space(space: Any) -> str:
    """Return a space in short: the shape of numbers, the entries of a dict."""
    if isinstance(space, Mapping):  # a Dict is one
        entries = [f"{name}: {describe_space(entry)}" for name, entry in space.items()]
        return f"{{{', '.join(entries)}}}"
    if isinstance(space, gym.spaces.Box):
        suffix = "" if space.dtype.kind == "f" else f" {space.dtype}"
        return f"{space.shape}{suffix}"
    return str(space)


def warn_undrawn(task: str | None) -> None:
    """Warn, as Gymnasium does, that `render` draws nothing without a render mode."""
    make = f'embodichain.make("{task or "TASK"}", render_mode="rgb_array")'
    gym.logger.warn(
        "render() draws nothing, because the environment was made without a render mode. Make it "
        f"with one, {make}; gymnasium.make and gymnasium.make_vec take it too.",
        stacklevel=3,  # where `render` was called
    )

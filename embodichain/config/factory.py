"""Python's door: `embodichain.make("reach", num_envs=64)` builds what `run task=reach` would.

Torch is imported when an environment is built, not before.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.config.resolved import Resolved, resolve

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["make", "make_env"]


def make(
    task: str,
    num_envs: int | None = None,
    overrides: Sequence[str] = (),
    *,
    config_dir: str | Path | None = None,
    **kwargs: Any,
) -> BaseEnv:
    """Make the environment of a YAML task.

    Args:
        task: An option of the group `task`: ``reach``.
        num_envs: N; None is the task's suggestion, else 1.
        overrides: As on the command line: ``["seed=1", "task.rewards.near.weight=2"]``.
        config_dir: A folder with groups of the user's own, searched first.
        **kwargs: For `BaseEnv`: ``render_mode``, ``autoreset_mode``, ``run_dir``.

    Returns:
        The batched torch environment.

    Raises:
        ConfigError: Holds every mistake in the config.
        TypeError: If `overrides` is one string instead of several.
    """
    if isinstance(overrides, str):
        raise TypeError(f"overrides: a list of strings, such as [{overrides!r}], not a string")
    lines = [f"task={task}", *overrides]
    if num_envs is not None:
        lines.append(f"num_envs={num_envs}")
    return make_env(resolve(lines, "run", config_dir), **kwargs)


def make_env(resolved: Resolved, **kwargs: Any) -> BaseEnv:
    """Build the environment that a config declares, of the class that it names.

    Args:
        resolved: A checked config.
        **kwargs: For `BaseEnv`.

    Raises:
        ConfigError: What only building shows, with its place.
    """
    cfg = resolved.env_cfg
    if cfg.id is not None:
        from embodichain.config.plugins import require_registered
        from embodichain.lab.gym.utils import registration
        from embodichain.utils.errors import ConfigError, Problem

        problem = require_registered(cfg.id)
        if problem is not None:
            raise ConfigError([Problem("task.id", problem)])
        with resolved.locating("task"):
            return registration.make(cfg.id.rpartition(":")[2], cfg=cfg, **kwargs)
    from embodichain.lab.gym.envs.base_env import BaseEnv

    with resolved.locating("task"):
        return BaseEnv(cfg, **kwargs)

"""Which policy a config means, trained ones included. How a policy acts is not here."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from embodichain.lab.gym.policies import Policy, resolve_policy

if TYPE_CHECKING:
    from embodichain.config.schema import RootCfg
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["policy_of"]


def policy_of(root: RootCfg, env: BaseEnv, *, deterministic: bool = True) -> Policy:
    """Return the policy by name, by import path, or from a training's folder or file.

    Args:
        root: The config.
        env: Where it will act.
        deterministic: Whether a trained one takes its mean action.

    Raises:
        ConfigError: There is no such policy, its parameters are wrong, or it was trained in
            another task and ``allow_changed`` is not set.
    """

    def load(path: Path) -> Policy:
        from embodichain.learning.policy import load_policy

        changed = root.allow_changed
        return load_policy(path, env, deterministic=deterministic, allow_changed=changed)

    chosen = root.policy or "random"
    if isinstance(chosen, str):
        return resolve_policy(chosen, load_file=load)
    return resolve_policy({"func": chosen.func, "params": chosen.params}, load_file=load)

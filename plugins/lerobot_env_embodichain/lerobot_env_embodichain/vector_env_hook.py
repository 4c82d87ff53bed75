"""`install`: a batch in place of N environments, for LeRobot before 0.6.

LeRobot 0.6 asks the config for its environments (`EnvConfig.create_envs`). In 0.4 and 0.5
`make_env` makes them itself, one by one, without a way to give it a batch; so it is wrapped, for
this type of environment only, in the modules that have imported it.
"""

from __future__ import annotations

import functools
import sys
from typing import Any

from lerobot.envs import factory
from lerobot.envs.configs import EnvConfig

__all__ = ["install"]


def install(kind: type[Any]) -> None:
    """Let `make_env` of LeRobot before 0.6 return the environments of this type's `create_envs`.

    Args:
        kind: A subclass of `EnvConfig` with `create_envs`.
    """
    if hasattr(EnvConfig, "create_envs"):
        return
    given = factory.make_env

    @functools.wraps(given)
    def make_env(
        cfg: Any, n_envs: int = 1, use_async_envs: bool = False, *args: Any, **kwargs: Any
    ) -> Any:
        if isinstance(cfg, kind):
            return cfg.create_envs(n_envs, use_async_envs)
        return given(cfg, n_envs, use_async_envs, *args, **kwargs)

    for module in list(sys.modules.values()):
        if vars(module).get("make_env") is given:
            vars(module)["make_env"] = make_env

"""What terms keep as attributes of the environment, for other terms and for users' code."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["stored"]

T = TypeVar("T")
_OURS = "_stored_by_terms"


def stored(env: BaseEnv, name: str, first: Callable[[], T], path: str) -> T:
    """The value kept as ``env.<name>``; made by `first` where there is none.

    Args:
        env: The environment.
        name: The attribute. Terms may share it, and ``extensions`` may declare it.
        first: Makes the first value.
        path: The parameter that names it, for messages.

    Raises:
        ConfigError: If the name is no identifier, or belongs to the environment.
    """
    ours: set[str] = env.__dict__.setdefault(_OURS, set())
    known = name in ours or name in env.cfg.extensions
    if not known:
        if not name.isidentifier() or name.startswith("_") or hasattr(env, name):
            message = f"{name!r} is no name, or taken by the environment"
            raise ConfigError([Problem(path, message)])
        setattr(env, name, first())
        ours.add(name)
    found: Any = getattr(env, name)
    if type(found) is not type(first()):
        wanted = type(first()).__name__
        message = f"env.{name} is a {type(found).__name__}; a {wanted} is kept there"
        raise ConfigError([Problem(path, message)])
    value: T = found
    return value

"""What terms keep as attributes of the environment, for other terms and for users' code."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext

__all__ = ["stored"]

T = TypeVar("T")
_PACKAGES = ("embodichain.lab.", "gymnasium.", "builtins")
_SHARED = ("affordance_datas",)
"""Attributes of the environment that are made for terms to write into."""


def stored(env: TermContext, name: str, first: Callable[[], T], path: str) -> T:
    """The value kept as ``env.<name>``; made by `first` where there is none.

    Args:
        env: The environment.
        name: The attribute. Terms may share it, ``extensions`` may declare it, and a user's class
            may have it.
        first: Makes the first value.
        path: The parameter that names it, for messages.

    Raises:
        ConfigError: If the name is no identifier, or belongs to the environment.
    """
    if not name.isidentifier() or name.startswith("_") or _is_environments(env, name):
        message = f"{name!r} is no name, or taken by the environment"
        raise ConfigError([Problem(path, message)])
    if not hasattr(env, name):
        setattr(env, name, first())
    found: Any = getattr(env, name)
    if type(found) is not type(first()):
        wanted = type(first()).__name__
        message = f"env.{name} is a {type(found).__name__}; a {wanted} is kept there"
        raise ConfigError([Problem(path, message)])
    value: T = found
    return value


def _is_environments(env: TermContext, name: str) -> bool:
    """Whether an attribute is the environment's own, and not one of a user's class."""
    own = [base for base in type(env).__mro__ if base.__module__.startswith(_PACKAGES)]
    return name not in _SHARED and any(
        name in vars(base) or name in vars(base).get("__annotations__", {}) for base in own
    )

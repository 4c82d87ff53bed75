"""`stored`: values that terms share as attributes of the environment."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext

__all__ = ["asset_of", "stored"]

T = TypeVar("T")
_SHARED = ("affordance_datas",)
"""Attributes of the environment that are made for terms to write into."""
_PACKAGE = "embodichain.lab."


def stored(env: TermContext, name: str, first: Callable[[], T], path: str) -> T:
    """The value of ``env.<name>``; made by `first` where there is none.

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
        message = f"env.{name} is a {type(found).__name__}; a {wanted} is stored there"
        raise ConfigError([Problem(path, message)])
    value: T = found
    return value


def _is_environments(env: TermContext, name: str) -> bool:
    """Whether an attribute is one of the package's own class of environments."""
    own = [base for base in type(env).__mro__ if base.__module__.startswith(_PACKAGE)]
    return name not in _SHARED and any(
        name in vars(base) or name in vars(base).get("__annotations__", {}) for base in own
    )


def asset_of(env: TermContext, uid: str, path: str, objects_only: bool = False) -> Any:
    """The handle of an entity.

    Args:
        env: The environment.
        uid: Its name.
        path: The parameter that names it, for messages.
        objects_only: Whether it must be a rigid object.

    Raises:
        ConfigError: If there is no such entity; lists those that exist.
    """
    sim = env.sim
    assets: dict[str, Any] = dict(sim.rigid_objects)
    if not objects_only:
        assets = {**sim.robots, **sim.articulations, **assets}
    if uid not in assets:
        what = "rigid object" if objects_only else "entity"
        message = f"no {what} is called {uid!r}; there are: {', '.join(assets) or 'none'}"
        raise ConfigError([Problem(path, message, did_you_mean(uid, assets).strip())])
    return assets[uid]

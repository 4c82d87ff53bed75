"""Events that compute attributes of entities, for `register_entity_attrs` and users' code."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from embodichain.lab.gym.envs.cfg import SceneEntityCfg
from embodichain.lab.gym.envs.managers.registry import import_object, register_term
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._stored import stored
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex

__all__ = ["EXTRA_ATTRS", "ExtraAttr", "PrepareExtraAttr", "uids_of"]

EXTRA_ATTRS = "extra_attrs"
"""Attribute of the environment: uid -> name -> value."""


@dataclass
class ExtraAttr:
    """One attribute of some entities.

    Attributes:
        name: What it is called.
        mode: `static` takes `value`; `callable` calls `func_name`.
        value: Anything.
        entity_cfg: The entity; or
        entity_uids: entities, or `all_objects` or `all_robots`.
        func_name: A method of the entity's handle, or ``package.module:function``, which gets
            (env, env_ids, handle) first.
        func_kwargs: Further arguments.
    """

    __pydantic_config__ = {"extra": "forbid"}

    name: str
    mode: Literal["static", "callable"] = "static"
    value: Any = None
    entity_cfg: SceneEntityCfg | None = None
    entity_uids: str | list[str] | None = None
    func_name: str | None = None
    func_kwargs: dict[str, Any] = field(default_factory=dict)


def uids_of(env: TermContext, wanted: str | list[str], path: str) -> list[str]:
    """Uids that `all_objects` (rigid objects and articulations), `all_robots` or names mean.

    Raises:
        ConfigError: If an entity does not exist; lists those that do.
    """
    sim = env.sim
    if wanted == "all_objects":
        return [*sim.rigid_objects, *sim.articulations]
    if wanted == "all_robots":
        return [*sim.robots]
    names = [wanted] if isinstance(wanted, str) else wanted
    known = [*sim.robots, *sim.articulations, *sim.rigid_objects]
    for name in names:
        if name not in known:
            message = f"no entity is called {name!r}; there are: {', '.join(known) or 'none'}"
            raise ConfigError([Problem(path, message, did_you_mean(name, known).strip())])
    return names


@register_term("event", name="prepare_extra_attr")
class PrepareExtraAttr(Term):
    """Attaches attributes to entities, as ``env.extra_attrs[uid][name]``: EmbodiChain's event.

    Args:
        attrs: Each a map with `name`; `entity_uids` (names, `all_objects` or `all_robots`) or
            `entity_cfg`; and `value`, or `mode: callable` with `func_name` (a method of the
            entity's handle, or ``package.module:function`` that gets env, env_ids and the handle)
            and `func_kwargs`. Callables are called at every firing.

    Example:
        ``{func: prepare_extra_attr, mode: startup, params: {attrs: [{name: grasp_width, entity_uids: [cube], value: 0.04}, {name: size, mode: callable, entity_uids: all_objects, func_name: get_body_scale}]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, attrs: list[ExtraAttr]) -> None:
        self._attrs = [(a, *_checked(env, a, f"attrs.{n}")) for n, a in enumerate(attrs)]
        stored(env, EXTRA_ATTRS, dict, "attrs")

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Set the attributes."""
        table: dict[str, dict[str, Any]] = getattr(env, EXTRA_ATTRS)
        for attr, uids, func in self._attrs:
            for uid in uids:
                value = attr.value
                if attr.mode == "callable":
                    handle = env.sim.get_asset(uid)
                    first = (env, env_ids, handle) if func is not None else ()
                    call = getattr(handle, str(attr.func_name)) if func is None else func
                    value = call(*first, **attr.func_kwargs)
                table.setdefault(uid, {})[attr.name] = value


def _checked(env: TermContext, attr: ExtraAttr, path: str) -> tuple[list[str], Any]:
    """The entities that an attribute belongs to, and the function that is imported for it."""
    if (attr.entity_cfg is None) == (attr.entity_uids is None):
        raise ConfigError([Problem(path, "give either entity_uids or entity_cfg")])
    if attr.entity_cfg is not None:
        uids = uids_of(env, attr.entity_cfg.uid, f"{path}.entity_cfg.uid")
    else:
        uids = uids_of(env, attr.entity_uids or [], f"{path}.entity_uids")
    if attr.mode == "static":
        if attr.value is None or attr.func_name is not None:
            raise ConfigError([Problem(f"{path}.value", "a static attribute is its value")])
        return uids, None
    if attr.func_name is None:
        raise ConfigError([Problem(f"{path}.func_name", "a callable attribute names a function")])
    if ":" in attr.func_name:
        return uids, import_object(attr.func_name)
    for uid in uids:
        handle = env.sim.get_asset(uid)
        if not callable(getattr(handle, attr.func_name, None)):
            methods = [n for n in dir(handle) if not n.startswith("_")]
            hint = did_you_mean(attr.func_name, methods).strip()
            message = f"{type(handle).__name__} {uid!r} has no method {attr.func_name!r}"
            raise ConfigError([Problem(f"{path}.func_name", message, hint)])
    return uids, None

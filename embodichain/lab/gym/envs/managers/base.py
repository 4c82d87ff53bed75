"""`Manager`: builds the declared terms of one section once, resets and saves those with state."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from embodichain.lab.gym.envs.cfg import SceneEntityCfg, TermCfg
from embodichain.lab.gym.envs.managers.check import check_in_task, check_term
from embodichain.lab.gym.envs.managers.registry import Kind, TermSpec
from embodichain.lab.gym.envs.managers.scene_entity import resolve_entity
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex

__all__ = ["BuiltTerm", "Manager", "checked_rows"]

C = TypeVar("C", bound=TermCfg)


@dataclass(frozen=True, slots=True, eq=False)
class BuiltTerm(Generic[C]):
    """A declared term, ready to be called.

    Attributes:
        name: Its key in the config.
        cfg: What the config says.
        spec: The function or class behind it.
        call: Takes what the manager passes; parameters are bound.
        instance: The object, if the term is a class.
    """

    name: str
    cfg: C
    spec: TermSpec
    call: Callable[..., Any]
    instance: Any = None


class Manager(Generic[C]):
    """Terms of one kind, built once in declared order.

    Args:
        env: The environment; its scene is complete.
        section: The section of the task, for messages.
        kind: The kind of its terms.
        cfgs: Name -> declaration.

    Raises:
        ConfigError: If a term or an entity that it points at does not exist, or a parameter is
            wrong; holds the mistakes of all terms.
    """

    def __init__(self, env: TermContext, section: str, kind: Kind, cfgs: Mapping[str, C]) -> None:
        self.env = env
        self.num_envs = env.num_envs
        self.section = section
        self._kind: Kind = kind
        self._declared = dict(cfgs)
        self._changed: dict[str, dict[str, Any]] = {}
        problems: list[Problem] = []
        self.terms: dict[str, BuiltTerm[C]] = {}
        for name, cfg in cfgs.items():
            try:
                self.terms[name] = _build(env, kind, name, cfg, f"{section}.{name}")
            except ConfigError as error:
                problems += error.problems
        if problems:
            raise ConfigError(problems)
        self._collect()

    def _collect(self) -> None:
        """Look up what is called of the terms; again when one was built anew."""
        instances = {n: t.instance for n, t in self.terms.items() if t.instance is not None}
        self._resets = [i.reset for i in instances.values() if hasattr(i, "reset")]
        self._stateful = {n: i for n, i in instances.items() if hasattr(i, "state_dict")}
        self._bind()

    def _bind(self) -> None:
        """What a manager keeps of its terms besides; the default is nothing."""

    def params(self, name: str) -> dict[str, Any]:
        """The parameters that a term has now (a deep copy), as the config writes them."""
        return copy.deepcopy(self._changed.get(name, self._declared[name].params))

    def set_params(self, name: str, params: dict[str, Any]) -> None:
        """Build a term anew with other parameters; what it keeps between calls is carried over.

        Args:
            name: The term.
            params: All its parameters, as the config would write them.

        Raises:
            ConfigError: If they are wrong; the term stays as it was.
        """
        old = self.terms[name]
        cfg = copy.copy(self._declared[name])
        cfg.params = params
        term = _build(self.env, self._kind, name, cfg, f"{self.section}.{name}")
        if old.instance is not None and hasattr(old.instance, "state_dict"):
            term.instance.load_state_dict(old.instance.state_dict())
        self.terms[name] = term
        self._changed[name] = copy.deepcopy(params)
        self._collect()

    def __len__(self) -> int:
        return len(self.terms)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Reset the terms that are classes; (n,) environments, or None for all."""
        for reset in self._resets:
            reset(env_ids)

    def state_dict(self) -> dict[str, Any]:
        """State of the terms that keep any (copies), by name."""
        return {
            "terms": {name: term.state_dict() for name, term in self._stateful.items()},
            "params": copy.deepcopy(self._changed),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        for name in {*self._changed, *state["params"]}:
            params = state["params"].get(name, self._declared[name].params)
            self.set_params(name, copy.deepcopy(params))
        for name, term in self._stateful.items():
            term.load_state_dict(state["terms"][name])


def _build(env: TermContext, kind: Kind, name: str, cfg: C, path: str) -> BuiltTerm[C]:
    spec, values, problems = check_term(kind, cfg, path)
    if spec is None or problems:
        raise ConfigError(problems)
    where = f"{path}.params"
    problems = check_in_task(spec, values, env.cfg, where)
    if problems:
        raise ConfigError(problems)
    params = {key: _resolved(env, value, f"{where}.{key}") for key, value in values.items()}
    if not spec.is_class:
        bound = partial(spec.func, **params) if params else spec.func
        return BuiltTerm(name, cfg, spec, bound)
    with _under(where):
        instance = spec.func(env, **params)
    method = {"action": "apply", "command": "resample"}.get(kind, "__call__")
    return BuiltTerm(name, cfg, spec, getattr(instance, method), instance)


@contextmanager
def _under(path: str) -> Iterator[None]:
    """Put a path before those of a ConfigError that do not begin with it."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError(
            p
            if p.path.startswith(path)
            else Problem(f"{path}.{p.path}".rstrip("."), p.message, p.hint)
            for p in error.problems
        ) from error


def _resolved(env: TermContext, value: Any, path: str) -> Any:
    """Replace references to entities, also within lists and maps, by what they mean."""
    if isinstance(value, SceneEntityCfg):
        return resolve_entity(env.sim, value, path)
    if isinstance(value, (list, tuple)):
        return type(value)(_resolved(env, v, f"{path}.{i}") for i, v in enumerate(value))
    if isinstance(value, dict):
        return {k: _resolved(env, v, f"{path}.{k}") for k, v in value.items()}
    return value


def checked_rows(value: Any, num_envs: int, kind: Kind, name: str) -> torch.Tensor:
    """Return a term's value if it is a tensor of shape (N,).

    Raises:
        ValueError: If it is not; names the term. (N, 1) is refused too: it would broadcast.
    """
    import torch

    if not isinstance(value, torch.Tensor):
        raise ValueError(
            f"{kind} term {name!r} must return a tensor of shape ({num_envs},), "
            f"got {type(value).__name__}"
        )
    if value.shape != (num_envs,):
        raise ValueError(
            f"{kind} term {name!r} must return shape ({num_envs},), got {tuple(value.shape)}"
        )
    return value

"""`Manager`: builds the declared terms of one section once, resets and saves those with state."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from embodichain.lab.gym.envs.cfg import TermCfg
from embodichain.lab.gym.envs.managers.building import BuiltTerm, build_term
from embodichain.lab.gym.envs.managers.registry import Kind
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex

__all__ = ["BuiltTerm", "Manager", "checked_rows"]

C = TypeVar("C", bound=TermCfg)


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
                self.terms[name] = build_term(env, kind, name, cfg, f"{section}.{name}")
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
        term = build_term(self.env, self._kind, name, cfg, f"{self.section}.{name}")
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


def checked_rows(value: Any, num_envs: int, kind: Kind, name: str) -> None:
    """Check that a term's value is a tensor or an array of shape (N,).

    Raises:
        ValueError: If it is not; names the term. (N, 1) is refused too: it would broadcast.
    """
    if not hasattr(value, "shape") or not hasattr(value, "dtype"):
        raise ValueError(
            f"{kind} term {name!r} must return a tensor of shape ({num_envs},), "
            f"got {type(value).__name__}"
        )
    if tuple(value.shape) != (num_envs,):
        raise ValueError(
            f"{kind} term {name!r} must return shape ({num_envs},), got {tuple(value.shape)}"
        )

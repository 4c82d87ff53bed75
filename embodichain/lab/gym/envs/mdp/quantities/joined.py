"""Terms made of terms: all or any of several predicates, a predicate held for some time, products.

The inner terms are declared as everywhere, ``{func: ..., params: {...}}``, and are checked, reset,
saved and restored with the outer one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import lazy_loader
import numpy as np
from pydantic import AfterValidator, Field

from embodichain.lab.gym.envs.cfg import ValueCfg
from embodichain.lab.gym.envs.managers.base import Manager
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex
else:
    torch = lazy_loader.load("torch")

__all__ = ["AllOf", "AnyOf", "HeldFor", "ProductOf"]


def _registered(term: ValueCfg) -> ValueCfg:
    """Check an inner term as one of a manager's is checked, before anything is built."""
    from embodichain.lab.gym.envs.managers.check import check_term

    if isinstance(term.func, str) and ":" in term.func:
        raise ValueError("a term within a term must be a registered one, not an import path")
    problems = check_term("metric", term, "")[1]
    if problems:
        raise ValueError("; ".join(str(problem).lstrip(".") for problem in problems))
    return term


Inner = Annotated[ValueCfg, AfterValidator(_registered)]
Terms = Annotated[dict[str, Inner], Field(min_length=1)]
Info = dict[str, Any]


class _Joined(Term):
    """Builds the inner terms, and passes on what happens to the outer one."""

    def __init__(self, env: TermContext, terms: Mapping[str, ValueCfg]) -> None:
        self._inner: Manager[ValueCfg] = Manager(env, "terms", "metric", terms)
        self._calls = [term.call for term in self._inner.terms.values()]

    def __call__(self, env: TermContext, obs: Any, action: Any, info: Info) -> torch.Tensor:
        """(N,)."""
        found = [call(env, obs, action, info) for call in self._calls]
        value = self._first(found[0])
        for other in found[1:]:
            value = self._join(value, other)
        return value

    def _first(self, value: torch.Tensor) -> torch.Tensor:
        return value != 0

    def _join(self, value: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
        raise NotImplementedError

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Reset the inner terms."""
        self._inner.reset(env_ids)

    def state_dict(self) -> dict[str, Any]:
        """Of the inner terms."""
        return self._inner.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._inner.load_state_dict(state)


@register_term("reward", "metric", "termination", name="all_of")
class AllOf(_Joined):
    """True where every one of several terms is true (not 0).

    Args:
        terms: Name -> metric term.

    Example:
        ``{func: all_of, params: {terms: {near: {func: within_distance, params: {source_entity_cfg:
        {uid: cube}, target_entity_cfg: {uid: goal}, threshold: 0.05}}, still: {func: at_rest,
        params: {entity_cfg: {uid: cube}, linear_threshold: 0.01}}}}}``
    """

    def __init__(self, env: TermContext, terms: Terms) -> None:
        super().__init__(env, terms)

    def _join(self, value: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
        return value & (other != 0)


@register_term("reward", "metric", "termination", name="any_of")
class AnyOf(_Joined):
    """True where at least one of several terms is true (not 0).

    Args:
        terms: Name -> metric term.

    Example:
        ``{func: any_of, params: {terms: {low: {func: height_below, params: {entity_cfg: {uid:
        cube}, threshold: 0}}, high: {func: height_above, params: {entity_cfg: {uid: cube},
        threshold: 1}}}}}``
    """

    def __init__(self, env: TermContext, terms: Terms) -> None:
        super().__init__(env, terms)

    def _join(self, value: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
        return value | (other != 0)


@register_term("reward", "metric", name="product_of")
class ProductOf(_Joined):
    """The product of several terms: large only where all are. dm_control's rewards are such.

    Args:
        terms: Name -> metric term.

    Example:
        ``{func: product_of, weight: 1.0, params: {terms: {lifted: {func: height_above, params:
        {entity_cfg: {uid: cube}, threshold: 0.1}}, near: {func: distance_tanh, params:
        {source_entity_cfg: {uid: cube}, target_entity_cfg: {uid: goal}, std: 0.2}}}}}``
    """

    def __init__(self, env: TermContext, terms: Terms) -> None:
        super().__init__(env, terms)

    def _first(self, value: torch.Tensor) -> torch.Tensor:
        return value.to(torch.float32)

    def _join(self, value: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
        return value * other.to(torch.float32)


@register_term("reward", "metric", "termination", name="held_for")
class HeldFor(_Joined):
    """True where a term has been true (not 0) in each of the last `steps` steps of the episode.

    Args:
        term: A metric term.
        steps: Control steps, this one included; or
        time_s: Seconds of simulated time, rounded to control steps.

    Example:
        ``{func: held_for, params: {steps: 10, term: {func: within_distance, params:
        {source_entity_cfg: {uid: cube}, target_entity_cfg: {uid: goal}, threshold: 0.05}}}}``
    """

    def __init__(
        self,
        env: TermContext,
        term: Inner,
        steps: Annotated[int, Field(ge=1)] | None = None,
        time_s: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None,
    ) -> None:
        if (steps is None) == (time_s is None):
            raise ConfigError([Problem("steps", "give either steps or time_s")])
        super().__init__(env, {"term": term})
        self._steps = steps or max(1, round((time_s or 0.0) / env.step_dt))
        self._held = np.zeros(env.num_envs, np.int64)

    def __call__(self, env: TermContext, obs: Any, action: Any, info: Info) -> torch.Tensor:
        """(N,) bool."""
        true = super().__call__(env, obs, action, info).numpy()
        self._held = np.where(true, self._held + 1, 0)
        return torch.from_numpy(self._held >= self._steps)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Start counting anew in these environments."""
        super().reset(env_ids)
        self._held = self._held.copy()
        self._held[slice(None) if env_ids is None else env_ids] = 0

    def state_dict(self) -> dict[str, Any]:
        """Steps held so far, and the inner term (copies)."""
        return {**super().state_dict(), "held": self._held.copy()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        self._held = state["held"].copy()

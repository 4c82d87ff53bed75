"""Terms made of terms: all or any of predicates, a predicate over some time, products, sums.

Only terms of a sum have a weight: elsewhere it would mean nothing.

The inner terms are declared like all terms, ``{func: ..., params: {...}}``, and are checked, reset,
saved and restored with the outer one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field

from embodichain.lab.gym.envs.cfg import SummandCfg, ValueCfg
from embodichain.lab.gym.envs.managers.manager import Manager
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex

__all__ = ["AllOf", "AnyOf", "HeldFor", "ProductOf", "SumOf"]


def _check_inner(term: ValueCfg) -> ValueCfg:
    """Check an inner term like a term of a manager, before it is built; return it."""
    from embodichain.lab.gym.envs.managers.terms.check import check_term

    if isinstance(term.func, str) and ":" in term.func:
        raise ValueError("a term within a term must be a registered one, not an import path")
    _, problems = check_term("metric", term, "")
    if problems:
        raise ValueError("; ".join(str(problem).lstrip(".") for problem in problems))
    return term


Inner = Annotated[ValueCfg, AfterValidator(_check_inner)]
Terms = Annotated[dict[str, Inner], Field(min_length=1)]
Summand = Annotated[SummandCfg, AfterValidator(_check_inner)]
Summands = Annotated[dict[str, Summand], Field(min_length=1)]
Info = dict[str, Any]


class _Joined(Term):
    """Builds the inner terms, joins their values, and forwards resets and states to them.

    Attributes:
        takes_obs: Whether an inner term takes the observation.
        takes_info: Whether an inner term takes ``info``.
    """

    def __init__(
        self, env: TermContext, terms: Mapping[str, ValueCfg], join: np.ufunc, dtype: type
    ) -> None:
        self._inner: Manager[ValueCfg] = Manager(env, "terms", "metric", terms)
        self.takes_obs = self._inner.takes_obs
        self.takes_info = self._inner.takes_info
        self._calls = [term.call for term in self._inner.terms.values()]
        self._join_two = join
        self._dtype = dtype

    def __call__(self, env: TermContext, obs: Any, action: Any, info: Info) -> NDArray[Any]:
        """(N,)."""
        dtype = self._dtype
        values = []
        for call in self._calls:
            value = call(env, obs, action, info)
            if type(value) is not np.ndarray:
                value = env.arrays.of(value)
            values.append(value.astype(dtype))
        joined: NDArray[Any] = values[0]
        for value in values[1:]:
            joined = self._join_two(joined, value)
        return joined

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Reset the inner terms."""
        self._inner.reset(env_ids)

    def state_dict(self) -> dict[str, Any]:
        """The states of this term and of the inner ones."""
        return {**super().state_dict(), "inner": self._inner.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        self._inner.load_state_dict(state["inner"])


@register_term("reward", "metric", "termination", name="all_of")
class AllOf(_Joined):
    """True where all of several terms are true (not 0).

    Args:
        terms: Name -> metric term.

    Example:
        ``{func: all_of, params: {terms: {near: {func: distance, shape: {below: 0.05}, params:
        {from: {uid: cube}, to: {uid: goal}}}, still: {func: at_rest, params: {of: {uid: cube},
        linear_threshold: 0.01}}}}}``
    """

    def __init__(self, env: TermContext, terms: Terms) -> None:
        super().__init__(env, terms, np.logical_and, np.bool_)


@register_term("reward", "metric", "termination", name="any_of")
class AnyOf(_Joined):
    """True where at least one of several terms is true (not 0).

    Args:
        terms: Name -> metric term.

    Example:
        ``{func: any_of, params: {terms: {low: {func: height, shape: {below: 0}, params: {of: {uid:
        cube}}}, high: {func: height, shape: {above: 1}, params: {of: {uid: cube}}}}}}``
    """

    def __init__(self, env: TermContext, terms: Terms) -> None:
        super().__init__(env, terms, np.logical_or, np.bool_)


@register_term("reward", "metric", name="product_of")
class ProductOf(_Joined):
    """The product of several terms, as in dm_control: large only where all terms are large.

    Args:
        terms: Name -> metric term, without a weight: that of the whole term is the only one.

    Example:
        ``{func: product_of, weight: 1.0, params: {terms: {lifted: {func: height, shape: {above:
        0.1}, params: {of: {uid: cube}}}, near: {func: distance, shape: {tanh: 0.2}, params: {from:
        {uid: cube}, to: {uid: goal}}}}}}``
    """

    def __init__(self, env: TermContext, terms: Terms) -> None:
        super().__init__(env, terms, np.multiply, np.float32)


@register_term("reward", "metric", "termination", name="sum_of")
class SumOf(_Joined):
    """The sum of value x weight of several terms, for shapes and other terms to use.

    The terms of a task's rewards are added anyway, each in its own column of the log.

    Args:
        terms: Name -> metric term, with a `weight` (default 1); one of weight 0 is not evaluated.

    Example:
        ``{func: sum_of, weight: 0.5, params: {terms: {near: {func: distance, shape: {tanh: 0.2},
        weight: 2.0, params: {from: {uid: cube}, to: {uid: goal}}}, high: {func: height, weight:
        -1.0, params: {of: {uid: cube}}}}}}``
    """

    def __init__(self, env: TermContext, terms: Summands) -> None:
        super().__init__(env, terms, np.add, np.float32)
        weights = {name: np.float32(term.weight) for name, term in terms.items()}
        self._evaluated = [name for name, weight in weights.items() if weight != 0.0]
        calls = {name: self._inner.terms[name].call for name in self._evaluated}
        self._weighted = [(calls[name], weights[name]) for name in self._evaluated]

    def __call__(self, env: TermContext, obs: Any, action: Any, info: Info) -> NDArray[Any]:
        """(N,) float32."""
        weighted_sum: NDArray[Any] = env.arrays.full(env.num_envs, 0.0, np.float32)
        for call, weight in self._weighted:
            value = env.arrays.of(call(env, obs, action, info))
            weighted_sum = weighted_sum + value.astype(np.float32) * weight
        return weighted_sum

    def state_dict(self) -> dict[str, Any]:
        """The states of the inner terms, and which of them were evaluated."""
        return {**super().state_dict(), "evaluated": list(self._evaluated)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken; what was not evaluated there begins anew."""
        super().load_state_dict(state)
        for name, term in self._inner.terms.items():
            if name not in state["evaluated"] and hasattr(term.instance, "reset"):
                term.instance.reset(None)


@register_term("reward", "metric", "termination", name="held_for")
class HeldFor(_Joined):
    """True where a term has been true (not 0) in each of the last `steps` steps of the episode.

    Args:
        term: A metric term.
        steps: Control steps, this one included.
        time_s: Seconds of simulated time, rounded to control steps, instead of `steps`.

    Example:
        ``{func: held_for, params: {steps: 10, term: {func: distance, shape: {below: 0.05}, params:
        {from: {uid: cube}, to: {uid: goal}}}}}``
    """

    saved = ("_held",)

    def __init__(
        self,
        env: TermContext,
        term: Inner,
        steps: Annotated[int, Field(ge=1)] | None = None,
        time_s: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None,
    ) -> None:
        if (steps is None) == (time_s is None):
            raise ConfigError([Problem("steps", "give either steps or time_s")])
        super().__init__(env, {"term": term}, np.logical_and, np.bool_)
        self._steps = steps or max(1, round((time_s or 0.0) / env.step_dt))
        self._held: NDArray[np.int64] = env.arrays.full(env.num_envs, 0, np.int64)

    def __call__(self, env: TermContext, obs: Any, action: Any, info: Info) -> NDArray[Any]:
        """(N,) bool."""
        is_true = super().__call__(env, obs, action, info)
        self._held = np.where(is_true, self._held + 1, 0)
        return self._held >= self._steps

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Restart the count in these environments."""
        super().reset(env_ids)
        self._held = self._held.copy()
        self._held[slice(None) if env_ids is None else env_ids] = 0

"""`Quantity` and `Draw`: random values of named things, which start from the compiled ones.

The operation is folded into the bounds, so that the drawn number is the value itself; equal bounds
then give exactly the compiled value times one, or plus nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.drawing import constant
from embodichain.lab.sim.compiler.names import match
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["Distribution", "Draw", "Operation", "Quantity", "Values", "Write"]

Operation = Literal["add", "scale", "abs"]
"""What a drawn number does to the compiled one: is added, multiplies it, or replaces it."""
Distribution = Literal["uniform", "log_uniform", "gaussian"]
"""Over [low, high]: uniform; uniform in the logarithm; normal with its mean in the middle and the
bounds at three standard deviations, clipped there."""
Write = Callable[["F64", "EnvIndex | None"], None]
"""Writes values (n, m) in the environments given, or in all."""


@dataclass(frozen=True, eq=False)
class Values:
    """k values of named things: a field of one entity.

    Attributes:
        names: What the things are called, for ranges by name and for messages.
        default: (k,) compiled values.
        write: Gives what writes the values (n, m) of the things with indices (m,).
        lowest: The least value that makes sense; None is any.
        unlimited: Why a default may be infinite, for messages.
        needs_default: Whether an infinite default is an error whatever the operation.
    """

    names: Sequence[str]
    default: F64
    write: Callable[[NDArray[np.int64]], Write]
    lowest: float | None = None
    unlimited: str = ""
    needs_default: bool = False


class Quantity:
    """What some of an entity's values of one field are drawn from.

    Args:
        param: The parameter that gives the range, for messages.
        ranges: [low, high], {name regex: [low, high]}, or [[low, ...], [high, ...]] with a column
            for every thing, or for each of a group of things that repeats.
        operation: See `Operation`.
        values: The field's.

    Attributes:
        ids: (m,) which of the things are drawn.
        low, high: (m,) bounds of the value.
        factors: (m,) bounds of the number drawn, low and high.

    Raises:
        ConfigError: If a key matches nothing, or impossible values would be drawn.
    """

    def __init__(self, param: str, ranges: Any, operation: Operation, values: Values) -> None:
        self.param, self.operation = param, operation
        names, lowest = values.names, values.lowest
        low, high = _by_name(param, ranges, names)
        self.ids: NDArray[np.int64] = np.flatnonzero(~np.isnan(low))
        self.factors = low[self.ids], high[self.ids]
        self.default: F64 = np.array(values.default, np.float64)[self.ids]
        endless = [names[int(i)] for i in self.ids if not np.isfinite(values.default[i])]
        if endless and (operation != "abs" or values.needs_default):
            message = f"{values.unlimited}: {', '.join(endless)}"
            message += "" if values.needs_default else "; use operation: abs"
            raise ConfigError([Problem(param, message)])
        ends = [self.apply(f) for f in self.factors]
        self.low, self.high = constant(ends[0]), constant(ends[1])
        least = np.minimum(self.low, self.high)
        if lowest is not None and (least < lowest).any():
            worst = int(np.argmin(least))
            message = f"would give {names[int(self.ids[worst])]} {least[worst]:g}, below {lowest:g}"
            raise ConfigError([Problem(param, message)])

    def apply(self, drawn: F64) -> F64:
        """Values (..., m) of drawn numbers (..., m)."""
        if self.operation == "add":
            return self.default + drawn
        return self.default * drawn if self.operation == "scale" else drawn


def _by_name(param: str, ranges: Any, names: Sequence[str]) -> tuple[F64, F64]:
    """Lower and upper bounds (k,) each; NaN for what no key names. Later keys win."""
    low, high = np.full(len(names), np.nan), np.full(len(names), np.nan)
    if not isinstance(ranges, Mapping):
        bounds = np.asarray(ranges, np.float64).reshape(2, -1)
        low[:], high[:] = np.tile(bounds, (1, len(names) // bounds.shape[1]))
        return low, high
    for pattern, (least, most) in ranges.items():
        found, problems = match(pattern, names, "name", f"{param}.{pattern}")
        if problems:
            raise ConfigError(problems)
        low[list(found)], high[list(found)] = least, most
    if not ranges:
        raise ConfigError([Problem(param, f"names nothing; there are: {', '.join(names)}")])
    return low, high


class Draw:
    """Draws the quantities of one term together: one draw costs as much as a thousand numbers.

    Args:
        quantities: Name in the log -> what is drawn.
        distribution: See `Distribution`.

    Raises:
        ConfigError: If there is nothing to draw, or a logarithm is asked of what is not positive.
    """

    def __init__(self, quantities: Mapping[str, Quantity], distribution: Distribution) -> None:
        if not quantities:
            raise ConfigError([Problem("", "randomizes nothing: give it at least one range")])
        self._quantities = list(quantities.values())
        self._normal = distribution == "gaussian"
        self._log = distribution == "log_uniform"
        edges = np.cumsum([0, *(len(q.ids) for q in self._quantities)]).tolist()
        slices = [slice(a, b) for a, b in zip(edges, edges[1:], strict=False)]
        prefix = "log_" if self._log else ""
        self._columns = {prefix + n: s for n, s in zip(quantities, slices, strict=True)}
        if not self._log:
            self._low = constant(np.concatenate([q.low for q in self._quantities]))
            self._high = constant(np.concatenate([q.high for q in self._quantities]))
            return
        for q in self._quantities:
            if (q.factors[0] <= 0).any():
                message = f"log_uniform needs positive bounds, got {q.factors[0].min():g}"
                raise ConfigError([Problem(q.param, message)])
        self._bounds = [np.concatenate([q.factors[i] for q in self._quantities]) for i in (0, 1)]
        self._low, self._high = (constant(np.log(bound)) for bound in self._bounds)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> list[F64]:
        """Values (n, m) of every quantity; do not write into them."""
        manager, slices = env.event_manager, self._columns.values()
        drawn = manager.draw_columns(self._columns, self._low, self._high, env_ids, self._normal)
        if not self._log:
            return [drawn[:, where] for where in slices]
        # Rounding of log and exp must not leave the range.
        factors = np.clip(np.exp(np.ascontiguousarray(drawn)), *self._bounds)
        pairs = zip(self._quantities, slices, strict=True)
        return [quantity.apply(factors[:, where]) for quantity, where in pairs]
